"""A ground station that says that it is there and counts what it hears: a process that a soak kills and restarts.

python -m experiments.soak.ground_station HOST:PORT KEY_FILE
"""

import argparse
import socket
import time
from contextlib import suppress
from pathlib import Path
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from protocol.keys import read_key
from protocol.mavlink.frames import FrameWriter, Message
from protocol.mavlink.signing import SigningClock
from runtime.signals import StopRequest
from runtime.sockets import split_address
from runtime.status import StatusLines

HEARTBEAT_NS: Final = 1_000_000_000
SYSTEM: Final = 255
COMPONENT: Final = 190
DATAGRAM_MAX_BYTES: Final = 4096
_STATION: Final = Message(
    mavlink.MAVLink_heartbeat_message,
    (0, mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, mavlink.MAV_STATE_ACTIVE, 3),
)


def main() -> None:
    """Listen and answer until asked to end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("address", metavar="HOST:PORT", help="own address")
    parser.add_argument("key", type=Path, metavar="KEY_FILE", help="key of the ground station's MAVLink")
    parser.add_argument("--json", action="store_true", help="status as JSON lines")
    arguments = parser.parse_args()
    stop, status = StopRequest(), StatusLines("ground", arguments.json)
    writer = FrameWriter(SYSTEM, COMPONENT, read_key(arguments.key), SigningClock(time.time_ns()))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(split_address(arguments.address))
        station.settimeout(0.1)
        status.report("ready")
        heard, next_ns, onboard = 0, 0, None
        while stop.count == 0:
            with suppress(TimeoutError, ConnectionError):
                _, onboard = station.recvfrom(DATAGRAM_MAX_BYTES)
                heard += 1
            now_ns = time.monotonic_ns()
            if onboard is not None and now_ns >= next_ns:
                next_ns = now_ns + HEARTBEAT_NS
                with suppress(ConnectionError):
                    station.sendto(writer.write(_STATION, now_ns), onboard)
            if status.due(now_ns):
                status.write({"heard": heard})


if __name__ == "__main__":
    main()
