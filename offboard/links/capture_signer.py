"""Signs the poses of a motion capture that cannot sign itself: MAVLink frames in, the same messages signed out.

It runs on the machine of the motion capture, which sends to loopback; only signed frames leave the machine.
"""

from collections import Counter
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from protocol.mavlink.frames import FrameReader, FrameWriter, Message
from protocol.mavlink.motion_capture import DECODERS, FRAME_BYTES_MAX
from protocol.mavlink.signing import SigningClock

SYSTEM: Final = 1
COMPONENT: Final[int] = mavlink.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY


class CaptureSigner:
    """Turns each datagram of the capture into one signed frame. What is no pose is counted in `rejected`."""

    def __init__(self, key: bytes, clock: SigningClock) -> None:
        """Raises ValueError if the key is not 32 bytes long."""
        self._reader = FrameReader(DECODERS)
        self._writer = FrameWriter(SYSTEM, COMPONENT, key, clock)
        self.signed = 0

    @property
    def rejected(self) -> Counter[str]:
        """Frames dropped, by reason."""
        return self._reader.rejected

    def sign(self, datagram: bytes, now_ns: int) -> list[bytes]:
        """The pose of a datagram as a signed frame; empty if it has none."""
        if len(datagram) > FRAME_BYTES_MAX:
            self.rejected["length"] += 1
            return []
        frames = self._reader.read(datagram, now_ns)
        self.signed += len(frames)
        kinds = mavlink.mavlink_map
        return [self._writer.write(Message(kinds[frame.message_id], frame.fields), now_ns) for frame in frames]
