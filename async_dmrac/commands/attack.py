"""`dmrac attack`: flies a corpus of bad learners in lockstep and prints what they did."""

import argparse
import json

from rich.table import Table

from async_dmrac.commands.shared import add_jobs_option, plain_console, positive
from configs.loader import ConfigError
from experiments.campaigns.worker_pools import cores

EXAMPLES = """examples:
  dmrac attack                                     every case, one seed
  dmrac attack --case steep --case search --seeds 5
  dmrac attack --json --set vehicle.disturbances.0.speed_m_s=8.0
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac attack`."""
    parser.add_argument("--case", action="append", metavar="NAME", help="case of the corpus (default: all); repeatable")
    parser.add_argument("--seeds", type=positive, default=1, help="flights of each case (default: 1)")
    parser.add_argument("--first-seed", type=int, default=1000, help="seed of the first one (default: 1000)")
    parser.add_argument("--scenario", default="figure8_wind", help="scenario to fly (default: figure8_wind)")
    parser.add_argument("--controller", default="dmrac", help="controller with learnt features (default: dmrac)")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="change one value")
    parser.add_argument(
        "--json", action="store_true", help="print a list of {case, flights, lost, error_ratio_to_bias}"
    )
    add_jobs_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Fly and print; return 0 (no vehicle lost) or 1. Raises ConfigError."""
    from experiments.attacks.cases import CASES
    from experiments.attacks.corpus import fly_corpus

    cases = arguments.case or list(CASES)
    unknown = [case for case in cases if case not in CASES]
    if unknown:
        raise ConfigError(f"--case: {unknown[0]!r} unknown; allowed are {', '.join(CASES)}")
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    rows = fly_corpus(
        *(cases, seeds, arguments.scenario, arguments.controller, tuple(arguments.set)), arguments.jobs or cores()
    )
    if arguments.json:
        print(json.dumps([row.summary() for row in rows], indent=1))
    else:
        table = Table("case", "flights", "lost", "error / bias", "worst m", "accepted", "refused", title="bad learners")
        for row in rows:
            table.add_row(*row.cells(), style="bold red" if row.lost else None)
        plain_console().print(table)
    return 1 if any(row.lost for row in rows) else 0
