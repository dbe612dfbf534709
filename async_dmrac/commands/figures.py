"""`dmrac figures`: tables, figures and one page about a flown campaign."""

import argparse
from pathlib import Path

from async_dmrac.commands.shared import add_trust_option, plain_console
from configs.named_class import classes_for
from runtime.waiting import waiting

EXAMPLES = """examples:
  dmrac figures campaigns/rotor_chip
  dmrac figures campaigns/wind_figure8 --out /tmp/wind
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac figures`."""
    parser.add_argument("folder", type=Path, metavar="CAMPAIGN_OUT", help="folder of `dmrac campaign`")
    add_trust_option(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder to write (default: CAMPAIGN_OUT/figures)")


def run(arguments: argparse.Namespace) -> int:
    """Write the page; return 0."""
    from experiments.results.campaign_page import write_report

    console = plain_console()
    out = arguments.out or arguments.folder / "figures"
    with classes_for(arguments.trust), waiting(f"comparing and drawing {arguments.folder}", console):
        write_report(arguments.folder, out, console.print)
    console.print(f"written: {out / 'report.html'}")
    return 0
