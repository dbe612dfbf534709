"""Parses the only msgpack shape that the protocol accepts: an array within limits, without maps and extensions."""

from typing import Any

import msgpack

from protocol.errors import ProtocolError


def unpack_array(data: bytes, reason: str, bin_max: int, array_max: int, str_max: int = 0) -> list[Any]:
    """The fields of the msgpack array `data`.

    Parameters
    ----------
    reason: the reason of the error, see ProtocolError.
    bin_max, str_max: most bytes of a binary field, and of a text.
    array_max: most fields, also of an array within the array.

    Raises
    ------
    ProtocolError
        With `reason`, if the bytes are anything else.
    """
    try:
        fields = msgpack.unpackb(
            data,
            max_bin_len=bin_max,
            max_array_len=array_max,
            max_str_len=str_max,
            max_map_len=0,
            max_ext_len=0,
        )
    except (ValueError, msgpack.UnpackException) as error:
        raise ProtocolError(reason, f"not msgpack within the limits ({error})") from None
    if type(fields) is not list:
        raise ProtocolError(reason, "not an array")
    return fields
