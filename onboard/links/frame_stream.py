"""Cuts a byte stream (a serial line) into whole MAVLink 2 frames, so that each can be treated like a datagram.

Theory of operation. The marker byte also occurs inside frames, so a frame counts only when its checksum agrees.
When it does not, only the marker is given up and the search goes on behind it: a false start never swallows the good
frame that begins inside it. Bytes wait only while the frame they seem to begin is not complete, and a frame has at
most 280 bytes, so neither memory nor delay grows.
"""

from collections import Counter
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

from protocol.mavlink_frames import CHECKSUM_BYTES, HEADER_BYTES, MARKER, SIGNATURE_BYTES, SIGNED_FLAG

_checksum: Any = mavlink.mcrf4xx
_SEEDS: Final[dict[int, bytes]] = {number: bytes([kind.crc_extra]) for number, kind in mavlink.mavlink_map.items()}


class FrameStream:
    """Takes bytes as they come; gives whole frames. `skipped` counts bytes that belonged to none, by reason."""

    def __init__(self) -> None:
        self._waiting = b""
        self.skipped: Counter[str] = Counter()

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that are complete now. Never raises for what is in the bytes."""
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
            elif _is_whole(data, start):
                frames.append(data[start:stop])
                start = stop
            else:
                self.skipped["checksum"] += 1
                start += 1
        self._waiting = data[start:]
        self.skipped = +self.skipped
        return frames


def _frame_end(data: bytes, start: int) -> int:
    """Where the frame that seems to begin here ends, as far as can be seen; -1: none of ours begins here."""
    head = data[start : start + HEADER_BYTES]
    if len(head) > 2 and head[2] & ~SIGNED_FLAG:
        return -1
    if len(head) < HEADER_BYTES:
        return start + HEADER_BYTES + CHECKSUM_BYTES
    if int.from_bytes(head[7:10], "little") not in _SEEDS:
        return -1
    signature = SIGNATURE_BYTES if head[2] & SIGNED_FLAG else 0
    return start + HEADER_BYTES + head[1] + CHECKSUM_BYTES + signature


def _is_whole(data: bytes, start: int) -> bool:
    """Whether the checksum of a complete frame agrees."""
    end = start + HEADER_BYTES + data[start + 1]
    seed = _SEEDS[int.from_bytes(data[start + 7 : start + 10], "little")]
    checksum: int = _checksum(seed, _checksum(data[start + 1 : end]))
    return checksum == data[end] | data[end + 1] << 8
