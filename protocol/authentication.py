"""Authentication of datagrams: a keyed BLAKE2b over the whole datagram, which depends on its direction.

The direction is BLAKE2b's `person` parameter, so that a datagram sent back to its sender has a wrong MAC. Without a
key the 16 bytes are an unkeyed BLAKE2b, which detects corruption but does not identify the sender. The configuration
(configs.addresses) then accepts only addresses of this machine.
"""

import hashlib
import hmac
from typing import Final, Literal

MAC_BYTES: Final = 16
KEY_BYTES: Final = 32
KEY_MIN_BYTES: Final = 16
KEY_MAX_BYTES: Final = 64

Direction = Literal["up", "down"]
"""up: onboard to offboard; down: offboard to onboard."""

_PERSON: Final[dict[Direction, bytes]] = {"up": b"async-dmrac up", "down": b"async-dmrac down"}


class Authenticator:
    """Computes and checks the MAC of one direction.

    Raises ValueError on construction if the key does not have 16 to 64 bytes. The message does not show the key.
    """

    def __init__(self, key: bytes | None, direction: Direction) -> None:
        if key is not None and not KEY_MIN_BYTES <= len(key) <= KEY_MAX_BYTES:
            raise ValueError(f"key of {len(key)} bytes, allowed {KEY_MIN_BYTES} to {KEY_MAX_BYTES}")
        self._start = hashlib.blake2b(digest_size=MAC_BYTES, key=key or b"", person=_PERSON[direction])

    def mac(self, data: bytes) -> bytes:
        """The MAC, 16 bytes, of header and body `data`."""
        state = self._start.copy()
        state.update(data)
        return state.digest()

    def is_genuine(self, datagram: bytes) -> bool:
        """Whether the last 16 bytes are the MAC of the bytes before them; compared in constant time."""
        view = memoryview(datagram)
        state = self._start.copy()
        state.update(view[:-MAC_BYTES])
        return hmac.compare_digest(state.digest(), view[-MAC_BYTES:])
