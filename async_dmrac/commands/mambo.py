"""`dmrac mambo`: the flight core on the Mambo's own processor, from the build to the log."""

import argparse
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from configs.addresses import Addresses, network_of
from configs.loader import ConfigError, read_tree
from mambo.board import board_config
from mambo.build import LIBRARY, build
from mambo.check import (
    MOTIONS,
    MOTORS,
    SLOT_S,
    Fault,
    faults_of,
    motor_faults,
    require_certificate,
    write_certificate,
)
from mambo.config import BoardConfig, BoardLink, library_config
from mambo.drone_access import FTP_PORT, TELNET_PORT, USB_HOST
from mambo.image import image, write_image
from mambo.install import RECORDING, Access, fetch, install, restore, start
from mambo.recording import read_recording
from mambo.recording_log import write_flight_log
from onboard.c.compile import BuildError
from onboard.config import OnboardConfig
from protocol.feature_config import fill_process
from protocol.keys import load_key

DESCRIPTION: Final = "the flight core on the Mambo's own processor (docs/real_mambo.md)"
EXAMPLES: Final = """examples, in this order:
  dmrac mambo build --out librsedu.so
  dmrac mambo config flight.yaml --out dmrac.bin                 mode record: the motors never run
  dmrac mambo install librsedu.so dmrac.bin --folder FOLDER      FOLDER and COMMAND: docs/real_mambo.md
  dmrac mambo start --folder FOLDER --restart COMMAND
  dmrac mambo log --folder FOLDER --out record
  dmrac mambo check record/dmrac.rec --motors "front left, front right, rear right, rear left" --out check.json
  dmrac mambo config flight.yaml --mode fly --check check.json --out dmrac.bin
  dmrac mambo restore --folder FOLDER                            the drone's own library again
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac mambo`."""
    commands = parser.add_subparsers(dest="step", metavar="STEP", required=True)
    one = commands.add_parser("build", help="compile the library for the drone's processor")
    one.add_argument("--out", type=Path, default=Path(LIBRARY), help=f"default: {LIBRARY}")
    one.set_defaults(do=_build)
    one = commands.add_parser("config", help="make the configuration image of a flight")
    one.add_argument("flight", type=Path, help="configuration that dmrac config wrote")
    one.add_argument(
        "--out", type=Path, default=Path("dmrac.bin"), help="default: dmrac.bin; only its owner can read it"
    )
    one.add_argument("--mode", choices=("record", "bench", "fly"), default="record", help="default: record")
    one.add_argument("--check", type=Path, metavar="FILE", help="for fly: result of dmrac mambo check")
    one.add_argument("--no-check", action="store_true", help="for fly: a simulated vehicle; a real one is not armed")
    _add_board(one)
    one.set_defaults(do=_config)
    one = commands.add_parser("check", help="find axes, signs, units and rates from a recording of motions")
    one.add_argument("recording", type=Path, nargs="?", help="dmrac.rec of mode record; none: print the motions")
    one.add_argument("--motors", metavar="A,B,C,D", help=f"which motors turned in mode bench, of {', '.join(MOTORS)}")
    one.add_argument("--out", type=Path, default=Path("check.json"), help="default: check.json")
    _add_board(one)
    one.set_defaults(do=_check)
    one = commands.add_parser("install", help="put library and image on the drone; what is there is saved first")
    one.add_argument("library", type=Path)
    one.add_argument("image", type=Path)
    _add_access(one)
    one.set_defaults(do=_install)
    one = commands.add_parser("restore", help="put the drone's own library back")
    _add_access(one)
    one.set_defaults(do=_restore)
    one = commands.add_parser("start", help="restart the firmware with the library")
    one.add_argument("--restart", required=True, metavar="COMMAND", help="that restarts the firmware, in its shell")
    _add_access(one)
    one.set_defaults(do=_start)
    one = commands.add_parser("log", help="fetch recording and log")
    one.add_argument("--out", type=Path, default=Path("record"), help="folder on this machine; default: record")
    _add_access(one)
    one.set_defaults(do=_log)


def _add_board(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--board", type=Path, metavar="FILE", help="values over configs/mambo.yaml")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="assignments",
        help="change a value of it by path",
    )


