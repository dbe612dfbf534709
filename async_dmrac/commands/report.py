"""`dmrac report FLIGHT`: writes the report of a flight as one HTML page."""

import argparse
from pathlib import Path

from flight_log.report import write_report
from runtime.extras import require_modules
from runtime.waiting import waiting

DESCRIPTION = "Write one self-contained HTML page about a flight: summary, figures, training, events, configuration."
EXAMPLES = """examples:
  dmrac report flights/20260101_120000_figure8_wind
  dmrac report FLIGHT -o /tmp/flight.html
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the subcommand."""
    parser.add_argument("flight", type=Path, metavar="FLIGHT", help="a flight folder")
    parser.add_argument("-o", "--out", type=Path, help="file to write (default: FLIGHT/report.html)")


def run(args: argparse.Namespace) -> int:
    """Write the page and print its path; returns 0."""
    require_modules("matplotlib")
    with waiting("writing the report"):
        path = write_report(args.flight, args.out)
    print(path)
    return 0
