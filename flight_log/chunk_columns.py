"""The content of a chunk by columns, compressed: a third of the bytes of the plain records.

Messages of equal length are the rows of a table of bytes. By columns, bytes of the same meaning follow one another: a
sign and exponent hardly change from tick to tick, so zstd finds them; row by row it finds little. Restored, the bytes
are those of the MCAP records. Readers of other projects do not know this compression: `dmrac log merge` writes a file
that they read.
"""

import struct
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import zstandard

COLUMNS: Final = "zstd-columns"
"""The compression's name in the chunk."""
PLAIN_ZSTD: Final = "zstd"
"""The name of zstd over the records as they are, which every MCAP reader knows."""
LEVEL: Final = 1
"""Higher levels save 2 % of the bytes and take twice the time and more."""
CHUNK_MAX_BYTES: Final = 256_000_000
"""No chunk is longer; the size that a damaged file states must not exhaust the memory."""
_TABLE: Final = struct.Struct("<II")
"""Rows and bytes of a row, before the bytes of each table."""


def compressed(records: bytes) -> bytes:
    """The records, row by row, compressed."""
    return zstandard.ZstdCompressor(level=LEVEL).compress(records)


def compressed_columns(tables: Sequence[tuple[int, bytes]]) -> bytes:
    """Tables of bytes, each with its number of rows of equal length, by columns and compressed."""
    parts = []
    for rows, data in tables:
        parts += [_TABLE.pack(rows, len(data) // rows), _transposed(data, rows)]
    return compressed(b"".join(parts))


def restored(compression: str, data: bytes | memoryview, size: int) -> bytes | memoryview:
    """The records of a chunk, row by row.

    Parameters
    ----------
    compression: the name in the chunk; "" for none.
    size: bytes of the records.

    Raises
    ------
    ValueError
        If the compression is unknown or the data are damaged.
    """
    if not compression:
        records = data
    elif compression in (COLUMNS, PLAIN_ZSTD) and size <= CHUNK_MAX_BYTES:
        plain = _decompressed(data, 2 * size + CHUNK_MAX_BYTES // 1000)
        records = b"".join(_rows(plain)) if compression == COLUMNS else plain
    else:
        raise ValueError(f"compression {compression!r} of a chunk of {size} bytes")
    if len(records) != size:
        raise ValueError("length of a chunk")
    return records


def _decompressed(data: bytes | memoryview, most: int) -> bytes:
    try:
        if zstandard.frame_content_size(bytes(data[:18])) > most:
            raise ValueError("length of a compressed chunk")
        return zstandard.ZstdDecompressor().decompress(bytes(data), max_output_size=most)
    except zstandard.ZstdError as error:
        raise ValueError(f"compressed chunk: {error}") from None


def _rows(plain: bytes) -> Iterator[bytes]:
    at = 0
    while at < len(plain):
        rows, width = _TABLE.unpack_from(plain, at)
        at += _TABLE.size
        data = plain[at : at + rows * width]
        if not data or len(data) != rows * width:
            raise ValueError("a table of a chunk ends too early")
        yield _transposed(data, width)
        at += len(data)


def _transposed(data: bytes, rows: int) -> bytes:
    if rows == 1 or rows == len(data):
        return data
    return np.frombuffer(data, np.uint8).reshape(rows, -1).T.tobytes()
