"""`dmrac bench`: times the onboard step, the loop, the simulated vehicle, the trainer and lockstep."""

import argparse
import json
from pathlib import Path
from typing import Final

from async_dmrac.commands.shared import plain_console
from configs.loader import ConfigError
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, resolve

EXAMPLES: Final = """examples:
  dmrac bench
  dmrac bench figure8_wind --controller mrac --seconds 30 --json bench.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac bench`."""
    parser.add_argument("scenario", nargs="?", default=DEFAULT_SCENARIO, help="scenario to fly (default: %(default)s)")
    parser.add_argument("--controller", help="another controller than the scenario's")
    parser.add_argument("--seconds", type=float, default=15.0, help="flight time to measure, 2 to 600 s")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a value by path")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the numbers to this file")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print; return 0. Raises ConfigError for bad options."""
    from experiments.timing.benchmark import measure

    if not 2.0 <= arguments.seconds <= 600.0:
        raise ConfigError(f"--seconds {arguments.seconds:g}: allowed are 2 to 600")
    choices = Choices(arguments.controller, None, max(arguments.seconds, 5.0), tuple(arguments.set))
    report = measure(resolve(arguments.scenario, choices), arguments.seconds, plain_console().print)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return 0
