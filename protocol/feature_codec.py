"""The bytes of a feature set, which the transfer splits into chunks, as docs/protocol.md specifies them.

[format, float size, version, parent, samples, position | nil, attitude | nil], where a channel is
[[input names], offset, scale, [layer widths], parameters]. `parameters` holds W_1 (row by row), b_1, ..., W_L,
b_L, last_layer in this order, in float16 or float32. offset and scale are float32, because inputs have units.
"""

import math
from typing import Any, Final, Literal

import msgpack
import numpy as np

from protocol.conventions import Array
from protocol.errors import ProtocolError
from protocol.feature_set import LAYERS_MAX, WIDTH_MAX, ChannelFeatures, FeatureSet
from protocol.messages import ABSOLUTE_VALUE_MAX, CHUNK_COUNT_MAX, CHUNK_DATA_MAX_BYTES
from protocol.msgpack_array import unpack_array
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX

FEATURE_SET_MAX_BYTES: Final = CHUNK_COUNT_MAX * CHUNK_DATA_MAX_BYTES
FORMAT: Final = 1
FLOAT16_MAX: Final = float(np.finfo(np.float16).max)
_NAME_MAX_BYTES: Final = 32
_DTYPES: Final[dict[int, str]] = {2: "<f2", 4: "<f4"}

FloatName = Literal["float16", "float32"]


def encode_feature_set(features: FeatureSet, dtype: FloatName) -> bytes:
    """The bytes of a feature set, with its parameters rounded to `dtype`.

    The rounded parameters are the ones that fly: judge `decode_feature_set(encode_feature_set(...))` before sending.

    Raises
    ------
    ValueError
        If a parameter is too large for `dtype`, or the bytes exceed FEATURE_SET_MAX_BYTES.
    """
    float_size = 2 if dtype == "float16" else 4
    channels = [_pack_channel(channel, float_size) for channel in features.by_channel]
    data: bytes = msgpack.packb((FORMAT, float_size, features.version, features.parent, features.samples, *channels))
    if len(data) > FEATURE_SET_MAX_BYTES:
        raise ValueError(f"feature set of {len(data)} bytes, allowed are {FEATURE_SET_MAX_BYTES}")
    return data


def encode_for_wire(features: FeatureSet, dtype: FloatName) -> bytes:
    """As `encode_feature_set`, but in float32 if a parameter is too large for float16.

    Raises
    ------
    ValueError
        If a parameter is too large to send, or the bytes exceed FEATURE_SET_MAX_BYTES.
    """
    fits = dtype == "float32" or _largest_parameter(features) <= FLOAT16_MAX
    return encode_feature_set(features, dtype if fits else "float32")


def _largest_parameter(features: FeatureSet) -> float:
    return max(float(np.abs(array).max()) for channel in features.channels for array in channel.parameters)


def _pack_channel(channel: ChannelFeatures | None, float_size: int) -> tuple[Any, ...] | None:
    if channel is None:
        return None
    layers = [part.ravel() for W, b in zip(channel.weights, channel.biases, strict=True) for part in (W, b)]
    parameters = np.concatenate([*layers, channel.last_layer.ravel()])
    if float(np.abs(parameters).max()) > (FLOAT16_MAX if float_size == 2 else ABSOLUTE_VALUE_MAX):
        raise ValueError(f"a parameter of {float(np.abs(parameters).max()):g} is too large to send")
    widths = [W.shape[0] for W in channel.weights]
    offset, scale = (array.astype("<f4").tobytes() for array in (channel.offset, channel.scale))
    return (list(channel.inputs), offset, scale, widths, parameters.astype(_DTYPES[float_size]).tobytes())


def decode_feature_set(data: bytes) -> FeatureSet:
    """The feature set in `data`, with all its values checked.

    Raises
    ------
    ProtocolError
        With a reason in protocol.messages.REFUSALS: "undecodable", "inputs" (an unknown signal) or "not_finite".
    """
    fields = unpack_array(data, "undecodable", FEATURE_SET_MAX_BYTES, SIGNAL_COUNT, _NAME_MAX_BYTES)
    numbers_ok = len(fields) == 7 and all(type(field) is int for field in fields[:5])
    if not numbers_ok or fields[0] != FORMAT or fields[1] not in _DTYPES:
        raise ProtocolError("undecodable", "not a feature set of a known format")
    try:
        position, attitude = (_unpack_channel(fields[i], _DTYPES[fields[1]]) for i in (5, 6))
        return FeatureSet(fields[2], fields[3], fields[4], position, attitude)
    except ValueError as error:
        raise ProtocolError("undecodable", str(error)) from None


def _unpack_channel(fields: Any, dtype: str) -> ChannelFeatures | None:
    if fields is None:
        return None
    if type(fields) is not list or [type(field) for field in fields] != [list, bytes, bytes, list, bytes]:
        raise ProtocolError("undecodable", "unexpected fields in a channel")
    inputs, offset, scale, widths, parameters = fields
    unknown = [name for name in inputs if type(name) is not str or name not in SIGNAL_INDEX]
    if unknown:
        raise ProtocolError("inputs", f"unknown signal {_shown(unknown[0])}")
    widths_ok = all(type(width) is int and 1 <= width <= WIDTH_MAX for width in widths)
    if not widths_ok or not 1 <= len(widths) <= LAYERS_MAX or not inputs:
        shown = ", ".join(_shown(width) for width in widths)
        raise ProtocolError("undecodable", f"{len(inputs)} inputs and layers of width {shown}")
    m = len(inputs)
    shapes = _shapes(m, widths)
    arrays = _split(_floats(parameters, dtype), shapes)
    vectors = [_split(_floats(data, "<f4"), [(m,)])[0] for data in (offset, scale)]
    if not all(bool(np.isfinite(array).all()) for array in (*arrays, *vectors)):
        raise ProtocolError("not_finite", "a parameter is not finite")
    return ChannelFeatures(
        tuple(inputs), vectors[0], vectors[1], tuple(arrays[0:-1:2]), tuple(arrays[1:-1:2]), arrays[-1]
    )


def _shown(value: Any) -> str:
    """A name or a number; of anything else only its type, as lists within lists may be too deep for repr."""
    return repr(value) if type(value) in (str, int) else type(value).__name__


def _shapes(m: int, widths: list[int]) -> list[tuple[int, ...]]:
    """Shapes of W_1, b_1, ..., W_L, b_L, last_layer."""
    shapes: list[tuple[int, ...]] = []
    for width_in, width in zip([m, *widths], widths, strict=False):
        shapes += [(width, width_in), (width,)]
    return [*shapes, (widths[-1] + 1, 3)]


def _floats(data: bytes, dtype: str) -> Array:
    if len(data) % int(dtype[-1]):
        raise ProtocolError("undecodable", f"{len(data)} bytes are not a whole number of floats")
    with np.errstate(invalid="ignore"):  # a signalling NaN, which is refused like any other
        return np.frombuffer(data, dtype=dtype).astype(np.float64)


def _split(flat: Array, shapes: list[tuple[int, ...]]) -> list[Array]:
    sizes = [math.prod(shape) for shape in shapes]
    if sum(sizes) != flat.size:
        raise ProtocolError("undecodable", f"{flat.size} parameters, expected {sum(sizes)}")
    parts = np.split(flat, np.cumsum(sizes)[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]
