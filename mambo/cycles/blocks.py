"""The blocks of a call, by the object files that their functions come from, as the linker's map lists them."""

import re
from collections.abc import Iterator
from typing import Final, NamedTuple

BLOCKS: Final[dict[str, tuple[str, ...]]] = {
    "library: readings, watchdogs, sockets": ("library-", "firmware", "settings", "ranges"),
    "link: MAC, decoding, chunks": ("links-", "protocol-"),
    "estimator": ("estimation-",),
    "guidance and flight modes": ("flight-", "generated-"),
    "features": ("control-features", "control-spectral_q15"),
    "last layer": ("control-laws-",),
    "slope bound": ("control-slope",),
    "guard": ("control-guard", "control-room", "control-watch", "control-tracking_bound"),
    "swap": ("control-feature_", "control-posterior_swap", "control-version_test"),
    "cascade, mixer, actuators": ("control-",),
    "samples and record": ("sampling-", "record-", "core"),
}
"""Prefixes of object names; the first one that fits counts."""
HELPERS: Final = ("numerics-", "protocol-geometry", "protocol-little_endian")
"""Charged to the block that calls them, as everything of the compiler's and the C library's is."""
_SECTION: Final = re.compile(r"^ \.text(?:\.\S+)?\s+0x0*([0-9a-f]+)\s+0x([0-9a-f]+)\s+(\S+)$", re.MULTILINE)


class AddressRange(NamedTuple):
    """A function, or several, and its block."""

    start: int
    end: int
    block: int
    """Index in BLOCKS; -1: the caller's."""


def address_ranges(linker_map: str) -> Iterator[AddressRange]:
    """The sections of code in a linker's map, in the order of their addresses."""
    joined = re.sub(r"^( \.text\S*)\n\s+", r"\1 ", linker_map, flags=re.MULTILINE)
    found = sorted(
        (int(start, 16), int(size, 16), path) for start, size, path in _SECTION.findall(joined) if int(size, 16)
    )
    for start, size, path in found:
        yield AddressRange(start, start + size, block_of(path))


def block_of(path: str) -> int:
    """Index of the block that an object file belongs to; -1 for a helper."""
    name = path.rpartition("/")[2]
    if not name.endswith(".o") or name.startswith(HELPERS):  # of an archive, "libgcc.a(_addsubsf3.o)"
        return -1
    for index, prefixes in enumerate(BLOCKS.values()):
        if name.startswith(prefixes):
            return index
    return -1
