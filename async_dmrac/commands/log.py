"""`dmrac log info|check|merge|export`: inspects, checks, merges and exports flight logs."""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from async_dmrac.commands.output import add_json_option, print_json
from flight_log.export import export_csv, export_npz, merge
from flight_log.inspect import as_json, check, columns, describe
from flight_log.reader import Flight, open_flight
from flight_log.ulog import write_ulog
from runtime.extras import require_modules
from runtime.waiting import waiting

DESCRIPTION = "Show the content of a flight's logs, check them, merge them into one file, or export them."
EXAMPLES = """examples:
  dmrac log info flights/20260101_120000_figure8_wind
  dmrac log info FLIGHT --columns          every column with its unit
  dmrac log check FLIGHT                   exit status 1 if records are missing
  dmrac log merge FLIGHT -o all.mcap       one file for Foxglove or PlotJuggler
  dmrac log export FLIGHT --csv            FLIGHT/export/*.csv
  dmrac log export FLIGHT --npz --ulog -o /tmp/data
  dmrac log export FLIGHT --foxglove       flight.mcap and layout.json for Foxglove: the vehicle in 3-D
  dmrac log export FLIGHT --rosbag         FLIGHT/export/rosbag, for ros2 bag, RViz and PlotJuggler
  dmrac log export FLIGHT --tensorboard    tensorboard --logdir FLIGHT/export
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the actions of the subcommand."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    info = actions.add_parser("info", help="show the content of the logs")
    info.add_argument("--columns", action="store_true", help="list every column with its unit")
    checking = actions.add_parser("check", help="list missing and damaged records")
    for action in (info, checking):
        add_json_option(action)
    merging = actions.add_parser("merge", help="write the logs of all processes to one MCAP file, on one time base")
    merging.add_argument("-o", "--out", type=Path, help="file to write (default: FLIGHT/merged.mcap)")
    export = actions.add_parser("export", help="write files for other tools")
    for name, one in FORMATS.items():
        export.add_argument(f"--{name}", action="store_true", help=one.help)
    export.add_argument("-o", "--out", type=Path, help="folder to write into (default: FLIGHT/export)")
    for action in (info, checking, merging, export):
        action.add_argument("flight", type=Path, metavar="FLIGHT", help="a flight folder or one .mcap file")


def run(args: argparse.Namespace) -> int:
    """Run the action; returns 0, 1 if `check` found faults, or 2 if `export` was given no format."""
    actions = {"info": _info, "check": _check, "merge": _merge, "export": _export}
    try:
        with waiting(f"reading {args.flight}"):
            flight = open_flight(args.flight)
        return actions[args.action](flight, args)
    except BrokenPipeError:  # `| head` has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _info(flight: Flight, args: argparse.Namespace) -> int:
    if args.json:
        print(as_json(flight))
    else:
        print("\n".join(columns(flight) if args.columns else describe(flight)))
    return 0


def _check(flight: Flight, args: argparse.Namespace) -> int:
    faults = check(flight)
    records = sum(log.record_count for log in flight.logs)
    if args.json:
        print_json({"flight": str(flight.path), "records": records, "logs": len(flight.logs), "faults": faults})
        return 1 if faults else 0
    for fault in faults or [f"{flight.path}: complete, {records} records in {len(flight.logs)} logs, no gaps"]:
        print(fault)
    return 1 if faults else 0


def _merge(flight: Flight, args: argparse.Namespace) -> int:
    path = args.out or _folder(flight) / "merged.mcap"
    with waiting(f"writing {path}"):
        merge(flight, path)
    print(path)
    return 0


def _export(flight: Flight, args: argparse.Namespace) -> int:
    wanted = [name for name in FORMATS if getattr(args, name)]
    if not wanted:
        *others, last = (f"--{name}" for name in FORMATS)
        print(f"dmrac log export: give a format: {', '.join(others)} or {last}", file=sys.stderr)
        return 2
    for name in wanted:
        require_modules(*FORMATS[name].modules, purpose=f"--{name}")
    folder = args.out or _folder(flight) / "export"
    folder.mkdir(parents=True, exist_ok=True)
    for name in wanted:
        with waiting(f"writing {name}"):
            written = FORMATS[name].write(flight, folder)
        for path in written:
            print(path)
    return 0


def _npz(flight: Flight, folder: Path) -> list[Path]:
    export_npz(flight, folder / "flight.npz")
    return [folder / "flight.npz"]


def _ulog(flight: Flight, folder: Path) -> list[Path]:
    write_ulog(flight, folder / "flight.ulg")
    return [folder / "flight.ulg"]


def _parquet(flight: Flight, folder: Path) -> list[Path]:
    from flight_log.parquet import export_parquet

    return export_parquet(flight, folder)


def _foxglove(flight: Flight, folder: Path) -> list[Path]:
    from flight_log.foxglove_file import write_foxglove, write_layout

    paths = [folder / "flight.mcap", folder / "layout.json"]
    write_foxglove(flight, paths[0])
    write_layout(paths[1])
    return paths


def _rosbag(flight: Flight, folder: Path) -> list[Path]:
    from flight_log.ros_bag import write_ros_bag

    write_ros_bag(flight, folder / "rosbag")
    return [folder / "rosbag"]


def _tensorboard(flight: Flight, folder: Path) -> list[Path]:
    from flight_log.tensorboard import write_tensorboard

    write_tensorboard(flight, folder / "tensorboard")
    return [folder / "tensorboard"]


class Format(NamedTuple):
    """A format of `dmrac log export`."""

    help: str
    write: Callable[[Flight, Path], list[Path]]
    """Writes into a folder; returns what it wrote."""
    modules: tuple[str, ...] = ()
    """Of an extra, that it needs."""


FORMATS: Final[dict[str, Format]] = {
    "csv": Format("one file per topic", export_csv),
    "parquet": Format("one file per topic, with units", _parquet, ("pyarrow",)),
    "npz": Format("one NumPy file", _npz),
    "ulog": Format("one PX4 ULog file", _ulog),
    "foxglove": Format("MCAP and layout for Foxglove", _foxglove, ("foxglove", "rosbags")),
    "rosbag": Format("a ROS 2 bag in MCAP", _rosbag, ("rosbags",)),
    "tensorboard": Format("the training as a TensorBoard run", _tensorboard, ("tensorboard",)),
}


def _folder(flight: Flight) -> Path:
    return flight.path if flight.path.is_dir() else flight.path.parent
