"""`dmrac attack`: flies a corpus of bad learners in lockstep and prints what they did."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from async_dmrac.commands.output import add_json_option, print_json
from async_dmrac.commands.shared import add_core_option, add_jobs_option, plain_console, positive
from configs.loader import ConfigError
from runtime.kernel import cores
from runtime.waiting import waiting

if TYPE_CHECKING:
    from experiments.attacks.attack_flight import AttackFlight, AttackOutcome
    from experiments.attacks.corpus import CorpusRow

EXAMPLES = """examples:
  dmrac attack                                     every case, one seed
  dmrac attack --case steep --case search --seeds 5
  dmrac attack --condition calm --condition jet_8 --condition chip --core c --out attacks   the same command goes on
  dmrac attack --json --set vehicle.disturbances.0.speed_m_s=8.0
  dmrac attack --search 200 --core c --out attack_search    look for worse versions that are accepted
"""
COLUMNS = ("case", "flights", "lost", "error / bias", "largest", "worst m", "accepted", "refused")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac attack`."""
    parser.add_argument("--case", action="append", metavar="NAME", help="case of the corpus (default: all); repeatable")
    parser.add_argument("--seeds", type=positive, default=1, help="flights of each case and condition (default: 1)")
    parser.add_argument("--first-seed", type=int, help="seed of the first one (default: 1000; of a search 0)")
    parser.add_argument("--scenario", default="figure8_wind", help="scenario to fly (default: figure8_wind)")
    parser.add_argument("--controller", default="dmrac", help="controller with learnt features (default: dmrac)")
    parser.add_argument(
        "--condition",
        action="append",
        metavar="NAME",
        help="scenario (default: as it is), calm, jet_4, jet_8, or chip (jet_8, and a rotor loses 25 %%); repeatable",
    )
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="change one value")
    add_json_option(parser, "a list of {case, flights, lost, error_ratio_to_bias}")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep each flight there; the same command goes on")
    parser.add_argument(
        "--search", type=positive, metavar="N", help="fly N trials of an optimiser for the worst accepted versions"
    )
    parser.add_argument("--keep", action="store_true", help="write the search's best finds into the corpus")
    add_jobs_option(parser)
    add_core_option(parser)


def run(arguments: argparse.Namespace) -> int:
    """Fly and print; return 0 (no vehicle lost), 1, or 130 (interrupted). Raises ConfigError."""
    if arguments.keep and not arguments.search:
        raise ConfigError("--keep: writes what a search has found; expected --search N as well")
    if arguments.search and arguments.case:
        raise ConfigError("--case: a search makes its own; expected --search N without it")
    try:
        return _search(arguments) if arguments.search else _fly(arguments)
    except KeyboardInterrupt:
        goes_on = " The same command goes on." if arguments.out else ""
        print(f"interrupted.{goes_on}", file=sys.stderr)
        return 130


def _flight(arguments: argparse.Namespace, case: str, seed: int, condition: str) -> "AttackFlight":
    from experiments.attacks.attack_flight import AttackFlight

    choices = arguments.scenario, arguments.controller, tuple(arguments.set)
    return AttackFlight(case, seed, condition, *choices, core=arguments.core)


def _fly(arguments: argparse.Namespace) -> int:
    from experiments.attacks.cases import CASES
    from experiments.attacks.corpus import check, fly_corpus
    from experiments.attacks.journal import Journal
    from experiments.campaigns.provenance import commit

    cases = arguments.case or list(CASES)
    unknown = [case for case in cases if case not in CASES]
    if unknown:
        raise ConfigError(f"--case: {unknown[0]!r} unknown; allowed are {', '.join(CASES)}")
    first = 1000 if arguments.first_seed is None else arguments.first_seed
    flights = [
        _flight(arguments, case, seed, condition)
        for seed in range(first, first + arguments.seeds)
        for condition in arguments.condition or ["scenario"]
        for case in cases
    ]
    check(flights)
    with waiting(f"{len(flights)} flights, and those of bias for comparison"):
        rows = fly_corpus(flights, Journal(arguments.out, commit()), arguments.jobs or cores(), _report)
    if arguments.json:
        print_json([row.summary() for row in rows])
    else:
        _print_table(rows)
    return 1 if any(row.lost for row in rows) else 0


def _print_table(rows: "list[CorpusRow]") -> None:
    table = Table(*COLUMNS, title="bad learners")
    for row in rows:
        table.add_row(*row.cells(), style="bold red" if row.lost else None)
    plain_console().print(table)


def _report(flight: "AttackFlight", outcome: "AttackOutcome") -> None:
    lost = f"LOST: {outcome.lost}" if outcome.lost else f"{outcome.error_m:.3f} m"
    who = flight.case if flight.controller != "bias" else "bias, for comparison"
    print(f"{who}, {flight.condition}, seed {flight.seed}: {lost}", file=sys.stderr)


def _search(arguments: argparse.Namespace) -> int:
    import optuna

    from experiments.attacks.search import Search, best, keep, run_search
    from experiments.attacks.strategies import FINDS

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    first = 0 if arguments.first_seed is None else arguments.first_seed
    flights = tuple(
        _flight(arguments, "search", seed, condition)
        for seed in range(first, first + arguments.seeds)
        for condition in arguments.condition or ["scenario"]
    )
    search = Search(flights, arguments.search, arguments.out or Path("attack_search"))
    with waiting(f"{arguments.search} trials"):
        study = run_search(search, arguments.jobs or cores(), lambda text: print(text, file=sys.stderr))
    if arguments.keep:
        keep(study, " ".join(["dmrac", *sys.argv[1:]]), FINDS)
    print_json([one.entry() for one in best(study)])
    return 0
