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
    from experiments.results.campaign_data import load_data
    from experiments.results.campaign_page import write_page
    from experiments.results.figure_plan import draw_all
    from experiments.results.tables import markdown_report

    console = Console()
    data = load_data(arguments.folder)
    out = arguments.out or arguments.folder / "figures"
    out.mkdir(parents=True, exist_ok=True)
    pictures, extra = draw_all(data, out, lambda text: console.print(text, highlight=False, soft_wrap=True))
    write_page(out / "report.html", data, pictures, extra)
    listed = [(picture.png.relative_to(out), picture.caption) for picture in pictures]
    text = markdown_report(data, listed)
    (out / "report.md").write_text(text + "\n".join(table.markdown() for table in extra), encoding="utf-8")
    console.print(f"written: {out / 'report.html'}", soft_wrap=True, highlight=False)
    return 0
