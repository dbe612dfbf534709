"""Artificial conditions: one map over the state for each, in features that all share."""

import numpy as np

from offboard.data.buffer import SampleTable
from offboard.memory.memory import Condition, Prior
from offboard.training.network import NetworkState, initial_state
from protocol.conventions import Array
from protocol.feature_config import TrainedFeatures
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX
from tests.offboard.flights import PERIOD_NS, offboard_config

FEATURES: TrainedFeatures = offboard_config().features.trained
NORTH = SIGNAL_INDEX["position_n"]


def signals(rows: int, seed: int) -> Array:
    """States on a path that fills the room, [rows, SIGNAL_COUNT]."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows)[:, None] * 0.02
    waves = rng.uniform(0.5, 1.5, SIGNAL_COUNT) * t + rng.uniform(0, 6.3, SIGNAL_COUNT)
    names = list(SIGNAL_INDEX)
    offset, scale = np.zeros(SIGNAL_COUNT), np.ones(SIGNAL_COUNT)
    for name, one in FEATURES.scales.items():
        offset[names.index(name)], scale[names.index(name)] = one.offset, one.scale
    return offset + scale * np.sin(waves)


def condition(name: str, jet: float = 0.0, constant: float = 0.0, rows: int = 400, seed: int = 0) -> Condition:
    """A disturbance east: a constant, and a jet across the north of the room; noise 0.02."""
    table = SampleTable.empty(rows)
    x = signals(rows, seed)
    rng = np.random.default_rng([seed, 1])
    table.time_ns[:] = 10**9 + np.arange(rows) * PERIOD_NS
    table.signals[:] = x
    place = np.exp(-(((x[:, NORTH] - 0.25) / 0.15) ** 2))
    table.labels[:, 0, 1] = constant + jet * place + rng.normal(0, 0.02, rows)
    table.labels[:, 1, 0] = 10.0 * table.labels[:, 0, 1]
    return Condition(name, 1, table)


def random_prior() -> Prior:
    network: NetworkState = initial_state(FEATURES, np.random.default_rng(3))
    return Prior(network, np.array([0.64, 13.0]), np.array([0.01, 1.0]))
