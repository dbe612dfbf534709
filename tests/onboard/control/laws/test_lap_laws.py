"""Repetitive control and iterative learning: what they learn over laps, and that they are INDI without laps."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from onboard.control.laws.ilc import IterativeLearning, IterativeLearningConfig
from onboard.control.laws.indi import Indi, IndiConfig
from onboard.control.laws.lap_table import LapTable
from onboard.control.laws.law import ChannelState
from onboard.control.laws.repetitive import Repetitive, RepetitiveConfig
from onboard.control.records import ChannelTelemetry
from onboard.control.reference_model import ChannelGains
from tests.onboard.control.fixture import DT

LAP_S = 3.0
TICKS = round(LAP_S / DT)
FILTER_S, LIMIT = 0.1, 8.0
GAINS = ChannelGains(natural_frequency_rad_s=(4.0, 4.0, 5.0), damping=0.8)


def repetitive(lead_s: float = 0.0) -> Repetitive:
    own: dict[str, Any] = {"residual_filter_s": 0.02, "learning": 0.5, "lead_s": lead_s}
    return Repetitive(RepetitiveConfig(kind="repetitive", filter_s=FILTER_S, limit=LIMIT, **own))


def iterative(learning: float = 1.0, lead_s: float = 0.0) -> IterativeLearning:
    own: dict[str, Any] = {"learning": learning, "cutoff_hz": 40.0, "lead_s": lead_s}
    return IterativeLearning(IterativeLearningConfig(kind="ilc", filter_s=FILTER_S, limit=LIMIT, **own), GAINS)


def disturbance(phase: float) -> Any:
    angle = 2.0 * np.pi * phase
    return np.array([np.sin(angle), 2.0 * np.cos(2.0 * angle), 0.5])


def fly_laps(law: Any, laps: float, repeats: bool = True) -> list[tuple[float, Any]]:
    """Phase and nu_ad of each tick, for a residual that repeats with the lap."""
    rows, channel = [], ChannelState(dt=DT, adapt=True, lap_s=LAP_S)
    for tick in range(round(laps * TICKS)):
        phase = tick / TICKS % 1.0
        channel.lap_phase = phase if repeats else -1.0
        channel.residual = disturbance(phase)
        rows.append((phase, law.step(channel, ChannelTelemetry()).copy()))
    return rows


def misfit(rows: list[tuple[float, Any]], lead_s: float = 0.0) -> float:
    """Largest |nu_ad - Delta| over the last lap, Delta taken lead_s later."""
    return max(float(np.abs(nu - disturbance(phase + lead_s / LAP_S)).max()) for phase, nu in rows[-TICKS:])


def test_repetitive_control_has_no_lag_after_a_few_laps() -> None:
    assert misfit(fly_laps(repetitive(), 1.0)) > 0.5
    assert misfit(fly_laps(repetitive(), 6.0)) < 0.1


def test_repetitive_control_reads_the_table_ahead() -> None:
    rows = fly_laps(repetitive(lead_s=0.15), 6.0)
    assert misfit(rows, lead_s=0.15) < 0.15
    assert misfit(rows) > 0.5


@pytest.mark.parametrize("law", [repetitive(0.15), iterative()])
def test_where_the_path_does_not_repeat_both_are_indi(law: Any) -> None:
    indi = Indi(IndiConfig(kind="indi", filter_s=FILTER_S, limit=LIMIT))
    for (_, ours), (_, theirs) in zip(fly_laps(law, 2.0, False), fly_laps(indi, 2.0), strict=True):
        assert ours.tolist() == theirs.tolist()


def test_nu_ad_does_not_jump_when_the_laps_end() -> None:
    law = repetitive(lead_s=0.15)
    last = fly_laps(law, 4.25)[-1][1]
    channel = ChannelState(dt=DT, adapt=True, lap_phase=-1.0, lap_s=LAP_S, residual=disturbance(0.25))
    assert np.abs(law.step(channel, ChannelTelemetry()) - last).max() < 0.1
    for _ in range(400):
        nu = law.step(channel, ChannelTelemetry())
    np.testing.assert_allclose(nu, disturbance(0.25), atol=1e-3)


@pytest.mark.parametrize("law", [repetitive(), iterative()])
def test_nothing_is_learnt_while_it_may_not_adapt(law: Any) -> None:
    channel = ChannelState(dt=DT, adapt=False, lap_s=LAP_S, residual=np.ones(3))
    channel.tracking_error[:3] = 0.1
    for tick in range(3 * TICKS):
        channel.lap_phase = tick / TICKS % 1.0
        assert law.step(channel, ChannelTelemetry()).tolist() == [0.0, 0.0, 0.0]
    assert not law.table.values.any()


def fly_closed_loop(law: IterativeLearning, laps: int, delay_ticks: int = 0, gap: int = -1) -> list[float]:
    """RMS of e for each lap, with e_ddot + K_2 e_dot + K_1 e = nu_ad(t - delay) - Delta. gap: a lap with a gap."""
    K_1, K_2, channel = GAINS.stiffness(), GAINS.rate_gain(), ChannelState(dt=DT, adapt=True, lap_s=LAP_S)
    e, rate, squares = np.zeros(3), np.zeros(3), np.zeros(laps)
    commanded = [np.zeros(3)] * (delay_ticks + 1)
    for tick in range(laps * TICKS):
        lap, phase = tick // TICKS, tick / TICKS % 1.0
        channel.lap_phase = -1.0 if lap == gap and 0.4 < phase < 0.5 else phase
        channel.tracking_error[:] = (*e, *rate)
        commanded.append(law.step(channel, ChannelTelemetry()).copy())
        rate = rate + DT * (commanded.pop(0) - disturbance(phase) - K_2 * rate - K_1 * e)
        e = e + DT * rate
        squares[lap] += float(e @ e) / TICKS
    return np.sqrt(squares).tolist()


def test_iterative_learning_removes_the_error_lap_by_lap() -> None:
    error = fly_closed_loop(iterative(learning=0.6), 8)
    assert error[-1] < 0.05 * error[1]
    assert all(later < earlier for earlier, later in pairwise(error[1:7]))


def test_iterative_learning_needs_the_lead_for_a_loop_with_lag() -> None:
    with_lead = fly_closed_loop(iterative(0.6, lead_s=0.2), 8, delay_ticks=40)[-1]
    without = fly_closed_loop(iterative(0.6, lead_s=0.0), 8, delay_ticks=40)[-1]
    assert with_lead < 0.5 * without


def test_a_lap_with_a_gap_is_not_learnt_from() -> None:
    complete, with_gap = iterative(), iterative()
    fly_closed_loop(complete, 4)
    fly_closed_loop(with_gap, 4, gap=1)
    assert (complete.laps, with_gap.laps) == (3, 2)  # the end of a lap is known in the next


def test_the_table_stays_within_the_limit_and_survives_a_reset() -> None:
    law = IterativeLearning(
        IterativeLearningConfig(kind="ilc", filter_s=0.1, limit=0.3, learning=1.0, cutoff_hz=40.0, lead_s=0.0), GAINS
    )
    fly_closed_loop(law, 4)
    assert np.abs(law.table.values).max() == pytest.approx(0.3)
    before = law.table.values.copy()
    law.reset()
    assert law.table.values.tolist() == before.tolist()


def test_the_table_is_periodic_and_interpolates() -> None:
    table = LapTable(4, fade_s=0.1)
    table.values[:, 0] = (0.0, 1.0, 2.0, 3.0)
    for _ in range(1000):
        table.follow(0.0, DT)
    assert table.ahead(0.125)[0] == pytest.approx(0.0)
    assert table.ahead(0.25)[0] == pytest.approx(0.5)
    assert table.ahead(0.0)[0] == pytest.approx(1.5)  # half way between the last and the first bin
    assert table.ahead(1.25)[0] == pytest.approx(0.5)
    assert [table.bin(phase) for phase in (-0.01, -1e-17, 0.0, 0.99, 1.01)] == [3, 3, 0, 3, 0]
