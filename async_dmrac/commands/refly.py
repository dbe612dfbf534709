"""`dmrac refly`: flies some of a campaign's flights again and compares them with its rows."""

import argparse
import tempfile
from pathlib import Path

from rich.console import Console

from async_dmrac.commands.worker_options import add_worker_options, open_workers, positive, progress_bar

EXAMPLES = """examples:
  dmrac refly campaigns/rotor_chip                   a flight of each controller
  dmrac refly docs/data/*.parquet                    of the published ones
  dmrac refly campaigns/transfer --sample 20 --seed 1
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac refly`."""
    parser.add_argument(
        "places",
        type=Path,
        nargs="+",
        metavar="CAMPAIGN_OUT",
        help="what `dmrac campaign` wrote, or a file of docs/data",
    )
    parser.add_argument("--sample", type=positive, metavar="N", help="flights of each (default: one a controller)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="draws which ones (default: 0)")
    add_worker_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Exit status: 0 all the same to the bit, 1 some differ, 130 interrupted."""
    from experiments.campaigns.flown import read_flown
    from experiments.campaigns.provenance import openblas_kernels, other_kernels
    from experiments.campaigns.refly import pick, refly

    console = Console()
    campaigns = [read_flown(place) for place in arguments.places]
    picked = [pick(flown, arguments.sample, arguments.seed) for flown in campaigns]
    differ = 0
    for flown, keys in zip(campaigns, picked, strict=True):
        name = flown.about.name
        with tempfile.TemporaryDirectory(prefix="dmrac_refly_") as folder, progress_bar(name, console) as report:
            workers = open_workers(arguments)
            flights = refly(flown, keys, Path(folder), workers, report)
        others = [flight for flight in flights if not flight.same]
        differ += len(others)
        console.print(
            f"{name}: {len(flights)} of {len(flown.table)} flights flown again, "
            f"{len(flights) - len(others)} of them the same to the bit",
            soft_wrap=True,
            highlight=False,
        )
        for flight in others:
            console.print(
                f"  {flight.recorded['key']}: {flight.difference}", soft_wrap=True, highlight=False, markup=False
            )
        if others and (advice := other_kernels(flown.about.flown_on, openblas_kernels())):
            console.print(f"  {advice}", soft_wrap=True, highlight=False, markup=False)
    return 1 if differ else 0
