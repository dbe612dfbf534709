"""`dmrac report FLIGHT`: one self-contained page about a flight."""

import argparse
import sys
from pathlib import Path

from flight_record.log_file import FlightError
from flight_record.report import write_report

DESCRIPTION = "Writes one self-contained HTML page about a flight: card, figures, training, events, config."
EXAMPLES = """examples:
  dmrac report flights/20260101_120000_figure8_wind
  dmrac report FLIGHT -o /tmp/flight.html
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the subcommand's options."""
    parser.description = DESCRIPTION
    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("flight", type=Path, metavar="FLIGHT", help="a flight folder")
    parser.add_argument("-o", "--out", type=Path, help="file to write (default: FLIGHT/report.html)")


def run(args: argparse.Namespace) -> int:
    """Exit status: 0 written, 2 the flight cannot be read or the page not written."""
    try:
        print(write_report(args.flight, args.out))
    except FlightError as error:
        print(f"dmrac report: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"dmrac report: {error.filename}: cannot be written: {error.strerror}", file=sys.stderr)
        return 2
    return 0
