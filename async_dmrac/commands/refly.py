"""`dmrac refly`: repeats some of a campaign's flights and compares them with its rows."""

import argparse
import tempfile
from pathlib import Path

from async_dmrac.commands.output import add_json_option, print_json
from async_dmrac.commands.shared import (
    add_trust_option,
    add_worker_options,
    open_workers,
    plain_console,
    positive,
    progress_bar,
)
from configs.named_class import classes_for

EXAMPLES = """examples:
  dmrac refly campaigns/rotor_chip                   one flight of each controller
  dmrac refly docs/data/*.parquet                    the same for the published rows
  dmrac refly campaigns/transfer --sample 20 --seed 1
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac refly`."""
    parser.add_argument(
        "places",
        type=Path,
        nargs="+",
        metavar="CAMPAIGN_OUT",
        help="folder of `dmrac campaign`, or a file of docs/data",
    )
    parser.add_argument(
        "--sample", type=positive, metavar="N", help="flights of each campaign (default: one per controller)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the choice (default: 0)")
    add_trust_option(parser)
    add_worker_options(parser)
    add_json_option(parser, "the comparison of each campaign")


def run(arguments: argparse.Namespace) -> int:
    """Repeat flights; return 0 (all the same to the bit), 1 (some differ) or 130 (interrupted)."""
    from experiments.campaigns.flown import read_flown
    from experiments.campaigns.provenance import openblas_kernels, other_kernels
    from experiments.campaigns.refly import pick, refly

    console, results = plain_console(arguments.json), []
    campaigns = [read_flown(place) for place in arguments.places]
    with classes_for(arguments.trust):
        picked = [pick(flown, arguments.sample, arguments.seed) for flown in campaigns]
    all_same = True
    for flown, keys in zip(campaigns, picked, strict=True):
        name = flown.about.name
        with tempfile.TemporaryDirectory(prefix="dmrac_refly_") as folder, progress_bar(name, console) as report:
            flights = refly(flown, keys, Path(folder), open_workers(arguments), report)
        others = [flight for flight in flights if not flight.same]
        all_same = all_same and not others
        differences = {flight.recorded["key"]: flight.difference for flight in others}
        results.append({"campaign": name, "flights": len(flights), "differences": differences})
        console.print(
            f"{name}: {len(flights)} of {len(flown.table)} flights flown again, "
            f"{len(flights) - len(others)} of them the same to the bit"
        )
        for flight in others:
            console.print(f"  {flight.recorded['key']}: {flight.difference}")
        if others and (advice := other_kernels(flown.about.flown_on, openblas_kernels())):
            console.print(f"  {advice}")
    if arguments.json:
        print_json(results)
    return 0 if all_same else 1
