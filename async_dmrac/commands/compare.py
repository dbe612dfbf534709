"""`dmrac compare FLIGHT FLIGHT...`: compares flights in a table and a figure."""

import argparse
from pathlib import Path

from async_dmrac.commands.output import add_json_option, print_json
from flight_log.compare import labels, summary_table, write_comparison
from flight_log.reader import open_flight
from runtime.extras import require_modules
from runtime.waiting import waiting

DESCRIPTION = "Compare flights: print a table, and write an HTML page with figure and table."
EXAMPLES = """examples:
  dmrac compare flights/*_figure8_wind
  dmrac compare FLIGHT_A FLIGHT_B -o /tmp/comparison.html
"""
ON_TERMINAL = ("survived", "position_rmse_m", "attitude_rmse_rad", "settled_rmse_m", "features.version")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the subcommand."""
    parser.add_argument("flights", type=Path, nargs="+", metavar="FLIGHT", help="two flight folders or more")
    parser.add_argument("-o", "--out", type=Path, default=Path("comparison.html"), help="page to write (%(default)s)")
    add_json_option(parser, "the flights' summaries")


def run(args: argparse.Namespace) -> int:
    """Write the page and print the summaries side by side; returns 0."""
    require_modules("matplotlib")
    with waiting("reading the flights and writing the page"):
        flights = [open_flight(path) for path in args.flights]
        write_comparison(flights, args.out)
    names = labels(flights)
    if args.json:
        summaries = [
            {"label": name, "flight": str(flight.path), "summary": flight.summary}
            for name, flight in zip(names, flights, strict=True)
        ]
        print_json({"page": str(args.out), "flights": summaries})
        return 0
    width = max(len(name) for name in names)
    rows = {row[0]: row[1:] for row in summary_table(flights) if row[0] in ON_TERMINAL}
    print(f"{'':<{width}}  " + "  ".join(f"{key:>17}" for key in rows))
    for i, name in enumerate(names):
        print(f"{name:<{width}}  " + "  ".join(f"{values[i]:>17}" for values in rows.values()))
    print(args.out)
    return 0
