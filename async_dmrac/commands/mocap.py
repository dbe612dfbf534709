"""`dmrac mocap`: signs the poses of a motion capture on this machine and sends them to offboard."""

import argparse
import select
import time
from typing import Final

from configs.addresses import check_address, is_loopback
from configs.loader import ConfigError
from offboard.links.capture_signer import CaptureSigner
from protocol.keys import load_key
from protocol.mavlink.signing import SigningClock
from runtime.signals import StopRequest
from runtime.sockets import DatagramSocket
from runtime.status import StatusLines

EXAMPLES: Final = """examples:
  dmrac mocap --offboard 10.0.0.7:14574 --capture-key-file capture.key
  dmrac mocap --listen 127.0.0.1:14575 --offboard 10.0.0.7:14574 --capture-key-file capture.key
"""
LISTEN: Final = "127.0.0.1:14575"
DATAGRAMS_PER_WAKE: Final = 64
WAKE_S: Final = 0.1
HELD_UP_NS: Final = 10_000_000
"""Offboard reckons with no more from the capture to the arrival (`offboard.pose_relay.latency_s`)."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac mocap`."""
    parser.add_argument("--offboard", required=True, metavar="HOST:PORT", help="offboard's motion capture address")
    parser.add_argument(
        "--listen",
        default=LISTEN,
        metavar="HOST:PORT",
        help="own address, on loopback, to which the motion capture sends MAVLink (default: %(default)s)",
    )
    parser.add_argument("--capture-key-file", required=True, metavar="FILE", help="key shared with offboard")
    parser.add_argument("--json", action="store_true", help="status as JSON lines")


def run(arguments: argparse.Namespace) -> int:
    """Relay until asked to end; returns 0. Raises ConfigError for a bad option, StartError for an address in use."""
    offboard, listen = (_checked(option, arguments) for option in ("offboard", "listen"))
    if not is_loopback(listen):
        raise ConfigError(f"--listen {listen}: the unsigned poses must come from this machine; allowed is 127.0.0.0/8")
    key = load_key(arguments.capture_key_file)
    assert key is not None
    clock = SigningClock(utc_at_first_use_ns=time.time_ns())
    clock.now(time.monotonic_ns())  # the first pose may come much later
    signer = CaptureSigner(key, clock)
    stop, status = StopRequest(), StatusLines("mocap", arguments.json)
    capture = DatagramSocket("--listen", listen, None)
    sender = DatagramSocket("--offboard", "127.0.0.1:0" if is_loopback(offboard) else "0.0.0.0:0", offboard)
    status.report(f"from {listen}, signed to {offboard}")
    status.report("ready")
    late = 0
    try:
        while stop.count == 0:
            select.select((capture,), (), (), WAKE_S)
            now_ns = time.monotonic_ns()
            for datagram, arrival_ns in capture.receive_stamped(DATAGRAMS_PER_WAKE):
                if held_up(arrival_ns, time.monotonic_ns()):
                    late += 1
                    continue
                for frame in signer.sign(datagram, now_ns):
                    sender.send(frame)
            if status.due(now_ns):
                counts = {"signed": signer.signed, "rejected": signer.rejected.total(), "unsent": sender.unsent}
                status.write({**counts, "held_up": late})
    finally:
        capture.close()
        sender.close()
    return 0


def held_up(arrival_ns: int, now_ns: int) -> bool:
    """Whether a pose waited here so long that offboard would take it for one of a later time: none is better."""
    return now_ns - arrival_ns > HELD_UP_NS


def _checked(option: str, arguments: argparse.Namespace) -> str:
    address: str = getattr(arguments, option)
    try:
        return check_address(address)
    except ValueError as error:
        raise ConfigError(f"--{option} {address}: {error}") from None
