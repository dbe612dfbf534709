"""Margins of loops whose margins are known."""

import numpy as np
import pytest

from experiments.margins.stability import margins, unstable_poles

OMEGA = np.geomspace(0.05, 200.0, 2000)
S = 1j * OMEGA


def test_an_integrator_with_a_dead_time() -> None:
    """L = k exp(-d s) / s: crossover k, phase margin pi/2 - k d, delay margin pi/(2 k) - d, gain margin pi/(2 k d)."""
    k, d = 4.0, 0.1
    found = margins(OMEGA, k / S * np.exp(-d * S))
    assert found.crossover_rad_s == pytest.approx(k, rel=1e-3)
    assert found.phase_margin_deg == pytest.approx(90.0 - np.degrees(k * d), rel=1e-3)
    assert found.delay_margin_ms == pytest.approx(1e3 * (np.pi / 2 / k - d), rel=1e-3)
    assert found.gain_margin_db == pytest.approx(20.0 * np.log10(np.pi / (2.0 * k * d)), rel=1e-2)


def test_a_conditionally_stable_loop_has_a_margin_downwards_too() -> None:
    """L = k (s + 1)^2 / s^3 is unstable for small k: the phase crosses -180 degrees at omega = 1, where |L| = 2 k."""
    found = margins(OMEGA, 4.0 * (S + 1.0) ** 2 / S**3)
    assert found.gain_margin_db == pytest.approx(20.0 * np.log10(8.0), rel=1e-2)


def test_a_loop_without_crossings_has_infinite_margins() -> None:
    found = margins(OMEGA, 0.5 / (S + 1.0))
    assert found.gain_margin_db == found.phase_margin_deg == found.delay_margin_ms == np.inf


def test_the_delay_margin_is_the_delay_that_takes_the_phase_margin() -> None:
    L = 30.0 * (S + 3.0) / S**2 / (1.0 + 0.02 * S)
    found = margins(OMEGA, L)
    late = margins(OMEGA, L * np.exp(-1e-3 * found.delay_margin_ms * S))
    assert late.phase_margin_deg == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize(
    ("poles", "count"),
    [((-1.0, -2.0, -3.0), 0), ((1.0, -2.0, -3.0), 1), ((0.5 + 3.0j, 0.5 - 3.0j, -1.0), 2), ((1.0, 2.0, 3.0), 3)],
)
def test_unstable_poles_are_counted(poles: tuple[complex, ...], count: int) -> None:
    characteristic = np.prod([(S - pole) / (S + 5.0) for pole in poles], axis=0)
    assert unstable_poles(characteristic) == count


@pytest.mark.parametrize(("delay_s", "count"), [(0.38, 0), (0.4, 2)])
def test_the_count_holds_with_a_dead_time(delay_s: float, count: int) -> None:
    """L = 4 exp(-d s) / s is unstable from d = pi / 8 on."""
    assert unstable_poles((S + 4.0 * np.exp(-delay_s * S)) / (S + 4.0)) == count
