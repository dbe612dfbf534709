"""Who may speak: a keyed BLAKE2b over the whole datagram, bound to its direction; without a key only this machine.

The direction is BLAKE2b's `person` parameter, so that a datagram thrown back at its sender carries a wrong MAC.
Without a key the same 16 bytes are an unkeyed BLAKE2b: they find corruption and prove nothing, which is why a
socket shell must call `require_loopback_without_key` for each address it binds or hears from.
"""

import hashlib
import hmac
import ipaddress
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

    Raises ValueError on construction when the key has not 16 to 64 bytes; the message never shows it.
    """

    def __init__(self, key: bytes | None, direction: Direction) -> None:
        if key is not None and not KEY_MIN_BYTES <= len(key) <= KEY_MAX_BYTES:
            raise ValueError(f"key of {len(key)} bytes, allowed {KEY_MIN_BYTES} to {KEY_MAX_BYTES}")
        self._start = hashlib.blake2b(digest_size=MAC_BYTES, key=key or b"", person=_PERSON[direction])

    def mac(self, data: bytes) -> bytes:
        """The 16 bytes that close a datagram of header and body `data`."""
        state = self._start.copy()
        state.update(data)
        return state.digest()

    def is_genuine(self, datagram: bytes) -> bool:
        """Whether the last 16 bytes are the MAC of the others; takes the same time wherever they differ."""
        view = memoryview(datagram)
        state = self._start.copy()
        state.update(view[:-MAC_BYTES])
        return hmac.compare_digest(state.digest(), view[-MAC_BYTES:])


def is_loopback(host: str) -> bool:
    """Whether `host` ("localhost" or a literal address) can only be this machine; other names count as no."""
    if host == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    return bool((mapped or address).is_loopback)


def require_loopback_without_key(host: str, key: bytes | None) -> None:
    """Refuses to talk to, or listen on, another address than this machine's own without a key.

    Raises
    ------
    ValueError
        If there is no key and `host` is not a loopback address.
    """
    if key is None and not is_loopback(host):
        raise ValueError(f"{host}: only loopback addresses are allowed without a key; make one with 'dmrac keygen'")
