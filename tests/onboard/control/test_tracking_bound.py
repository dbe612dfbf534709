"""The live bound on the tracking error: its majorant, its inequality for a known Delta, and its coverage in flight."""

from typing import Any

import numpy as np
import pytest
import scipy.linalg

from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.metrics import BoundMetrics, bound_metrics
from experiments.flights.scenario import Choices, resolve
from onboard.control.tracking_bound import OVERSHOOT, SPREAD, AxisBound, majorant
from tests.onboard.control.fixture import DT, FORCE, TORQUE, Rig, shipped_controller

LAWS = ("none", "pid", "indi", "l1", "repetitive", "ilc", "bias", "mrac", "dmrac")
JET = "vehicle.disturbances.0.speed_m_s=8.0"


def impulse_response(omega: float, zeta: float, t: np.ndarray) -> np.ndarray:
    """h1(t) of 1 / (s^2 + 2 zeta omega s + omega^2), by the matrix exponential."""
    A = np.array([[0.0, 1.0], [-omega * omega, -2.0 * zeta * omega]])
    return np.array([scipy.linalg.expm(A * one)[0, 1] for one in t])


@pytest.mark.parametrize("zeta", [0.3, 0.5, 0.7, 0.85, 0.9, 0.94, 0.96, 0.999, 1.0, 1.0001, 1.3, 3.0])
def test_the_majorant_is_above_the_impulse_response_and_not_far_above(zeta: float) -> None:
    omega, t = 7.0, np.linspace(0.0, 4.0, 2001)
    fast, slow, gain = majorant(omega, zeta)
    spread = fast - slow
    above = gain * t * np.exp(-slow * t)
    if spread > 1e-6 * fast:
        above = gain * (np.exp(-slow * t) - np.exp(-fast * t)) / spread
    h1 = np.abs(impulse_response(omega, zeta, t))
    assert np.all(above >= h1 - 1e-12)
    assert gain / (fast * slow) < (1.8 if zeta < 0.5 else 1.5) * np.trapezoid(h1, t)
    if zeta >= 1.0:
        np.testing.assert_allclose(above, h1, atol=1e-9)


def test_the_constants_of_the_majorant_fit() -> None:
    """sin x <= OVERSHOOT (1 - exp(-SPREAD x)) / SPREAD up to pi; from there on the right side is above 1."""
    x = np.linspace(1e-6, np.pi, 100_001)
    right = OVERSHOOT * (1.0 - np.exp(-SPREAD * x)) / SPREAD
    assert np.all(right >= np.sin(x))
    assert right[-1] > 1.0
    assert not np.all(0.99 * right >= np.sin(x)), "the constants have no slack to give"


@pytest.mark.parametrize("zeta", [0.3, 0.7, 0.85, 1.0, 1.2])
@pytest.mark.parametrize("omega", [1.0, 6.0, 17.0])
def test_the_bound_holds_for_any_start_and_any_w_if_delta_is_known(omega: float, zeta: float) -> None:
    """The linear plant d_ddot + 2 zeta omega d_dot + omega^2 d = w, solved exactly, with w constant over each tick."""
    rng = np.random.default_rng([round(10 * omega), round(10 * zeta)])
    A = np.array([[0.0, 1.0], [-omega * omega, -2.0 * zeta * omega]])
    step = scipy.linalg.expm(A * DT)
    push = np.linalg.solve(A, (step - np.eye(2)) @ np.array([0.0, 1.0]))
    tightest = np.inf
    for trial in range(20):
        axis = AxisBound(omega, zeta)
        axis.prepare(DT)
        d, rate = rng.normal(size=2) * (1.0, omega)
        assert axis.restart(0.0, d, rate) == abs(d)
        for tick in range(400):
            w = float(rng.normal() if trial % 2 else np.sign(np.sin(0.02 * trial * tick)) + 1.0)
            before = axis.k1 * d + axis.k2 * rate
            d, rate = step @ np.array([d, rate]) + push * w
            u_hat = 0.5 * (before + axis.k1 * d + axis.k2 * rate) - w  # a_d = 0, Delta = 0
            bound = axis.step(0.0, u_hat, 0.0, d, rate)
            assert abs(d) <= bound * (1.0 + 1e-9) + 1e-12
            tightest = min(tightest, bound / max(abs(d), 1e-12))
    assert tightest < 1.5, "it is not loose everywhere either"


