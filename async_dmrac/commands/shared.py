"""Shared by the commands: options of the workers, the console, and a progress bar."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from experiments.campaigns.runner import Progress as CampaignProgress
from experiments.campaigns.worker_pools import DaskWorkers, LocalPool, Workers, cores


def add_jobs_option(parser: argparse.ArgumentParser) -> None:
    """Add the number of flights side by side on this machine; None: as many as `cores`."""
    parser.add_argument("--jobs", type=positive, metavar="N", help="flights side by side (default: one per core)")


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that `open_workers` reads."""
    add_jobs_option(parser)
    parser.add_argument("--scheduler", metavar="ADDRESS", help="fly on this Dask cluster instead, tcp://HOST:PORT")


def positive(text: str) -> int:
    """Convert an option's text to a number of 1 or more."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("at least 1")
    return value


def open_workers(arguments: argparse.Namespace) -> Workers:
    """Return the workers of `add_worker_options`: a Dask cluster, or processes of this machine."""
    return DaskWorkers(arguments.scheduler) if arguments.scheduler else LocalPool(arguments.jobs or cores())


def plain_console() -> Console:
    """Return a console that prints text as it is: no wrapping, colours or markup."""
    return Console(highlight=False, soft_wrap=True, markup=False)


@contextmanager
def progress_bar(name: str, console: Console) -> Iterator[Callable[[CampaignProgress], None]]:
    """Show a bar with count, rate, elapsed and remaining time; yield the function that updates it."""
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
