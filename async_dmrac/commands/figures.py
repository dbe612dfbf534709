"""`dmrac figures`: tables, figures and one page about a campaign that was flown."""

import argparse
from pathlib import Path

from rich.console import Console

EXAMPLES = """examples:
  dmrac figures campaigns/rotor_chip
  dmrac figures campaigns/wind_figure8 --out /tmp/wind
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac figures`."""
    parser.add_argument("folder", type=Path, metavar="CAMPAIGN_OUT", help="what `dmrac campaign` wrote")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where to write (default: CAMPAIGN_OUT/figures)")


def run(arguments: argparse.Namespace) -> int:
    """Exit status: 0 written, 2 not a campaign's folder."""
    from experiments.results.campaign_page import write_report

    console = Console(highlight=False, soft_wrap=True)
    out = arguments.out or arguments.folder / "figures"
    write_report(arguments.folder, out, console.print)
    console.print(f"written: {out / 'report.html'}")
    return 0
