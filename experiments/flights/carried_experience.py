"""Carries what one lockstep flight learnt to another: a trainer's experience, or last layers of a fixed controller.

The file is an experience (offboard.data.experience) with two additions: the last version alone (key "features") and the
adaptive controllers' last layers. For a learning controller, offboard sends the last version again over the link; a
controller with fixed features (mrac, bias) starts from the last layer.
"""

import io
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np

from configs.loader import ConfigError
from experiments.flights.scenario import FlightConfig
from offboard.memory.folder import read_memory
from offboard.memory.memory import UnusableMemoryError
from offboard.memory.memory_file import is_memory
from onboard.control.interface import Controller, LearningController
from onboard.cores import AnyCore

CHANNEL_KEYS: Final = ("position_last_layer", "attitude_last_layer")


def learns(controller: Controller) -> bool:
    """Return whether a controller accepts features over the link."""
    return isinstance(controller, LearningController) and controller.accepts_features


def dump_learnt(onboard: AnyCore, offboard: Any) -> bytes:
    """Return what the flight learnt as the content of a file; an archive without arrays if nothing adapts."""
    arrays: dict[str, Any] = {}
    controller = onboard.controller
    if offboard is not None and offboard.learner.latest is not None:
        from protocol.feature_codec import encode_feature_set

        with np.load(io.BytesIO(offboard.learner.experience()), allow_pickle=False) as archive:
            arrays |= {key: archive[key] for key in archive.files}
        encoded = encode_feature_set(offboard.learner.latest, "float32")
        arrays["features"] = np.frombuffer(encoded, dtype=np.uint8)
    if hasattr(controller, "last_layers"):
        layers = zip(CHANNEL_KEYS, controller.last_layers(), strict=True)
        arrays |= {key: W for key, W in layers if W is not None}
    out = io.BytesIO()
    np.savez(out, allow_pickle=False, **arrays)
    return out.getvalue()


def read_experience(config: FlightConfig) -> bytes | None:
    """Return the experience or memory that a configuration starts from; None for neither.

    Raises
    ------
    ConfigError
        If it cannot be read, or both are named.
    """
    path, memory = config.experience, config.offboard.experience.memory
    if path and memory:
        raise ConfigError(f"experience: {path}: not allowed with offboard.experience.memory, {memory}")
    if memory:
        return read_memory(Path(memory))
    if not path:
        return None
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ConfigError(f"experience: {path}: cannot be read: {error.strerror}") from None


def start_from(data: bytes, onboard: AnyCore, offboard: Any, frozen: bool = False) -> None:
    """Load what was learnt into the cores, before their first step.

    A trainer that goes on learning also gets the samples: without them its first rounds, on a few seconds of the new
    flight, would forget what the features had learnt.

    Raises
    ------
    ConfigError
        If the file is not an experience, has nothing for this controller, or was made with other networks.
    """
    controller = onboard.controller
    try:
        if is_memory(data) and not learns(controller):
            raise ValueError("a memory holds features, and this controller uses none")
        if learns(controller) and offboard is not None:
            from offboard.data.experience import ExperienceError

            try:
                if is_memory(data):
                    offboard.recall(data)
                elif frozen:
                    offboard.warm_start(data)
                else:
                    offboard.resume(data)
            except (ExperienceError, UnusableMemoryError) as error:
                raise ValueError(str(error)) from None
        elif hasattr(controller, "start_from"):
            with np.load(io.BytesIO(data), allow_pickle=False) as archive:
                position, attitude = (archive[key] if key in archive.files else None for key in CHANNEL_KEYS)
            controller.start_from((position, attitude))
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError(f"experience: {error}") from None
