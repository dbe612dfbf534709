"""`dmrac soak`: flies for a long time while processes are stopped, killed and restarted and ports are flooded."""

import argparse
import os
import sys
from pathlib import Path

from async_dmrac.commands.output import add_json_option, print_json
from async_dmrac.commands.shared import plain_console
from configs.loader import ConfigError

DESCRIPTION = (
    "Fly in real time with all processes, and stop, kill and restart them and flood their ports, as the seed draws. "
    "Ends with a page: memory, missed ticks, escapes, events, and whether the vehicle is alive (docs/safety.md)."
)
EXAMPLES = """examples:
  dmrac soak --minutes 3                     a short one
  dmrac soak --minutes 30 --seed 2           another draw, half an hour
  dmrac soak --minutes 3 --json              numbers instead of a table
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac soak`."""
    parser.add_argument("--minutes", type=float, default=3.0, help="of the flight (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of everything that is drawn (default: %(default)s)")
    parser.add_argument("--scenario", default="figure8_wind", help="to fly (default: %(default)s)")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="change one value")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the record (default: flights/...)")
    add_json_option(parser, "the numbers")


def run(arguments: argparse.Namespace) -> int:
    """Fly and judge; return 0 (all as promised) or 1. Raises ConfigError or StartError before anything flies."""
    from experiments.flights.flight_folder import make_folder
    from experiments.soak.page import numbers, result_rows, slope_text, write
    from experiments.soak.soak import MINUTES_MAX, MINUTES_MIN, configuration, soak
    from experiments.soak.verdict import judge

    if not MINUTES_MIN <= arguments.minutes <= MINUTES_MAX:
        raise ConfigError(f"--minutes {arguments.minutes:g}: allowed are {MINUTES_MIN:g} to {MINUTES_MAX:g}")
    if not 0 <= arguments.seed < 2**31:
        raise ConfigError(f"--seed {arguments.seed}: allowed are 0 to {2**31 - 1}")
    console = plain_console(arguments.json)
    config = configuration(arguments.scenario, arguments.minutes, arguments.seed, tuple(arguments.set))
    folder = make_folder(arguments.out, "soak")
    if os.geteuid() != 0:
        print("soak: without root no port is flooded", file=sys.stderr)
    done = soak(config, folder, arguments.seed, console.print)
    verdict = judge(done, folder)
    file = write(done, verdict, folder)
    if arguments.json:
        print_json(numbers(done, verdict))
    else:
        for name, text in result_rows(done, verdict):
            console.print(f"{name:27} {text}")
        for one in verdict.memory:
            console.print(f"{'memory of ' + one.process:27} {one.last_mb:.1f} MB, {slope_text(one)} MB/min")
        console.print(f"{'page':27} {file}")
        console.print("passed" if not verdict.failures else "FAILED: " + "; ".join(verdict.failures))
    return int(bool(verdict.failures))
