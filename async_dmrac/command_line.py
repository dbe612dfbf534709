"""The `dmrac` command: one subcommand a module, imported only when it is called, so that onboard starts quickly."""

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Final, NamedTuple

import async_dmrac

# numpy's and torch's own threads would compete with the 200 Hz loop; set before either is imported.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

EXIT_USAGE: Final = 2


class Subcommand(NamedTuple):
    """Where a subcommand lives, and what it is for."""

    module: str
    help: str


SUBCOMMANDS: Final[dict[str, Subcommand]] = {
    "fly": Subcommand("async_dmrac.commands.fly", "fly a scenario: vehicle, onboard and offboard together"),
    "onboard": Subcommand("onboard.command", "the 200 Hz flight process alone"),
    "offboard": Subcommand("offboard.command", "the training process alone"),
    "sim": Subcommand("sim_vehicle.command", "the simulated vehicle and its radio alone"),
    "mocap": Subcommand("async_dmrac.commands.mocap", "sign the poses of a motion capture and send them to offboard"),
    "replay": Subcommand(
        "async_dmrac.commands.replay", "re-fly a recorded flight with exactly the deliveries its link had"
    ),
    "dropouts": Subcommand("async_dmrac.commands.dropouts", "fly the shipped dropouts of the link and print a table"),
    "attack": Subcommand("async_dmrac.commands.attack", "fly bad learners and count the vehicles that they cost"),
    "learn": Subcommand("async_dmrac.commands.learn", "learn a memory from logged flights and from other memories"),
    "memory": Subcommand("async_dmrac.commands.memory", "check a memory and show what it holds"),
    "config": Subcommand("async_dmrac.commands.config", "write the resolved configuration of a scenario"),
    "bench": Subcommand("async_dmrac.commands.bench", "time the onboard step, the loop's pace and lockstep"),
    "margins": Subcommand("async_dmrac.commands.margins", "measure the stability margins of a controller's loops"),
    "keygen": Subcommand("async_dmrac.commands.keygen", "make a key that protects the onboard/offboard link"),
    "tune": Subcommand("async_dmrac.commands.tune", "search a controller's gains on training seeds"),
    "campaign": Subcommand("async_dmrac.commands.campaign", "fly scenario x controllers x sweeps x seeds"),
    "refly": Subcommand("async_dmrac.commands.refly", "fly some of a campaign's flights again and compare"),
    "figures": Subcommand("async_dmrac.commands.figures", "tables and figures of a campaign"),
    "reproduce": Subcommand("async_dmrac.commands.reproduce", "fly every campaign and rebuild docs/results.md"),
    "log": Subcommand("async_dmrac.commands.log", "look into, check, merge and export flight logs"),
    "view": Subcommand("async_dmrac.commands.view", "open a flight in the 3-D viewer"),
    "report": Subcommand("async_dmrac.commands.report", "one self-contained page about a flight"),
    "compare": Subcommand("async_dmrac.commands.compare", "overlay flights"),
    "mambo": Subcommand("async_dmrac.commands.mambo", "build, configure, check and install the library for the Mambo"),
    "preflight": Subcommand("async_dmrac.commands.preflight", "check a vehicle's link before it may fly"),
}


def build_parser(name: str | None) -> argparse.ArgumentParser:
    """The parser; only the subcommand that is called is imported and gets its options."""
    parser = argparse.ArgumentParser(
        prog="dmrac",
        description="A small quadrotor that learns in flight.",
        epilog="examples:\n  dmrac fly\n  dmrac fly rotor_chip --controller pid --lockstep\n  dmrac fly --help",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"dmrac {async_dmrac.__version__}")
    subparsers = parser.add_subparsers(dest="subcommand", metavar="SUBCOMMAND", required=True)
    for key, subcommand in SUBCOMMANDS.items():
        if key != name:
            subparsers.add_parser(key, help=subcommand.help)
            continue
        module = import_module(subcommand.module)
        own = subparsers.add_parser(
            key,
            help=subcommand.help,
            description=getattr(module, "DESCRIPTION", subcommand.help),
            epilog=getattr(module, "EXAMPLES", None),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(own)
        own.set_defaults(run=module.run)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns 0 for success, 1 for a lost vehicle or failed check, 2 for bad usage or config."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    name = next((word for word in arguments if not word.startswith("-")), None)
    parsed = build_parser(name).parse_args(arguments)
    from configs.loader import ConfigError
    from runtime.errors import PlainError

    try:
        status: int = parsed.run(parsed)
    except (ConfigError, PlainError) as error:
        print(f"dmrac {parsed.subcommand}: {error}", file=sys.stderr)
        return EXIT_USAGE
    except OSError as error:
        if error.filename is None:
            raise
        print(f"dmrac {parsed.subcommand}: {error.filename}: {error.strerror}", file=sys.stderr)
        return EXIT_USAGE
    except KeyboardInterrupt:
        return 130
    return status
