"""`dmrac dropouts`: flies every recorded or made-up dropout of the link in lockstep and prints a table."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from async_dmrac.commands.worker_options import add_jobs_option, cores
from experiments.flights.scenario import DEFAULT_SCENARIO

if TYPE_CHECKING:
    from experiments.link.dropout_flights import DropoutFlight

EXAMPLES = """examples:
  dmrac dropouts                                   every trace of configs/dropouts, figure8_wind, dmrac
  dmrac dropouts blackout_10s recorded_bad         these only
  dmrac dropouts mine.csv --controller mrac        one of your own: dmrac replay FLIGHT --save-trace mine.csv
"""
DURATION_S = 30.0
FILE_WIDTH = 120
"""Columns of the table where there is no terminal."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac dropouts`."""
    parser.add_argument("traces", nargs="*", metavar="TRACE", help="names in configs/dropouts, or files (default: all)")
    parser.add_argument("--scenario", default=DEFAULT_SCENARIO, help=f"what is flown (default: {DEFAULT_SCENARIO})")
    parser.add_argument("--controller", help="name in configs/controllers, or a file (default: the scenario's)")
    parser.add_argument("--seed", type=int, help="of everything random (default: the scenario's)")
    parser.add_argument("--duration", type=float, default=DURATION_S, metavar="S", help="s a flight (default: 30)")
    add_jobs_option(parser)
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the rows as JSON too")


def run(arguments: argparse.Namespace) -> int:
    """Exit status: 0 every vehicle survived, 1 one was lost, 2 nothing was flown."""
    from experiments.link.dropout_flights import HEADINGS, fly_all

    flights = jobs(arguments)
    console = Console()
    if not console.is_terminal:
        console = Console(width=FILE_WIDTH)
    with console.status(f"{len(flights)} flights") as status:
        done: list[str] = []

        def report(row: object) -> None:
            done.append(str(row))
            status.update(f"{len(done)} of {len(flights)} flights")

        rows = fly_all(flights, arguments.jobs or cores(), report)
    controller = f"controller {arguments.controller}" if arguments.controller else "the scenario's controller"
    table = Table(title=f"{arguments.scenario}, {arguments.duration:g} s, {controller}", title_justify="left")
    for index, heading in enumerate(HEADINGS):
        inner = 0 < index < len(HEADINGS) - 1
        table.add_column(heading, justify="right" if inner else "left", no_wrap=index == 0)
    for row in rows:
        table.add_row(*row.cells(), style=None if row.survived else "bold red")
    console.print(table)
    if arguments.out is not None:
        arguments.out.write_text(json.dumps([row.record() for row in rows], indent=1) + "\n", encoding="utf-8")
    return 0 if all(row.survived for row in rows) else 1


def jobs(arguments: argparse.Namespace) -> "list[DropoutFlight]":
    """The flights that were asked for, the perfect link first. Raises ConfigError before anything is flown."""
    from experiments.flights.scenario import Choices, resolve
    from experiments.link.dropout_flights import PERFECT, DropoutFlight
    from experiments.link.dropout_trace import load_trace, trace_names

    resolve(arguments.scenario, Choices(arguments.controller, arguments.seed, arguments.duration))
    traces = arguments.traces or trace_names()
    for trace in traces:
        load_trace(trace)
    return [
        DropoutFlight(trace, arguments.scenario, arguments.controller, arguments.seed, arguments.duration)
        for trace in (PERFECT, *traces)
    ]
