"""`dmrac report FLIGHT`: one self-contained page about a flight."""

import argparse
from pathlib import Path

from flight_log.report import write_report

DESCRIPTION = "Writes one self-contained HTML page about a flight: summary, figures, training, events, config."
EXAMPLES = """examples:
  dmrac report flights/20260101_120000_figure8_wind
  dmrac report FLIGHT -o /tmp/flight.html
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the subcommand's options."""
    parser.add_argument("flight", type=Path, metavar="FLIGHT", help="a flight folder")
    parser.add_argument("-o", "--out", type=Path, help="file to write (default: FLIGHT/report.html)")


def run(args: argparse.Namespace) -> int:
    """Writes the page and says where; returns 0."""
    print(write_report(args.flight, args.out))
    return 0
