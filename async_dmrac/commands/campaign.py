"""`dmrac campaign`: flies scenario x controllers x sweeps x seeds, in parallel, into one Parquet file."""

import argparse
from pathlib import Path

from rich.console import Console

from async_dmrac.commands.worker_options import add_worker_options, open_workers, positive, progress_bar
from experiments.campaigns.runner import CampaignRun, open_store, prepare_folder, run_campaign

EXAMPLES = """examples:
  dmrac campaign rotor_chip                          all cores, into campaigns/rotor_chip
  dmrac campaign rotor_chip --resume                 go on after an interruption
  dmrac campaign wind_figure8 --seeds 5 --jobs 2
  dmrac campaign transfer --scheduler tcp://10.0.0.1:8786
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac campaign`."""
    parser.add_argument("campaign", metavar="FILE", help="name in configs/campaigns, or a file")
    add_worker_options(parser)
    parser.add_argument("--resume", action="store_true", help="go on with what the folder holds")
    parser.add_argument("--retry-errors", action="store_true", help="with --resume: fly flights that failed again")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the results (default: campaigns/NAME)")
    parser.add_argument("--seeds", type=positive, metavar="N", help="seeds a point (default: the campaign's)")


def run(arguments: argparse.Namespace) -> int:
    """Exit status: 0 all flown, 1 some flights failed, 130 interrupted."""
    from experiments.campaigns.campaign import load_campaign

    campaign, path = load_campaign(arguments.campaign)
    folder = arguments.out or Path("campaigns") / path.stem
    flights = CampaignRun(campaign, path.stem, folder, arguments.seeds)
    prepare_folder(flights, arguments.resume)
    if arguments.retry_errors:
        forget_errors(folder)
    console = Console()
    workers = open_workers(arguments)
    try:
        with open_store(folder) as store, progress_bar(path.stem, console) as report:
            result = run_campaign(flights, store, workers, report)
    except KeyboardInterrupt:
        console.print(
            f"interrupted; everything flown is kept. Go on with: dmrac campaign {arguments.campaign} --resume"
        )
        return 130
    console.print(
        f"{result.flown} flights at {result.flights_per_s:.2f} a second, {result.lost} vehicles lost, "
        f"{result.errors} flights failed; {result.done} of {result.total} in {folder}",
        soft_wrap=True,
        highlight=False,
    )
    return 1 if result.errors else 0


def forget_errors(folder: Path) -> None:
    """Drops rows with an error, so that their flights are flown again."""
    from experiments.campaigns.store import drop_rows, read_table

    table = read_table(folder)
    failed = {row["key"] for row in table.select(["key", "error"]).to_pylist() if row["error"]}
    drop_rows(folder, failed)
