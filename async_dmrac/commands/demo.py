"""`dmrac demo`: the same wind with pid and with dmrac, in lockstep, with one picture."""

import argparse
from pathlib import Path

from async_dmrac.commands.output import add_json_option, print_json
from async_dmrac.commands.shared import plain_console
from configs.loader import ConfigError

DESCRIPTION = "Fly a figure-8 through a fan's jet with pid and with dmrac, in virtual time, and draw both side by side."
EXAMPLES = """examples:
  dmrac demo
  dmrac demo --seed 7 --out wind.png
  dmrac demo --set vehicle.disturbances.0.speed_m_s=4.0
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac demo`."""
    from experiments.flights.demo import DURATION_S

    parser.add_argument("--seed", type=int, help="seed of all random values (default: the scenario's)")
    parser.add_argument("--duration", type=float, default=DURATION_S, metavar="S", help="of each flight (%(default)g)")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a value by path")
    parser.add_argument("--out", type=Path, default=Path("demo.png"), metavar="FILE", help="picture (%(default)s)")
    add_json_option(parser, "both errors")


def run(arguments: argparse.Namespace) -> int:
    """Fly both, draw and print; returns 0, or 1 if a vehicle was lost. Raises ConfigError."""
    from experiments.flights.demo import demo_configs, draw_demo, fly_demo, summary
    from experiments.flights.lockstep_status import LockstepStatus

    if arguments.out.suffix not in (".png", ".svg", ".pdf"):
        raise ConfigError(f"--out {arguments.out}: expected a name that ends in .png, .svg or .pdf")
    if not arguments.out.parent.is_dir():  # before the flights, not after
        raise ConfigError(f"--out {arguments.out}: there is no folder {arguments.out.parent}")
    configs = demo_configs(arguments.seed, arguments.duration, tuple(arguments.set))
    console = plain_console(arguments.json)
    flights = []
    for config in configs:
        console.print(f"flying {config.scenario} with {config.controller}, {config.duration_s:g} s in virtual time")
        with LockstepStatus(console, config.duration_s) as status:
            flights.append(fly_demo(config, (status,)))
    both = tuple(flights)
    draw_demo(both, arguments.out)
    if arguments.json:
        names = ("crash_reason", "first_lap_rmse_m", "settled_rmse_m", "feature_versions")
        values = {one.config.controller: {name: getattr(one, name) for name in names} for one in both}
        print_json({"picture": str(arguments.out), "flights": values})
    else:
        for line in (*summary(both), f"picture: {arguments.out}"):
            console.print(line)
    return int(any(flight.crash_reason for flight in both))
