"""The configuration image: flight.yaml and configs/mambo.yaml as one binary file that the drone's library loads.

The drone has no YAML and no Python. The image holds the packed configuration of the core (onboard/c/config_table.py),
the library's own settings, the features that the flight starts with, and the keys of both links. image.c reads it:

    "DMRM", version, sizes of the whole and of the five parts (32-bit, little-endian), digest (BLAKE2b, 32 bytes), parts

The digest covers all other bytes, so that a damaged file is refused. The range of every number is checked as well.
"""

import os
import struct
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final

import numpy as np

from configs.loader import ConfigError
from mambo.config import LibraryConfig
from onboard.c.config_table import Record, TableError, layout, record_of
from onboard.c.config_table import image as core_image
from onboard.config import OnboardConfig
from onboard.control.features import NetworkFeatures
from onboard.control.laws.adaptive import AdaptiveAugmentation
from protocol.conventions import Array
from protocol.feature_set import ChannelFeatures
from protocol.signals import CHANNELS, input_indices

MAGIC: Final = b"DMRM"
VERSION: Final = 1
PARTS: Final = ("settings", "core", "features", "key", "ground key")
HEADER_BYTES: Final = 4 * (3 + len(PARTS))
DIGEST_BYTES: Final = 32
PERSON: Final = b"dmrac image"
SETTINGS_MAGIC: Final = b"DMRS"


def settings_record() -> Record:
    """The structure of the library's settings, for the C table."""
    return record_of(LibraryConfig)


def settings_header() -> bytes:
    """What the packed settings begin with: a word, and 8 bytes that name the layout."""
    return SETTINGS_MAGIC + layout(settings_record())


def image(settings: LibraryConfig, onboard: OnboardConfig, key: bytes | None, ground_key: bytes | None) -> bytes:
    """The image. Raises ConfigError if the C core does not have the configured controller."""
    try:
        packed = settings_header() + settings_record().pack(settings)
        parts = packed, core_image(onboard), start_features(onboard), key or b"", ground_key or b""
    except TableError as error:
        raise ConfigError(f"dmrac mambo config: {error}") from None
    sizes = [HEADER_BYTES + DIGEST_BYTES + sum(map(len, parts)), *map(len, parts)]
    header = MAGIC + struct.pack(f"<{2 + len(PARTS)}I", VERSION, *sizes)
    payload = b"".join(parts)
    return header + digest(header, payload) + payload


def digest(header: bytes, payload: bytes) -> bytes:
    """BLAKE2b of everything in an image but the digest itself, 32 bytes."""
    return blake2b(header + payload, digest_size=DIGEST_BYTES, person=PERSON).digest()


def start_features(onboard: OnboardConfig) -> bytes:
    """What the laws of both channels start with, 8 bytes a number; a channel without features is a 0.

    A channel: m, then index, offset and scale of each input; layers, then the widths; all parameters (for each output a
    row of W and b); the last layer [k, 3].
    """
    controller: Any = onboard.controller.build(onboard.airframe, onboard.features, onboard.seed)
    untrained, packed = onboard.features.untrained, b""
    for name, law in zip(CHANNELS, controller.augmentations, strict=True):
        if not isinstance(law, AdaptiveAugmentation):
            packed += struct.pack("<q", 0)
        elif isinstance(law.features, NetworkFeatures):
            packed += _packed_channel(law.features.channel)
        else:  # radial functions; the bias alone reads nothing of it
            inputs = untrained.inputs(name)
            packed += _packed_selection(inputs, *untrained.offset_and_scale(inputs)) + struct.pack("<q", 0)
    return packed


def _packed_selection(inputs: tuple[str, ...], offset: Array, scale: Array) -> bytes:
    rows = zip(input_indices(inputs), offset, scale, strict=True)
    return struct.pack("<q", len(inputs)) + b"".join(struct.pack("<qdd", int(i), o, s) for i, o, s in rows)


def _packed_channel(channel: ChannelFeatures) -> bytes:
    widths = [W.shape[0] for W in channel.weights]
    layers = [np.hstack([W, b[:, None]]).reshape(-1) for W, b in zip(channel.weights, channel.biases, strict=True)]
    numbers = np.concatenate([*layers, channel.last_layer.reshape(-1)]).astype("<f8")
    shape = struct.pack(f"<{1 + len(widths)}q", len(widths), *widths)
    return _packed_selection(channel.inputs, channel.offset, channel.scale) + shape + numbers.tobytes()


def write_image(path: Path, data: bytes) -> None:
    """Write an image, which holds keys, so that its owner alone can read it. Raises ConfigError."""
    part = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        part.replace(path)  # at once: no half image, and a file of other rights is replaced
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None
