"""Signal vector and sampler: the C core against numpy's."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.estimation.state import VehicleState
from onboard.sampling.sampler import SampleQueue, SamplerConfig
from onboard.sampling.signal_vector import SignalVector
from protocol.geometry import rotation_of
from protocol.messages import SampleBatch
from protocol.signals import SIGNAL_COUNT
from tests.onboard.c.parity import SETTINGS, array, configured, filled, quaternions, same, vectors, view
from tests.onboard.control.fixture import DT

TICK_NS = 5_000_000
CONFIGS = [
    SamplerConfig(),
    SamplerConfig(budget_bytes_s=1500.0, kept_samples=8, batch_samples=3),
    SamplerConfig(rate_hz=200.0, batch_samples=1, budget_bytes_s=60_000.0, repeat_after_s=0.05),
    SamplerConfig(rate_hz=33.0, batch_samples=8, repeat_from_loss=1.0),
]


@SETTINGS
@given(q=quaternions(), values=vectors(12, 5.0), thrusts=vectors(8, 0.3))
def test_signal_vector(core: Core, q: list[float], values: list[float], thrusts: list[float]) -> None:
    ours, theirs, state = core.SignalVector(), SignalVector(DT), VehicleState(vibration=0.7)
    core.signal_vector_init(ours, DT)
    state.rotation[:] = np.reshape(rotation_of((*q,)), (3, 3))
    state.position[:], state.velocity[:], state.euler[:], state.rates[:] = np.reshape(values, (4, 3))
    for motors in (thrusts[:4], thrusts[4:]):
        expected = theirs.step(state, np.array(motors), 3.8)
        core.signal_vector_step(ours, filled(core.VehicleState, state), array(core, motors), 3.8)
        same(ours.values, expected)


def same_batch(ours: Any, theirs: SampleBatch) -> None:
    n = theirs.signals.shape[0]
    numbers = (ours.first_index, ours.time_ns, ours.period_ns, ours.feature_version, ours.count)
    assert numbers == (theirs.first_index, theirs.time_ns, theirs.period_ns, theirs.feature_version, n)
    np.testing.assert_array_equal(view(ours.signals)[: n * SIGNAL_COUNT], theirs.signals.reshape(-1))
    np.testing.assert_array_equal(view(ours.delivered)[: 6 * n], theirs.delivered.reshape(-1))
    np.testing.assert_array_equal(view(ours.adaptive)[: 6 * n], theirs.adaptive.reshape(-1))


class Both:
    """The two queues, side by side."""

    def __init__(self, core: Core, config: SamplerConfig) -> None:
        self.core, self.ours, self.theirs = core, core.SampleQueue(), SampleQueue(config)
        core.sampler_init(self.ours, configured(core, config))
        self.rng, self.now_ns = np.random.default_rng(1), 10**9

    def tick(self, push: bool, poll: bool, version: int, loss: float) -> int:
        self.now_ns += TICK_NS
        signals, values = self.rng.normal(size=SIGNAL_COUNT), self.rng.normal(size=(2, 2, 3))
        if push:
            self.theirs.push(self.now_ns, signals, list(values[0]), list(values[1]))
            self.core.sampler_push(self.ours, self.now_ns, signals, values[0].reshape(-1), values[1].reshape(-1))
        count = 0
        if poll:
            batches = (self.core.SampleBatch * 10)()
            count = self.core.sampler_poll(self.ours, self.now_ns, version, loss, batches[0])
            expected = self.theirs.poll(self.now_ns, version, loss)
            assert count == len(expected)
            for one, other in zip(batches, expected, strict=False):
                same_batch(one, other)
        return count

    def charge(self, size: int) -> None:
        self.theirs.charge(size, self.now_ns)
        self.core.sampler_charge(self.ours, size, self.now_ns)

    def same_counts(self) -> None:
        ours = {name: getattr(self.ours, name) for name in ("taken", "dropped", "repeated")}
        assert ours == self.theirs.counts


@pytest.mark.parametrize("config", CONFIGS)
@SETTINGS
@given(
    phases=st.lists(
        st.tuples(
            st.integers(1, 60),
            st.booleans(),
            st.sampled_from([1, 2, 7]),
            st.integers(0, 2),
            st.sampled_from([0.0, 0.5, 1.0]),
            st.sampled_from([0, 60, 900]),
        ),
        min_size=1,
        max_size=6,
    )
)
def test_sampler(core: Core, config: SamplerConfig, phases: list[Any]) -> None:
    both = Both(core, config)
    for count, push, poll_every, version, loss, charge in phases:
        for tick in range(count):
            both.tick(push, tick % poll_every == 0, version, loss)
        if charge:
            both.charge(charge)
    both.same_counts()


def test_the_sampler_of_a_whole_flight(core: Core) -> None:
    both = Both(core, CONFIGS[2])
    sent = sum(both.tick(True, True, tick // 500, 0.5) for tick in range(2000))
    both.same_counts()
    assert sent > 1000
    assert both.ours.repeated > 0


def test_repeats_beyond_the_limit_leave_out_the_oldest(core: Core) -> None:
    """After a long pause of the link so many batches go at once; numpy's core would repeat all of them."""
    config = SamplerConfig(rate_hz=200.0, batch_samples=1, budget_bytes_s=1e6, repeat_after_s=1.0, kept_samples=1024)
    ours, batches, zero = core.SampleQueue(), (core.SampleBatch * 10)(), np.zeros(SIGNAL_COUNT)
    core.sampler_init(ours, configured(core, config))
    for tick in range(600):
        core.sampler_push(ours, tick * TICK_NS, zero, zero[:6], zero[:6])
    sent = [core.sampler_poll(ours, (600 + tick) * TICK_NS, 0, 0.5, batches[0]) for tick in range(60)]
    assert sum(sent) > 400
    assert ours.repeats_count == 256
    assert ours.repeats[ours.repeats_first].batch.first_index == sum(sent) - 256
