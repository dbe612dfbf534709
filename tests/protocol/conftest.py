"""Messages and feature sets for the tests of the protocol."""

from collections.abc import Callable

import numpy as np
import pytest

from protocol.feature_set import ChannelFeatures, FeatureSet
from protocol.messages import FeatureChunk, Message, Pose, SampleBatch, Status, TimeSyncReply, TimeSyncRequest
from protocol.signals import SIGNAL_COUNT

INPUTS = ("velocity_n", "velocity_e", "velocity_d", "roll", "pitch", "yaw")


def channel(rng: np.random.Generator, widths: tuple[int, ...] = (32, 32, 20)) -> ChannelFeatures:
    sizes = (len(INPUTS), *widths)
    weights = tuple(rng.normal(size=(out, into)) for into, out in zip(sizes, widths, strict=False))
    biases = tuple(rng.normal(size=out) for out in widths)
    last_layer = rng.normal(size=(widths[-1] + 1, 3))
    return ChannelFeatures(INPUTS, rng.normal(size=6), np.full(6, 0.5), weights, biases, last_layer)


@pytest.fixture
def make_features() -> Callable[..., FeatureSet]:
    """A pair of 6-32-32-20 networks with random parameters."""

    def make(version: int = 1, seed: int = 0) -> FeatureSet:
        rng = np.random.default_rng([seed, version])
        return FeatureSet(version, version - 1, 1000, channel(rng), channel(rng))

    return make


def sample_batch(n: int = 5, seed: int = 0) -> SampleBatch:
    rng = np.random.default_rng(seed)
    shapes = ((n, SIGNAL_COUNT), (n, 2, 3), (n, 2, 3))
    signals, delivered, adaptive = (rng.normal(size=shape).astype(np.float32) for shape in shapes)
    return SampleBatch(7, 123_000_000, 20_000_000, 3, signals, delivered, adaptive)


UP: tuple[Message, ...] = (
    sample_batch(1),
    sample_batch(8),
    Status(3, 12, 13, b"\x05\x80", 11, 5, 40_000, 2, -1, 7_000, 12, 3),
    TimeSyncRequest(5_000_000_000),
)
DOWN: tuple[Message, ...] = (
    FeatureChunk(13, 7, 8, bytes(range(16)), b"\xff" * 1100),
    Pose(9, np.array([1.0, -2.0, -1.5], np.float32), np.array([0.6, 0.0, 0.8, 0.0], np.float32)),
    TimeSyncReply(5_000_000_000, 8, 9),
)


@pytest.fixture(params=UP, ids=lambda m: type(m).__name__)
def up_message(request: pytest.FixtureRequest) -> Message:
    message: Message = request.param
    return message


@pytest.fixture(params=DOWN, ids=lambda m: type(m).__name__)
def down_message(request: pytest.FixtureRequest) -> Message:
    message: Message = request.param
    return message


@pytest.fixture(params=UP + DOWN, ids=lambda m: type(m).__name__)
def any_message(request: pytest.FixtureRequest) -> Message:
    message: Message = request.param
    return message


@pytest.fixture
def all_messages() -> tuple[tuple[Message, ...], tuple[Message, ...]]:
    """Messages up, messages down."""
    return UP, DOWN
