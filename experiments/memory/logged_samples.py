"""Labelled samples of a flight from its tick records, as a trainer would have made them without losses on the link.

Onboard's own signal vector and sampler and the trainer's own labels run over the records, so that a flight without a
trainer teaches the same as one with it.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from offboard.config import LabelConfig
from offboard.data.buffer import TRAINING, SampleTable
from offboard.data.labels import LabelMaker
from onboard.estimation.state import VehicleState
from onboard.record.tick import OFFSET
from onboard.sampling.sampler import SampleQueue, SamplerConfig
from onboard.sampling.signal_vector import SignalVector
from protocol.conventions import Array
from protocol.geometry import rotation_of
from protocol.messages import SampleBatch

RATE_HZ: Final = 50.0
_SAMPLER: Final = SamplerConfig(rate_hz=RATE_HZ, budget_bytes_s=1e9, kept_samples=1024, repeat_from_loss=1.0)
"""Nothing is lost between the records and the labels, so no byte budget and no repeats."""


def labelled_samples(time_ns: NDArray[np.int64], ticks: Array, config: LabelConfig) -> SampleTable:
    """The labelled samples of a flight, all in the training split.

    Parameters
    ----------
    time_ns: [n], of the ticks.
    ticks: [n, fields], rows of onboard.record.tick.TICK.
    """
    maker = LabelMaker(config)
    found = [sample for batch in _batches(time_ns, ticks) for sample in maker.receive(batch)]
    table = SampleTable.empty(len(found))
    for row, sample in enumerate(found):
        table.put(row, sample, TRAINING)
    return table


def _batches(time_ns: NDArray[np.int64], ticks: Array) -> Iterator[SampleBatch]:
    """What onboard would have sent."""
    if time_ns.size < 2:
        return
    signals, queue, state = SignalVector(_period_s(time_ns)), SampleQueue(_SAMPLER), VehicleState()
    for now_ns, row in zip(time_ns.tolist(), ticks, strict=True):
        values = signals.step(_state(state, row), _of(row, "motor_thrust_1", 4), float(row[OFFSET["battery"]]))
        if row[OFFSET["adapting"]]:
            u_hat = _of(row, "position_delivered_n"), _of(row, "attitude_delivered_x")
            nu_ad = _of(row, "position_adaptive_now_n"), _of(row, "attitude_adaptive_now_x")
            queue.push(now_ns, values, u_hat, nu_ad)
        yield from queue.poll(now_ns, 0)


def _period_s(time_ns: NDArray[np.int64]) -> float:
    return float(np.median(np.diff(time_ns))) * 1e-9


def _state(state: VehicleState, row: Array) -> VehicleState:
    """The estimated state of a tick, in `state`: what the signal vector reads of it."""
    state.position[:] = _of(row, "position_n")
    state.velocity[:] = _of(row, "velocity_n")
    w, x, y, z = _of(row, "quaternion_w", 4).tolist()
    state.rotation[:] = np.reshape(rotation_of((w, x, y, z)), (3, 3))
    state.euler[:] = _of(row, "euler_x")
    state.rates[:] = _of(row, "rates_p")
    state.vibration = float(row[OFFSET["vibration"]])
    return state


def _of(row: Array, first: str, count: int = 3) -> Array:
    """The values of a tick from the field `first` on, [count]."""
    at = OFFSET[first]
    return row[at : at + count]
