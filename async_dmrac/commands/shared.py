"""Shared by the commands: options of the workers, the console, and a progress bar."""

import argparse
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from onboard.cores import CORES, NUMPY
from runtime.kernel import cores

if TYPE_CHECKING:  # the commands that fly no campaign run without pyarrow
    from experiments.campaigns.runner import Progress as CampaignProgress
    from experiments.campaigns.worker_pools import Workers


def add_jobs_option(parser: argparse.ArgumentParser) -> None:
    """Add the number of flights side by side on this machine; None: as many as `cores`."""
    parser.add_argument("--jobs", type=positive, metavar="N", help="flights side by side (default: one per core)")


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that `open_workers` reads."""
    add_jobs_option(parser)
    parser.add_argument("--scheduler", metavar="ADDRESS", help="fly on this Dask cluster instead, tcp://HOST:PORT")


def add_core_option(parser: argparse.ArgumentParser) -> None:
    """Add the name of the onboard core that flies."""
    parser.add_argument("--core", choices=CORES, default=NUMPY, help=f"the onboard core (default: {NUMPY})")


def add_trust_option(parser: argparse.ArgumentParser) -> None:
    """Add the option that allows a record to name classes that are not part of this project."""
    parser.add_argument(
        "--trust", action="store_true", help="run the code of classes that the record names and this project lacks"
    )


def positive(text: str) -> int:
    """Convert an option's text to a number of 1 or more."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("at least 1")
    return value


def open_workers(arguments: argparse.Namespace) -> "Workers":
    """Return the workers of `add_worker_options`: a Dask cluster, or processes of this machine."""
    from experiments.campaigns.worker_pools import DaskWorkers, LocalPool

    return DaskWorkers(arguments.scheduler) if arguments.scheduler else LocalPool(arguments.jobs or cores())


def plain_console(stderr: bool = False) -> Console:
    """Return a console that prints text as it is, on standard output or error: no wrapping, colours or markup."""
    return Console(highlight=False, soft_wrap=True, markup=False, stderr=stderr)


def continuing_command(arguments: argparse.Namespace) -> str:
    """Return the command that continues an interrupted campaign: as it was typed, with --resume.

    Without --retry-errors: the failed flights were dropped already, and those that fail again would be flown again.
    """
    words = [word for word in arguments.words if word not in ("--resume", "--retry-errors")]
    return shlex.join(["dmrac", *words, "--resume"])


@contextmanager
def progress_bar(name: str, console: Console) -> Iterator["Callable[[CampaignProgress], None]"]:
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

        def report(progress: "CampaignProgress") -> None:
            bar.update(
                task,
                total=progress.total,
                completed=progress.done,
                rate=progress.flights_per_s,
                lost=progress.lost,
                errors=progress.errors,
            )

        yield report
