"""Options that select the flight of a process: a resolved configuration, or a scenario for a real vehicle."""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import yaml

from configs.addresses import LINK_KEYS, Addresses, check_address, check_vehicle_address, network_of
from configs.flight_tree import Choices, flight_tree
from configs.loader import ConfigError, fill, merge, read_tree

REAL_SCENARIO: Final = "hover"
"""The default scenario, the first to fly with a vehicle."""
REAL_CONTROLLER: Final = "dmrac"
PEERS: Final = ("--vehicle", "--offboard", "--onboard", "--ground")
"""Options with the address of another side; the other options give addresses of this machine."""


class FlightOptions(NamedTuple):
    """The flight that a command line selects."""

    tree: dict[str, Any]
    """The plain tree, for all processes."""
    source: str
    """The files and options that it was made of, for messages."""
    text: bytes
    """The tree as YAML, for the log."""
    network: Addresses


def add_flight_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that select the flight."""
    parser.add_argument("--config", type=Path, help="resolved configuration of a flight (YAML)")
    alone = parser.add_argument_group("without --config: settings for a real vehicle (as dmrac config --real)")
    alone.add_argument("--scenario", metavar="NAME", help=f"in configs/scenarios, or a file (default {REAL_SCENARIO})")
    alone.add_argument(
        "--controller", metavar="NAME", help=f"in configs/controllers, or a file (default {REAL_CONTROLLER})"
    )
    alone.add_argument("--duration", type=float, metavar="S", help="s until it lands (default: the scenario's)")
    alone.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="assignments", help="overrule a value by path"
    )
    add_insecure_option(parser)


def add_insecure_option(parser: argparse.ArgumentParser) -> None:
    """Add the option that lets a link leave this machine without a key."""
    parser.add_argument(
        "--insecure",
        action="append",
        default=[],
        choices=tuple(LINK_KEYS),
        metavar="LINK",
        help=f"let this link leave this machine without a key ({', '.join(LINK_KEYS)}); may be repeated. Anybody in "
        "the network can then fly the vehicle; every status line says so",
    )


def flight_of(
    arguments: argparse.Namespace,
    options: Mapping[str, str],
    needed: Mapping[str, str],
    implied: Callable[[Mapping[str, str | None]], dict[str, str | None]],
) -> FlightOptions:
    """The flight that a command line selects.

    Parameters
    ----------
    options: names in `network` and the options that overrule them, such as {"ground": "--ground"}.
    needed: options that are required without a configuration, each with the form of its value.
    implied: derives all addresses from the given ones, without a configuration.

    Raises
    ------
    ConfigError
        Naming file or option, value and what is allowed.
    """
    given = {name: _address(option, _value(arguments, option), name) for name, option in options.items()}
    insecure = {"insecure": tuple(arguments.insecure)}
    if arguments.config is not None:
        _refuse_beside_config(arguments)
        tree, source = read_tree(arguments.config), str(arguments.config)
        return FlightOptions(tree, source, arguments.config.read_bytes(), network_of(tree, source, given | insecure))
    missing = [f"{option} {what}" for option, what in needed.items() if _value(arguments, option) is None]
    if missing:
        raise ConfigError(f"{' and '.join(missing)} missing; give them, or --config FILE made by dmrac config")
    controller = arguments.controller or REAL_CONTROLLER
    choices = Choices(controller, None, arguments.duration, arguments.assignments, real=True)
    tree, source = flight_tree(arguments.scenario or REAL_SCENARIO, choices)
    words = [f"{option} {value}" for option in options.values() if (value := _value(arguments, option)) is not None]
    addresses: dict[str, Any] = {name: address for name, address in implied(given).items() if address is not None}
    addresses |= insecure
    network = fill(Addresses, merge(tree["network"], addresses), " ".join(words), at="network.")
    tree["network"] = network.model_dump(mode="json")
    return FlightOptions(tree, source, yaml.safe_dump(tree, sort_keys=False, allow_unicode=True).encode(), network)


def _refuse_beside_config(arguments: argparse.Namespace) -> None:
    for name in ("scenario", "controller", "duration", "assignments"):
        if getattr(arguments, name) not in (None, []):
            option = "--set" if name == "assignments" else f"--{name}"
            raise ConfigError(f"{option}: not beside --config, whose file settles it; give it to dmrac config")


def _value(arguments: argparse.Namespace, option: str) -> str | None:
    value: str | None = getattr(arguments, option.removeprefix("--").replace("-", "_"))
    return value


def _address(option: str, value: str | None, name: str) -> str | None:
    """The value of an option in its plain form; only that of a key file is no address."""
    if value is None or name.endswith("key_file"):
        return value
    try:
        address = check_vehicle_address(value) if name == "vehicle" else check_address(value)
        if option in PEERS and address.startswith("0.0.0.0:"):
            raise ValueError("0.0.0.0 is this machine's own; expected the address of the other side")
        return address
    except ValueError as error:
        raise ConfigError(f"{option} {value}: {error}") from None
