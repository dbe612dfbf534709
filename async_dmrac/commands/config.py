"""`dmrac config`: the resolved configuration of a scenario, with its default values marked.

Processes that are started one by one read it with `--config`.
"""

import argparse
from pathlib import Path

from configs.flight_tree import PORTS_EACH
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, resolve

EXAMPLES = """A comment "# default" stands behind every value that is the default.

examples:
  dmrac config figure8_wind > flight.yaml
  dmrac config figure8_calm --real --out flight.yaml
  dmrac config hover --vehicle 2 --out second.yaml          for a second vehicle that flies at the same time
  dmrac sim --config flight.yaml & dmrac offboard --config flight.yaml & dmrac onboard --config flight.yaml
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac config`."""
    parser.add_argument("scenario", nargs="?", default=DEFAULT_SCENARIO, help="name in configs/scenarios, or a file")
    parser.add_argument("--controller", help="name in configs/controllers, or a file")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--duration", type=float, metavar="S")
    parser.add_argument("--real", action="store_true", help="for a real vehicle: see docs/real_mambo.md")
    parser.add_argument(
        "--vehicle",
        type=int,
        default=1,
        metavar="N",
        help="number of the vehicle where several fly (default: 1): its id, and ports that are "
        f"{PORTS_EACH} (N - 1) higher; with --real the ports of vehicle and ground station stay",
    )
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="assignments")
    parser.add_argument("--out", type=Path, metavar="FILE", help="where to write (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Write the configuration; returns 0."""
    choices = Choices(
        arguments.controller,
        arguments.seed,
        arguments.duration,
        arguments.assignments,
        arguments.real,
        arguments.vehicle,
    )
    text = resolve(arguments.scenario, choices).to_yaml()
    if arguments.out is None:
        print(text, end="")
    else:
        arguments.out.write_text(text, encoding="utf-8")
    return 0
