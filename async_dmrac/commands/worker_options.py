"""What every command that flies side by side offers: how many workers, and a bar that shows how far it is."""

import argparse
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from experiments.campaigns.runner import Progress as CampaignProgress
from experiments.campaigns.worker_pools import DaskWorkers, LocalPool, Workers


def add_jobs_option(parser: argparse.ArgumentParser) -> None:
    """How many flights at a time on this machine; None: as many as `cores`."""
    parser.add_argument("--jobs", type=positive, metavar="N", help="flights side by side (default: one a core)")


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    """Where flights are flown, for `open_workers`."""
    add_jobs_option(parser)
    parser.add_argument("--scheduler", metavar="ADDRESS", help="fly on this Dask cluster instead, tcp://HOST:PORT")


def positive(text: str) -> int:
    """A number for argparse, 1 or more."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("at least 1")
    return value


def open_workers(arguments: argparse.Namespace) -> Workers:
    """What was asked for with `add_worker_options`: a Dask cluster, so many processes here, or one a core."""
    return DaskWorkers(arguments.scheduler) if arguments.scheduler else LocalPool(arguments.jobs or cores())


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
