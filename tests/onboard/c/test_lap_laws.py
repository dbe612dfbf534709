"""The laws that learn over laps: the C core against numpy's, over several laps."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.control.laws.ilc import IterativeLearning, IterativeLearningConfig
from onboard.control.laws.lap_table import LapTable
from onboard.control.laws.law import ChannelState
from onboard.control.laws.repetitive import Repetitive, RepetitiveConfig
from onboard.control.records import ChannelTelemetry
from tests.onboard.c.parity import SETTINGS, call, configured, same, view
from tests.onboard.c.test_laws import GAINS, c_state, same_telemetry

SHARED = {"filter_s": 0.05, "limit": 3.0, "lead_s": 0.04}


def law_of(core: Core, kind: str, bins: int) -> tuple[Any, Any]:
    """The law of both cores: ours, theirs."""
    config: Any
    if kind == "repetitive":
        config = RepetitiveConfig(kind=kind, residual_filter_s=0.03, learning=0.4, bins=bins, **SHARED)
        ours = core.Repetitive()
        core.repetitive_init(ours, configured(core, config))
        return ours, Repetitive(config)
    config = IterativeLearningConfig(kind="ilc", learning=0.6, cutoff_hz=4.0, bins=bins, **SHARED)
    ours = core.IterativeLearning()
    core.ilc_init(ours, configured(core, config), configured(core, GAINS))
    return ours, IterativeLearning(config, GAINS)


@pytest.mark.parametrize("kind", ["repetitive", "ilc"])
@settings(SETTINGS, max_examples=4)
@given(
    seed=st.integers(0, 2**31),
    bins=st.sampled_from([8, 9, 20, 25]),
    breaks=st.lists(st.integers(0, 260), max_size=3),
    idle=st.integers(0, 260),
)
def test_several_laps(core: Core, kind: str, seed: int, bins: int, breaks: list[int], idle: int) -> None:
    rng, (ours, theirs) = np.random.default_rng(seed), law_of(core, kind, bins)
    lap_s, dt, phase = 2.0, 0.03, 0.0
    for tick in range(260):
        phase = -1.0 if tick in breaks else (max(phase, 0.0) + dt / lap_s) % 1.0
        state = ChannelState(dt, adapt=tick != idle, lap_phase=phase, lap_s=0.0 if phase < 0.0 else lap_s)
        state.residual = rng.normal(size=3) + np.sin(6.28 * phase)
        state.tracking_error = 0.1 * rng.normal(size=6)
        state.signals = np.zeros((21, 2))
        telemetry, c_telemetry = ChannelTelemetry(), core.ChannelTelemetry()
        expected = theirs.step(state, telemetry)
        nu = call(core, f"{kind}_step", ours, c_state(core, state), c_telemetry, out=3)
        same(nu, expected, 1e-11, scale=1.0)
        same_telemetry(c_telemetry, telemetry, 1e-11)
        if tick == 200:
            theirs.reset()
            getattr(core, f"{kind}_reset")(ours)
    same(view(ours.table.values)[: 3 * bins], theirs.table.values, 1e-11, scale=1.0)
    if kind == "ilc":
        assert ours.laps == theirs.laps


def test_laps_are_learnt(core: Core) -> None:
    """Else the test above would compare empty tables."""
    ours, theirs = law_of(core, "ilc", 10)
    for tick in range(300):
        state = ChannelState(0.03, adapt=True, lap_phase=0.015 * tick % 1.0, lap_s=2.0)
        state.tracking_error = np.full(6, 0.1 * np.sin(0.1 * tick))
        state.signals = np.zeros((21, 2))
        theirs.step(state, ChannelTelemetry())
        core.ilc_step(ours, c_state(core, state), core.ChannelTelemetry(), np.zeros(3))
    assert ours.laps == theirs.laps == 4
    assert np.abs(theirs.table.values).max() > 0.01


def test_the_bin_of_any_phase(core: Core) -> None:
    ours, theirs = core.LapTable(), LapTable(12, 0.1)
    core.lap_table_init(ours, 12, 0.1)
    for phase in (-1.3, -0.01, -1e-17, 0.0, 0.5, 0.999, 1.0, 2.7):
        assert core.lap_table_bin(ours, phase) == theirs.bin(phase)
