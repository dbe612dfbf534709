"""Frame stream: splits a byte stream (a serial line) into whole MAVLink 2 frames, which are then handled as datagrams.

The marker byte also occurs inside frames, so a frame counts only if its checksum is right. If it is wrong, the search
goes on at the byte after the marker: a false start never hides a good frame that begins inside it. Bytes wait only
until the frame that they may belong to is complete. A frame has at most 280 bytes, so memory and delay are bounded.
"""

from collections import Counter

from pymavlink.dialects.v20 import common as mavlink

from protocol.mavlink.frames import (
    CHECKSUM_BYTES,
    HEADER_BYTES,
    MARKER,
    SIGNED_FLAG,
    checked_fields,
    frame_length,
    layout_of,
    message_id_of,
)


class FrameStream:
    """Collects bytes and returns whole frames. `skipped` counts the bytes outside frames, by reason."""

    def __init__(self) -> None:
        self._waiting = b""
        self.skipped: Counter[str] = Counter()

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that `data` completes. No bytes raise."""
        data = self._waiting + data
        frames: list[bytes] = []
        start, end = 0, len(data)
        while True:
            marker = data.find(MARKER, start)
            if marker < 0:
                self.skipped["no_frame"] += end - start
                start = end
                break
            self.skipped["no_frame"] += marker - start
            start = marker
            stop = _frame_end(data, start)
            if stop < 0:
                self.skipped["unknown_frame"] += 1
                start += 1
            elif stop > end:
                break
            elif checked_fields(data[start:stop], layout_of(message_id_of(data, start))) is not None:
                frames.append(data[start:stop])
                start = stop
            else:
                self.skipped["checksum"] += 1
                start += 1
        self._waiting = data[start:]
        self.skipped = +self.skipped
        return frames


def _frame_end(data: bytes, start: int) -> int:
    """End of the frame that may begin at `start`, as far as known; -1: no frame begins here."""
    if len(data) > start + 2 and data[start + 2] & ~SIGNED_FLAG:
        return -1
    if len(data) < start + HEADER_BYTES:
        return start + HEADER_BYTES + CHECKSUM_BYTES
    if message_id_of(data, start) not in mavlink.mavlink_map:
        return -1
    return start + frame_length(data, start)
