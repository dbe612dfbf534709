"""Experience files: checkpoints of a learner, and feature versions to start from, as bytes.

A file is a numpy archive (.npz) of plain arrays with a JSON header. Reading it executes nothing of its content.
"""

import io
import json
import zipfile
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from offboard.data.buffer import COLUMNS, SampleTable
from offboard.training.job import TrainerState
from offboard.training.network import NetworkState
from protocol.errors import ProtocolError
from protocol.feature_codec import decode_feature_set, encode_feature_set
from protocol.feature_set import FeatureSet

FORMAT: Final = 2
_UNREADABLE: Final = (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, ProtocolError)


class ExperienceError(Exception):
    """A file that is not an experience file, or cannot be used. The message states the reason."""


@dataclass(frozen=True, slots=True, eq=False)
class Experience:
    """Everything that a restarted learner needs to continue."""

    state: TrainerState
    buffer: SampleTable
    buffer_order: NDArray[np.int64]
    newest: SampleTable
    versions: tuple[FeatureSet, ...]
    """The stored versions, oldest first."""
    version: int
    """The highest version number in use."""
    labelled: int
    training_samples: int


def dump_experience(experience: Experience) -> bytes:
    """The bytes of an experience file."""
    state, network = experience.state, experience.state.network
    header = {
        "format": FORMAT,
        "layers": len(network.weights),
        "moments": len(state.moments),
        "steps": state.steps,
        "rounds": state.rounds,
        "versions": len(experience.versions),
        "version": experience.version,
        "labelled": experience.labelled,
        "training_samples": experience.training_samples,
    }
    arrays: dict[str, NDArray[Any]] = {
        "header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
        **network.named_arrays(),
        "buffer_order": experience.buffer_order,
    }
    arrays |= {f"moment_{number}": moment for number, moment in enumerate(state.moments)}
    for name, table in (("buffer", experience.buffer), ("newest", experience.newest)):
        arrays |= {f"{name}_{column}": getattr(table, column) for column in COLUMNS}
    arrays |= {f"version_{number}": _encoded(features) for number, features in enumerate(experience.versions)}
    return _archive(arrays)


def _encoded(features: FeatureSet) -> NDArray[np.uint8]:
    return np.frombuffer(encode_feature_set(features, "float32"), dtype=np.uint8)


def _archive(arrays: dict[str, NDArray[Any]]) -> bytes:
    out = io.BytesIO()
    np.savez(out, allow_pickle=False, **arrays)
    return out.getvalue()


def load_experience(data: bytes) -> Experience:
    """The experience in the bytes of a file.

    Raises
    ------
    ExperienceError
        If they are not an experience file, or damaged.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            return _from_arrays({name: archive[name] for name in archive.files})
    except _UNREADABLE as error:
        raise ExperienceError(f"not an experience file of format {FORMAT}: {error}") from None


def _from_arrays(arrays: dict[str, NDArray[Any]]) -> Experience:
    header = json.loads(arrays["header"].tobytes())
    if header["format"] != FORMAT:
        raise ValueError(f"format {header['format']}")
    network = NetworkState.from_named_arrays(arrays, header["layers"])
    moments = tuple(arrays[f"moment_{number}"] for number in range(header["moments"]))
    versions = tuple(decode_feature_set(arrays[f"version_{number}"].tobytes()) for number in range(header["versions"]))
    tables = [SampleTable(*(arrays[f"{name}_{column}"] for column in COLUMNS)) for name in ("buffer", "newest")]
    return Experience(
        state=TrainerState(network, moments, header["steps"], header["rounds"]),
        buffer=tables[0],
        buffer_order=arrays["buffer_order"],
        newest=tables[1],
        versions=versions,
        version=header["version"],
        labelled=header["labelled"],
        training_samples=header["training_samples"],
    )


def dump_version(features: FeatureSet) -> bytes:
    """The bytes of a version file, from which another flight can start."""
    return _archive({"features": _encoded(features)})


def load_version(data: bytes) -> FeatureSet:
    """The feature version in a version file, or the newest one in an experience file.

    Raises
    ------
    ExperienceError
        If the file is neither, or contains no version.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            if "features" in archive.files:
                return decode_feature_set(archive["features"].tobytes())
    except _UNREADABLE as error:
        raise ExperienceError(f"not a file of features: {error}") from None
    experience = load_experience(data)
    if not experience.versions:
        raise ExperienceError("the experience contains no version yet")
    return experience.versions[-1]
