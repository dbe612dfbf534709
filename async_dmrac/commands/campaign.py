"""`dmrac campaign`: flies scenario x controllers x sweeps x seeds, in parallel, into one Parquet file."""

import argparse
from pathlib import Path

from async_dmrac.commands.shared import (
    add_core_option,
    add_worker_options,
    continuing_command,
    open_workers,
    plain_console,
    positive,
    progress_bar,
)
from experiments.campaigns.campaign import load_campaign
from experiments.campaigns.runner import CampaignRun, open_store, prepare_folder, run_campaign
from experiments.campaigns.store import drop_failed

EXAMPLES = """examples:
  dmrac campaign rotor_chip                          all cores, into campaigns/rotor_chip
  dmrac campaign rotor_chip --resume                 continue after an interruption
  dmrac campaign wind_figure8 --seeds 5 --jobs 2
  dmrac campaign wind_figure8 --core c --out campaigns/wind_c
  dmrac campaign transfer --scheduler tcp://10.0.0.1:8786
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac campaign`."""
    parser.add_argument("campaign", metavar="FILE", help="name in configs/campaigns, or a file")
    add_worker_options(parser)
    add_core_option(parser)
    parser.add_argument("--resume", action="store_true", help="continue the flights of the folder")
    parser.add_argument("--retry-errors", action="store_true", help="with --resume: repeat flights that failed")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the results (default: campaigns/NAME)")
    parser.add_argument("--seeds", type=positive, metavar="N", help="seeds per point (default: the campaign's)")


def run(arguments: argparse.Namespace) -> int:
    """Fly; return 0 (all flown), 1 (some flights failed) or 130 (interrupted)."""
    campaign, path = load_campaign(arguments.campaign)
    folder = arguments.out or Path("campaigns") / path.stem
    flights = CampaignRun(campaign, path.stem, folder, arguments.seeds, core=arguments.core)
    console, workers = plain_console(), open_workers(arguments)  # first: without workers no folder is made
    try:
        prepare_folder(flights, arguments.resume)
        if arguments.retry_errors:
            drop_failed(folder)
        with open_store(folder) as store, progress_bar(path.stem, console) as report:
            result = run_campaign(flights, store, workers, report)
    except KeyboardInterrupt:
        console.print(f"interrupted, all rows are stored. Continue with: {continuing_command(arguments)}")
        return 130
    finally:
        workers.close()
    console.print(
        f"{result.flown} flights at {result.flights_per_s:.2f} per second, {result.lost} vehicles lost, "
        f"{result.errors} flights failed; {result.done} of {result.total} in {folder}"
    )
    return 1 if result.errors else 0