@pytest.mark.parametrize("name", LAWS)
def test_the_bound_covers_every_law_also_in_saturation(name: str) -> None:
    """A perfectly known vehicle, 2.6 m from its target, with constant disturbances in both channels."""
    rig = Rig(shipped_controller(name), force=FORCE, torque=TORQUE)
    rig.target = np.array([2.6, 0.0, -1.0])
    errors, bounds = [], []
    for _ in range(round(4.0 / DT)):
        errors.append(float(np.linalg.norm(rig.target - rig.position)))
        rig.fly(DT)
        bounds.append(rig.output.position.tracking_bound)
    excess = np.array(errors) - np.array(bounds)
    assert errors[0] == pytest.approx(bounds[0])
    assert np.all(excess < 0.02 * np.array(errors) + 1e-3), "but for the lag of Delta_hat after the start"
    assert np.mean(excess <= 0.0) > 0.9


def test_no_bound_while_the_laws_do_not_adapt_and_a_new_start_afterwards() -> None:
    rig = Rig(shipped_controller("indi"), force=FORCE)
    rig.target = np.array([0.5, 0.0, -1.0])
    rig.fly(1.0)
    rig.adapt = False
    rig.fly(DT)
    assert rig.output.position.tracking_bound == rig.output.attitude.tracking_bound == 0.0
    rig.adapt = True
    error = float(np.linalg.norm(rig.target - rig.position))
    rig.fly(DT)
    assert rig.output.position.tracking_bound == pytest.approx(error)


def test_a_jump_of_the_pose_is_an_error_at_once() -> None:
    """The path stays where it is; the bound starts anew at the distance that the estimate now has."""
    rig = Rig(shipped_controller("indi"))
    rig.fly(1.0)
    assert rig.output.position.tracking_bound < 0.01
    rig.jump = np.array([0.3, 0.0, 0.0])
    rig.state.position_jump[:] = rig.jump
    rig.state.position_reset_count += 1
    rig.fly(DT)
    assert rig.output.position.tracking_bound == pytest.approx(0.3, abs=0.01)


def test_the_bound_does_not_change_the_flight_of_any_law() -> None:
    """Two controllers, one without its bounds: the same demands to the bit."""
    rigs = [Rig(shipped_controller("mrac"), force=FORCE, torque=TORQUE) for _ in range(2)]
    rigs[1].controller.bounds.step = lambda *_: None
    one, other = (rig.fly(1.0) for rig in rigs)
    assert all(np.array_equal(a["position"], b["position"]) for a, b in zip(one, other, strict=True))


def bounds_of(scenario: str, controller: str, *assignments: str) -> dict[str, BoundMetrics]:
    outcome = fly_lockstep(resolve(scenario, Choices(controller, 0, 16.0, assignments)))
    assert not outcome.crash_reason
    return bound_metrics(outcome.trace)


@pytest.mark.parametrize("controller", ["l1", "indi", "dmrac"])
@pytest.mark.parametrize("scenario", ["figure8_calm", "figure8_wind", "jet 8 m/s"])
def test_flights_stay_within_a_bound_that_says_something(scenario: str, controller: str) -> None:
    chosen: tuple[Any, ...] = (
        ("figure8_wind", controller, JET) if scenario.startswith("jet") else (scenario, controller)
    )
    for channel in bounds_of(*chosen).values():
        assert channel.coverage >= 0.99
        # In calm the noise of Delta_hat is most of the bound: 16 times the 6 mrad of dmrac's attitude.
        assert 1.0 < channel.bound_median / channel.error_median < 18.0


def test_coverage_shows_a_wrong_delta_hat(monkeypatch: pytest.MonkeyPatch) -> None:
    """With Delta_hat = 0 an uncompensated disturbance is not in the bound, and many ticks lie outside it."""
    honest = bounds_of("figure8_calm", "none")["position"]
    step = AxisBound.step
    monkeypatch.setattr(AxisBound, "step", lambda self, a_d, u_hat, _, d, rate: step(self, a_d, u_hat, 0.0, d, rate))
    wrong = bounds_of("figure8_calm", "none")["position"]
    assert honest.coverage > 0.99
    assert wrong.coverage < 0.8
    assert wrong.error_median == honest.error_median
