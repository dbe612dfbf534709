"""`dmrac campaign`: flies scenario x controllers x sweeps x seeds, in parallel, into one Parquet file."""

import argparse
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from experiments.campaigns.runner import (
    CampaignRun,
    DaskWorkers,
    LocalPool,
    Workers,
    open_store,
    prepare_folder,
    run_campaign,
)
from experiments.campaigns.runner import Progress as CampaignProgress

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


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    """Where flights are flown, for `open_workers`."""
    parser.add_argument("--jobs", type=positive, metavar="N", help="worker processes (default: one a core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="fly on this Dask cluster instead, tcp://HOST:PORT")


def positive(text: str) -> int:
    """A number for argparse, 1 or more."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("at least 1")
    return value


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


def open_workers(arguments: argparse.Namespace) -> Workers:
    """What was asked for with `add_worker_options`: a Dask cluster, so many processes here, or one a core."""
    return DaskWorkers(arguments.scheduler) if arguments.scheduler else LocalPool(arguments.jobs or cores())


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def forget_errors(folder: Path) -> None:
    """Drops rows with an error, so that their flights are flown again."""
    from experiments.campaigns.store import drop_rows, read_table

    table = read_table(folder)
    failed = {row["key"] for row in table.select(["key", "error"]).to_pylist() if row["error"]}
    drop_rows(folder, failed)


@contextmanager
def progress_bar(name: str, console: Console) -> Iterator[Callable[[CampaignProgress], None]]:
    """A bar with count, rate, time passed and time left; gives the function that moves it."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]:.2f}/s  lost {task.fields[lost]}  failed {task.fields[errors]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=False),
    )
    with Progress(*columns, console=console, speed_estimate_period=120.0) as bar:
        task = bar.add_task(name, total=None, rate=0.0, lost=0, errors=0)

        def report(progress: CampaignProgress) -> None:
            bar.update(
                task,
                total=progress.total,
                completed=progress.done,
                rate=progress.flights_per_s,
                lost=progress.lost,
                errors=progress.errors,
            )

        yield report
