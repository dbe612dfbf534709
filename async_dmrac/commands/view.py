"""`dmrac view FLIGHT`: shows a flight in the Rerun viewer, in a window or in a browser."""

import argparse
import signal
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from flight_log.live import follow
from flight_log.reader import FlightError, open_flight
from flight_log.scene import build_scene
from flight_log.viewer import OPENED, WEB_PORT, ViewerError, WebViewer, live_viewer, show_window, viewer_binary
from runtime.waiting import waiting

DESCRIPTION = "Show a flight: path, vehicle, thrust, wind and disturbance in 3-D, with curves and events."
EXAMPLES = """examples:
  dmrac view flights/20260101_120000_figure8_wind
  dmrac view FLIGHT --web                  in a browser on this machine
  dmrac view FLIGHT --live                 while it is flown
  dmrac view FLIGHT --save flight.rrd      write a file for the viewer, show nothing
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the subcommand."""
    parser.add_argument("flight", type=Path, metavar="FLIGHT", help="a flight folder or one .mcap file")
    parser.add_argument("--web", action="store_true", help="serve it to a browser on this machine")
    parser.add_argument("--port", type=int, default=WEB_PORT, help="port for --web (%(default)s; 0 takes a free one)")
    parser.add_argument("--no-open", action="store_true", help="with --web: print the address, do not open a browser")
    parser.add_argument("--live", action="store_true", help="follow a flight that is being logged to this folder")
    parser.add_argument(
        "--save", type=Path, metavar="FILE", help="write a recording (.rrd) instead of showing the flight"
    )


def run(args: argparse.Namespace) -> int:
    """Show or write the flight; returns 0, or 2 if it cannot be read or shown."""
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))  # both end it cleanly
    try:
        return _show(args)
    except KeyboardInterrupt:
        return 0
    except (FlightError, ViewerError) as error:
        print(f"dmrac view: {error}", file=sys.stderr)
    except OSError as error:
        print(f"dmrac view: {error.filename}: cannot be written: {error.strerror}", file=sys.stderr)
    return 2


def _show(args: argparse.Namespace) -> int:
    viewer_binary()  # before the import: raises an error with one line if the extra is missing
    from flight_log.rerun_scene import save_recording

    if args.live:
        return _follow(args)
    with waiting(f"reading {args.flight}"):
        flight = open_flight(args.flight)
    name = flight.path.resolve().name
    if args.save is not None:
        with waiting(f"writing {args.save}"):
            save_recording(build_scene(flight), args.save, name)
        print(args.save)
        return 0
    with tempfile.TemporaryDirectory(prefix="dmrac_view_") as folder:
        file = Path(folder) / f"{name}.rrd"
        with waiting("preparing the viewer"):
            save_recording(build_scene(flight), file, name)
        return _serve(file, args) if args.web else show_window(file)


def _serve(source: Path | str, args: argparse.Namespace) -> int:
    with WebViewer(source, args.port) as viewer:
        _announce(viewer, args)
        with suppress(KeyboardInterrupt):
            viewer.serve()
    return 0


def _announce(viewer: WebViewer, args: argparse.Namespace) -> None:
    print(f"{viewer.url}\nCtrl-C to end", flush=True)
    if not args.no_open:
        webbrowser.open(viewer.url)


def _follow(args: argparse.Namespace) -> int:
    """Follow the flight. The viewer stays open after the end of the flight, until it is closed or Ctrl-C is pressed."""
    with live_viewer(args.web) as (child, address), suppress(KeyboardInterrupt):
        if not args.web:
            print(OPENED, flush=True)
            _stream(args.flight, address, lambda: child.poll() is None)
            return child.wait()
        with WebViewer(address, args.port) as viewer:
            _announce(viewer, args)
            server = threading.Thread(target=viewer.serve, daemon=True)
            server.start()
            _stream(args.flight, address, lambda: child.poll() is None)
            server.join()
    return 0


def _stream(folder: Path, address: str, wanted: Callable[[], bool]) -> None:
    from flight_log.rerun_scene import connect, log_scene, log_static

    recording, known = connect(folder.resolve().name, address), 0
    try:
        for scene in follow(folder, wanted):
            if len(scene.curves) > known:
                log_static(recording, scene)
                known = len(scene.curves)
            log_scene(recording, scene)
    finally:
        recording.flush()
        recording.disconnect()
