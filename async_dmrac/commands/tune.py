"""`dmrac tune`: searches a controller's gains on training seeds and writes them into its file."""

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from async_dmrac.commands.output import add_json_option, print_json
from async_dmrac.commands.shared import add_core_option, add_jobs_option, plain_console, positive
from configs.parts import named_file
from runtime.kernel import cores

if TYPE_CHECKING:
    import optuna

EXAMPLES = """examples:
  dmrac tune tune --controller pid --trials 60
  dmrac tune tune --controller dmrac --trials 60 --jobs 8
  dmrac tune tune --controller pid --trials 3 --dry-run     show the best values, write nothing
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac tune`."""
    parser.add_argument("campaign", help="tuning campaign: name in configs/campaigns, or a file")
    parser.add_argument("--controller", required=True, help="name in configs/controllers, or a file")
    parser.add_argument(
        "--trials", type=positive, required=True, metavar="N", help="flown trials; those of earlier runs count"
    )
    add_jobs_option(parser)
    add_core_option(parser)
    parser.add_argument("--seed", type=int, default=0, help="seed of the sampler (default 0)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the search (default: campaigns/NAME)")
    add_json_option(parser, "the best values")
    parser.add_argument("--dry-run", action="store_true", help="do not write the controller file")


def run(arguments: argparse.Namespace) -> int:
    """Search; return 0 (searched and written) or 130 (interrupted; the same command continues the search)."""
    import optuna

    from experiments.campaigns.controller_file import write_tuned
    from experiments.campaigns.search_space import near_an_end
    from experiments.campaigns.tuning import (
        Search,
        load_tuning,
        open_study,
        run_search,
        search_record,
        tuned_values,
    )
    from experiments.campaigns.worker_pools import LocalPool

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    config, path = load_tuning(arguments.campaign)
    search = Search(config, path.stem, arguments.controller, arguments.trials, arguments.seed, arguments.core)
    target = named_file("controllers", arguments.controller)
    study = open_study(search, arguments.out or Path("campaigns") / path.stem)
    console, pool = plain_console(arguments.json), LocalPool(arguments.jobs or cores(), recycle=False)
    try:
        run_search(search, study, pool.open(), _Report(console, search.trials))
    except KeyboardInterrupt:
        console.print("interrupted; the search is stored, the same command continues it")
        return 130
    finally:
        pool.close()
    record, values = search_record(search, study), tuned_values(search, study)
    for line in (*record, *(f"  {name}: {value:.4g}" for name, value in values.items())):
        console.print(line)
    if ends := near_an_end(config.space(search.controller), study.best_params):
        console.print(f"near an end of their ranges in {path}: {', '.join(ends)}")
    if arguments.json:
        print_json({"controller": arguments.controller, "values": values, "search": list(record)})
    if not arguments.dry_run:
        write_tuned(target, values, record)
        console.print(f"written: {target}")
    return 0


class _Report:
    """Prints one line per trial, with the remaining time at the present pace."""

    def __init__(self, console: Console, trials: int) -> None:
        self._console = console
        self._trials = trials
        self._started_s = time.monotonic()
        self._flown = 0

    def __call__(self, study: "optuna.Study") -> None:
        from experiments.campaigns.tuning import ENDED, flown_values

        self._flown += 1
        best = flown_values(study)
        left = max(self._trials - len(best), 0)
        left_s = (time.monotonic() - self._started_s) / self._flown * left
        value = study.get_trials(deepcopy=False, states=ENDED)[-1].value
        self._console.print(
            f"trial {len(best)} of {self._trials}: {'stopped early' if value is None else f'{value:.4f}'}, "
            f"best {best[-1]:.4f}, {len(study.trials)} sets of gains, {left_s / 60.0:.0f} min left"
        )
