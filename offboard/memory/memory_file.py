"""The file of a memory, as bytes: a numpy archive of plain arrays with a JSON header.

The header has the format, a digest of all arrays, the signals' layout, inputs and widths of the networks, and the names
of the conditions. Reading executes nothing of the content.
"""

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from configs.loader import ConfigError, fill
from offboard.data.buffer import SampleTable
from offboard.memory.memory import CONDITION_COLUMNS, Condition, Memory, Prior, UnusableMemoryError
from offboard.training.network import NetworkState, initial_state
from protocol.feature_config import TrainedFeatures
from protocol.signals import SIGNAL_NAMES

FORMAT: Final = 1
FILE_NAME: Final = "memory.npz"
"""In a memory's folder."""
HEADER: Final = "memory_header"
SIZE_MAX_BYTES: Final = 256 * 2**20
_SHAPE_KEYS: Final = ("position_inputs", "attitude_inputs", "hidden", "count", "channels")
"""What a memory and a flight must have in common. Scales are in the networks; the rest is of the training alone."""
_UNREADABLE: Final = (
    ConfigError,
    OSError,
    ValueError,
    LookupError,
    TypeError,
    EOFError,
    AttributeError,
    zipfile.BadZipFile,
)


def dump_memory(memory: Memory) -> bytes:
    """The bytes of a memory's file."""
    arrays: dict[str, NDArray[Any]] = {
        **memory.prior.network.named_arrays(),
        "variance": memory.prior.variance,
        "noise": memory.prior.noise,
    }
    for number, condition in enumerate(memory.conditions):
        arrays |= {f"condition_{number}_{column}": getattr(condition.samples, column) for column in CONDITION_COLUMNS}
    header = {
        "format": FORMAT,
        "sha256": _digest(arrays),
        "signals": list(SIGNAL_NAMES),
        "features": memory.features.model_dump(mode="json"),
        "learnt": memory.learnt,
        "conditions": [{"name": one.name, "vehicle": one.vehicle} for one in memory.conditions],
    }
    out = io.BytesIO()
    described = {HEADER: np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)}
    np.savez(out, allow_pickle=False, **described, **arrays)
    return out.getvalue()


def _digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of names, types, shapes and values of all arrays but the header."""
    state = hashlib.sha256()
    for name in sorted(arrays):
        if name != HEADER:
            array = arrays[name]
            state.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
            state.update(np.ascontiguousarray(array).tobytes())
    return state.hexdigest()


def is_memory(data: bytes) -> bool:
    """Whether these are the bytes of a memory, damaged or not, rather than of another archive."""
    return HEADER.encode() + b".npy" in data[:200]


def load_memory(data: bytes) -> Memory:
    """The memory in the bytes of a file.

    Raises
    ------
    UnusableMemoryError
        If they are not a memory of this format, or damaged. The message names the key.
    """
    if len(data) > SIZE_MAX_BYTES:
        raise UnusableMemoryError(f"{len(data)} bytes; allowed are at most {SIZE_MAX_BYTES}")
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            unpacked = sum(member.file_size for member in archive.zip.infolist())
            if unpacked > SIZE_MAX_BYTES:
                raise UnusableMemoryError(f"{unpacked} bytes unpacked; allowed are at most {SIZE_MAX_BYTES}")
            arrays = {key: archive[key] for key in archive.files}
        header = _header(arrays)
        return _from_arrays(header, arrays)
    except UnusableMemoryError:
        raise
    except _UNREADABLE as error:
        raise UnusableMemoryError(f"not a memory, or damaged: {' '.join(str(error).split())}") from None


def _header(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    if HEADER not in arrays:
        raise UnusableMemoryError(f"not a memory: it has no {HEADER}")
    header: dict[str, Any] = json.loads(arrays[HEADER].tobytes())
    if header.get("format") != FORMAT:
        raise UnusableMemoryError(f"format: {header.get('format')!r}: this version reads format {FORMAT}")
    if header.get("sha256") != _digest(arrays):
        raise UnusableMemoryError("sha256: the arrays are not those that were written")
    if header.get("signals") != list(SIGNAL_NAMES):
        raise UnusableMemoryError("signals: not the signals of this version; learn it again from the flights' logs")
    return header


def _from_arrays(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Memory:
    """The memory of a header and its arrays. Raises ValueError and the like for what does not fit."""
    features = fill(TrainedFeatures, header["features"], HEADER, at="features.")
    network = NetworkState.from_named_arrays(arrays, len(features.hidden) + 1)
    _check_network(network, initial_state(features, np.random.default_rng(0)))
    conditions = tuple(_condition(number, about, arrays) for number, about in enumerate(header["conditions"]))
    channels = network.offset.shape[0]
    variance, noise = (_positive(key, arrays[key], channels) for key in ("variance", "noise"))
    return Memory(features, Prior(network, variance, noise), conditions, int(header["learnt"]))


def _check_network(network: NetworkState, blank: NetworkState) -> None:
    """Raise ValueError, naming the array, if shapes are not those of `blank` or a value is not finite."""
    for field in fields(NetworkState):
        found, expected = getattr(network, field.name), getattr(blank, field.name)
        pairs = zip(found, expected, strict=True) if isinstance(found, tuple) else [(found, expected)]
        for one, other in pairs:
            if one.shape != other.shape or one.dtype != other.dtype or not np.isfinite(one).all():
                raise ValueError(f"{field.name}: expected finite {other.dtype} of shape {other.shape}")
    if not (network.scale > 0.0).all():
        raise ValueError("scale: expected positive numbers")


def _condition(number: int, about: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Condition:
    table = SampleTable.empty(arrays[f"condition_{number}_time_ns"].shape[0])
    for column in CONDITION_COLUMNS:
        found, expected = arrays[f"condition_{number}_{column}"], getattr(table, column)
        if found.shape != expected.shape or found.dtype != expected.dtype:
            raise ValueError(f"condition_{number}_{column}: {found.dtype} {found.shape}, expected {expected.shape}")
        if not np.isfinite(found).all():
            raise ValueError(f"condition_{number}_{column}: a value is not finite")
        expected[:] = found
    return Condition(str(about["name"]), int(about["vehicle"]), table)


def _positive(key: str, values: NDArray[Any], channels: int) -> NDArray[np.float64]:
    if values.shape != (channels,) or not (np.isfinite(values) & (values > 0.0)).all():
        raise ValueError(f"{key}: expected {channels} positive numbers")
    return values.astype(np.float64)


def require_fit(learnt: TrainedFeatures, configured: TrainedFeatures) -> None:
    """Raise UnusableMemoryError, naming the key, if the networks of a memory are not those that are configured."""
    for key in _SHAPE_KEYS:
        of_memory, wanted = getattr(learnt, key), getattr(configured, key)
        if of_memory != wanted:
            raise UnusableMemoryError(
                f"features.trained.{key}: {json.dumps(of_memory)}; allowed is {json.dumps(wanted)}"
            )