def _add_access(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--host", default=USB_HOST, help=f"default: {USB_HOST}, over USB")
    parser.add_argument("--ftp-port", type=int, default=FTP_PORT)
    parser.add_argument("--telnet-port", type=int, default=TELNET_PORT)
    parser.add_argument("--folder", required=True, help="of the library, as the drone's FTP server names it")
    parser.add_argument("--saved", type=Path, default=Path("mambo_saved"), help="folder for what the drone had")


def run(arguments: argparse.Namespace) -> int:
    """Do one step; returns 0, or 1 if a check failed. Raises ConfigError and DroneError."""
    do: Callable[[argparse.Namespace], int] = arguments.do
    return do(arguments)


def _say(line: str) -> None:
    print(line, flush=True)


def _build(arguments: argparse.Namespace) -> int:
    try:
        built = build("arm")
    except BuildError as error:
        raise ConfigError(f"dmrac mambo build: {error}") from None
    shutil.copyfile(built.library, arguments.out)
    _say(f"{arguments.out}: {arguments.out.stat().st_size} bytes, with {' '.join(built.target.compiler[:4])}")
    return 0


def _board(arguments: argparse.Namespace, mode: str | None = None) -> BoardConfig:
    return board_config(arguments.board, arguments.assignments, {"mode": mode} if mode else None)


def _config(arguments: argparse.Namespace) -> int:
    board = _board(arguments, arguments.mode)
    cleared = _cleared(arguments, board)
    tree = read_tree(arguments.flight)
    onboard = fill_process(OnboardConfig, tree, str(arguments.flight), "onboard")
    if not isinstance(tree.get("network", {}), Mapping):
        raise ConfigError(f"{arguments.flight}: network: {tree['network']!r}, expected a mapping of keys")
    network = network_of(tree, str(arguments.flight), {})
    key, ground_key = load_key(network.key_file), load_key(network.ground_key_file)
    data = image(library_config(board, onboard, cleared), onboard, key, ground_key)
    write_image(arguments.out, data)
    with_key = "with" if key else "WITHOUT"
    _say(f"{arguments.out}: {len(data)} bytes, mode {board.mode}, {with_key} key, mode of the file 0600")
    for line in _link_lines(board.link, network, arguments.flight):
        _say(line)
    return 0


def _link_lines(link: BoardLink, network: Addresses, flight: Path) -> list[str]:
    """Where the library sends, and what offboard's addresses in the flight's `network` have instead."""
    offboard, ground = (".".join(map(str, one)) for one in (link.offboard, link.ground))
    station = f"ground station {ground}:{link.ground_port}" if link.ground_port else "no ground station"
    lines = [f"link: from port {link.own_port} to offboard {offboard}:{link.offboard_port}, {station}"]
    ends = {"radio_onboard": f"{offboard}:{link.offboard_port}", "radio_offboard": f":{link.own_port}"}
    for name, end in ends.items():
        there: str = getattr(network, name)
        if not there.endswith(end):
            lines.append(f"NOTE  {flight}: network.{name} is {there}, the image has {end}: change it, or --set link")
    return lines


def _cleared(arguments: argparse.Namespace, board: BoardConfig) -> bool:
    """Whether the image may arm. Raises ConfigError for fly without a check."""
    if arguments.mode != "fly":
        return False
    if arguments.no_check:
        return False
    if arguments.check is None:
        raise ConfigError("--mode fly: needs --check FILE, the result of dmrac mambo check (or --no-check: never arms)")
    require_certificate(arguments.check, board)
    return True


def _check(arguments: argparse.Namespace) -> int:
    if arguments.recording is None:
        _say("Begin when the library begins to record. Each takes 6 s: move in the first 3 s, then hold still.")
        for index, motion in enumerate(MOTIONS):
            _say(f"{index * SLOT_S:5.0f} s  {motion}")
        return 0
    board, places, recording = _board(arguments), ", ".join(MOTORS), read_recording(arguments.recording)
    answers = None if arguments.motors is None else [one.strip() for one in arguments.motors.split(",")]
    if answers is not None and (len(answers) != len(MOTORS) or set(answers) - {*MOTORS, ""}):
        raise ConfigError(f"--motors {arguments.motors}: expected 4 of {places}, or nothing for one that stood still")
    faults = faults_of(recording, board)
    if answers is not None:
        faults += motor_faults(answers)
    for fault in faults:
        _say(f"FAULT  {fault.what}: {fault.text}")
    if answers is None:
        _say(f"sensors: {_verdict(faults)}; nothing written, the motors are missing")
        _say(f"next: an image of mode bench, then --motors with the motors as they turned, of {places}")
        return 1
    write_certificate(arguments.out, board, faults, arguments.recording)
    _say(f"{arguments.out}: {_verdict(faults)}")
    return int(bool(faults))


def _verdict(faults: list[Fault]) -> str:
    return f"{len(faults)} fault{'s' if len(faults) > 1 else ''}" if faults else "passed"


def _access(arguments: argparse.Namespace) -> Access:
    return Access(arguments.host, arguments.ftp_port, arguments.telnet_port, arguments.folder)


def _install(arguments: argparse.Namespace) -> int:
    install(_access(arguments), arguments.library, arguments.image, arguments.saved, _say)
    return 0


def _restore(arguments: argparse.Namespace) -> int:
    restore(_access(arguments), arguments.saved, _say)
    return 0


def _start(arguments: argparse.Namespace) -> int:
    start(_access(arguments), arguments.restart, _say)
    return 0


def _log(arguments: argparse.Namespace) -> int:
    for path in fetch(_access(arguments), arguments.out, _say):
        _say(f"{path}: {path.stat().st_size} bytes")
        if path.name == RECORDING:
            _say(f"{write_flight_log(read_recording(path), arguments.out)}: for dmrac log")
    return 0
