"""`dmrac margins`: gain, phase and delay margin of every loop of a controller, measured in flight and predicted."""

import argparse
import json
from pathlib import Path

from rich.table import Table

from async_dmrac.commands.output import add_json_option, console_for, print_json
from configs.flight_tree import Choices
from configs.loader import ConfigError
from runtime.waiting import waiting

EXAMPLES = """examples:
  dmrac margins dmrac
  dmrac margins l1 --vehicle mambo_real --bode margins.png
  dmrac margins pid --set onboard.airframe.motor_response_s=0.05 --out margins.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac margins`."""
    parser.add_argument("controller", help="name in configs/controllers, or a file")
    parser.add_argument("--scenario", default="hover", help="scenario to fly (default: hover)")
    parser.add_argument("--vehicle", metavar="NAME", help="in configs/vehicles, or a file (default: the scenario's)")
    parser.add_argument("--seed", type=int, default=3, help="seed of all random values (default: 3)")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="assignments")
    parser.add_argument("--bode", type=Path, metavar="FILE", help="also draw the loops into a PNG")
    parser.add_argument("--out", type=Path, metavar="FILE", help="also write the margins as JSON")
    add_json_option(parser, "the margins")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print the table; returns 0, or 1 if the vehicle crashed."""
    from experiments.flights.scenario import resolve
    from experiments.margins.bode import draw_bode
    from experiments.margins.measurement import LoopMeasurementError, flight_time_s
    from experiments.margins.table import HEADINGS, as_json, cells, measure_all

    choices = Choices(
        arguments.controller, arguments.seed, flight_time_s(), arguments.assignments, vehicle_file=arguments.vehicle
    )
    config = resolve(arguments.scenario, choices)
    console = console_for(arguments)
    try:
        with waiting(f"{config.controller}: two flights of up to {flight_time_s():.0f} s in lockstep"):
            loops = measure_all(config)
    except LoopMeasurementError as error:
        console.print(str(error), markup=False, highlight=False)
        return 1
    entries = as_json(config.controller, loops)
    if arguments.json:
        print_json(entries)
    table = Table(title=f"{config.controller}, {config.scenario}: measured in flight (predicted)", title_justify="left")
    for index, heading in enumerate(HEADINGS):
        table.add_column(heading, justify="left" if index == 0 else "right")
    for loop in loops:
        table.add_row(*cells(loop))
    if not arguments.json:
        console.print(table)
    if arguments.out is not None:
        try:
            arguments.out.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"--out {arguments.out}: cannot be written: {error.strerror}") from None
    if arguments.bode is not None:
        draw_bode(config.controller, loops, arguments.bode)
    return 0
