"""`dmrac dropouts`: flies dropout traces of the link, recorded or made up, in lockstep and prints a table."""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from async_dmrac.commands.output import add_json_option, print_json
from async_dmrac.commands.shared import add_jobs_option
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices
from runtime.kernel import cores

if TYPE_CHECKING:
    from experiments.link.dropout_flights import DropoutRow

EXAMPLES = """examples:
  dmrac dropouts                                   every trace of configs/dropouts, figure8_wind, dmrac
  dmrac dropouts blackout_10s recorded_bad         only these
  dmrac dropouts mine.csv --controller mrac        your own, from: dmrac replay FLIGHT --save-trace mine.csv
"""
DURATION_S = 30.0
FILE_WIDTH = 120
"""Width of the table without a terminal, characters."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac dropouts`."""
    parser.add_argument("traces", nargs="*", metavar="TRACE", help="names in configs/dropouts, or files (default: all)")
    parser.add_argument("--scenario", default=DEFAULT_SCENARIO, help=f"scenario to fly (default: {DEFAULT_SCENARIO})")
    parser.add_argument("--controller", help="name in configs/controllers, or a file (default: the scenario's)")
    parser.add_argument("--seed", type=int, help="seed of all random values (default: the scenario's)")
    parser.add_argument("--duration", type=float, default=DURATION_S, metavar="S", help="of a flight, s (default: 30)")
    add_jobs_option(parser)
    parser.add_argument("--out", type=Path, metavar="FILE", help="also write the rows as JSON")
    add_json_option(parser, "the rows")


def run(arguments: argparse.Namespace) -> int:
    """Fly and print the table; return 0 (every vehicle survived) or 1 (one crashed)."""
    from experiments.link.dropout_flights import DropoutRow, flights_with, fly_all

    choices = Choices(arguments.controller, arguments.seed, arguments.duration)
    flights = flights_with(arguments.traces, arguments.scenario, choices)
    done: list[DropoutRow] = []
    progress = Console(stderr=True)
    with progress.status(f"{len(flights)} flights") as status:

        def report(row: DropoutRow) -> None:
            done.append(row)
            text = f"{len(done)} of {len(flights)} flights"
            status.update(text)
            if not progress.is_terminal:
                print(f"{text}: {row.trace}", file=sys.stderr, flush=True)

        rows = fly_all(flights, arguments.jobs or cores(), report)
    _print(arguments, rows)
    if arguments.out is not None:
        arguments.out.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
    return 0 if all(row.survived for row in rows) else 1


def _print(arguments: argparse.Namespace, rows: "list[DropoutRow]") -> None:
    """Print the rows as a table, or as JSON."""
    from experiments.link.dropout_flights import HEADINGS

    if arguments.json:
        print_json(rows)
        return
    console = Console()
    if not console.is_terminal:
        console = Console(width=FILE_WIDTH)
    controller = f"controller {arguments.controller}" if arguments.controller else "the scenario's controller"
    table = Table(title=f"{arguments.scenario}, {arguments.duration:g} s, {controller}", title_justify="left")
    for index, heading in enumerate(HEADINGS):
        inner = 0 < index < len(HEADINGS) - 1
        table.add_column(heading, justify="right" if inner else "left", no_wrap=index == 0)
    for row in rows:
        table.add_row(*row.cells(), style=None if row.survived else "bold red")
    console.print(table)
