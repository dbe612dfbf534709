"""`dmrac refly`: repeats some of a campaign's flights and compares them with its rows, flight by flight or by core."""

import argparse
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from onboard.cores import CORES

if TYPE_CHECKING:
    from rich.console import Console

    from experiments.campaigns.flown import FlownCampaign
    from experiments.campaigns.refly import Reflown

EXAMPLES = """examples:
  dmrac refly campaigns/rotor_chip                   one flight of each controller
  dmrac refly docs/data/*.parquet                    the same for the published rows
  dmrac refly campaigns/transfer --sample 20 --seed 1
  dmrac refly campaigns/survival --core numpy --controllers dmrac,l1 --sample 200
                                                     the same flights by the other core: survivors and medians
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
    parser.add_argument(
        "--controllers", type=lambda text: text.split(","), metavar="A,B", help="only flights of these controllers"
    )
    parser.add_argument(
        "--core",
        choices=CORES,
        help="fly with this core, and compare survivors and medians if another one flew (default: the core that flew)",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the choice (default: 0)")
    add_trust_option(parser)
    add_worker_options(parser)
    add_json_option(parser, "the comparison of each campaign")


def run(arguments: argparse.Namespace) -> int:
    """Repeat flights; return 0 (all the same), 1 (some differ) or 130 (interrupted)."""
    from experiments.campaigns.flown import read_flown
    from experiments.campaigns.refly import pick, refly

    console, results = plain_console(arguments.json), []
    campaigns = [read_flown(place) for place in arguments.places]
    with classes_for(arguments.trust):
        picked = [pick(flown, arguments.sample, arguments.seed, arguments.controllers) for flown in campaigns]
    all_same = True
    for flown, keys in zip(campaigns, picked, strict=True):
        name = flown.about.name
        with tempfile.TemporaryDirectory(prefix="dmrac_refly_") as folder, progress_bar(name, console) as report:
            flights = refly(flown, keys, Path(folder), open_workers(arguments), report, arguments.core)
        compare = _compare_flights if arguments.core in (None, flown.about.core) else _compare_cores
        same, found = compare(flown, flights, arguments.core, console)
        all_same = all_same and same
        results.append({"campaign": name, "flights": len(flights), **found})
    if arguments.json:
        print_json(results)
    return 0 if all_same else 1


def _compare_flights(
    flown: "FlownCampaign", flights: "list[Reflown]", _: str | None, console: "Console"
) -> tuple[bool, dict[str, Any]]:
    """Whether all are the same to the bit, and the differences for programs; tell both."""
    from experiments.campaigns.provenance import openblas_kernels, other_kernels

    others = [flight for flight in flights if not flight.same]
    console.print(
        f"{flown.about.name}: {len(flights)} of {len(flown.table)} flights flown again, "
        f"{len(flights) - len(others)} of them the same to the bit"
    )
    for flight in others:
        console.print(f"  {flight.recorded['key']}: {flight.difference}")
    if others and (advice := other_kernels(flown.about.flown_on, openblas_kernels())):
        console.print(f"  {advice}")
    return not others, {"differences": {flight.recorded["key"]: flight.difference for flight in others}}


def _compare_cores(
    flown: "FlownCampaign", flights: "list[Reflown]", core: str | None, console: "Console"
) -> tuple[bool, dict[str, Any]]:
    """Whether both cores give the same statistics, and these for programs; tell both."""
    from experiments.campaigns.refly import MEDIAN_SHARE_MAX, core_statistics

    rows = core_statistics(flights)
    console.print(
        f"{flown.about.name}: {len(flights)} flights of {flown.about.core} flown with {core}; the same: as many "
        f"survive, and the median position RMSE differs by at most {MEDIAN_SHARE_MAX:.0%}"
    )
    for row in rows:
        before, now = row.median_m
        console.print(
            f"  {row.case} {row.controller}: {row.survived[0]} and {row.survived[1]} of {row.flights} survive, "
            f"{1e3 * before:.2f} and {1e3 * now:.2f} mm ({now / before - 1.0:+.2%})"
            + ("" if row.same else ", not the same")
        )
    return all(row.same for row in rows), {"cores": [asdict(row) | {"same": row.same} for row in rows]}
