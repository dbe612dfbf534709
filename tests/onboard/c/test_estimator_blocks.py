"""Blocks of the estimator, one step each: the C core against numpy's."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.event_text import calibration_text, estimator_text
from onboard.c.library import Core
from onboard.estimation.calibration import BenchCalibration
from onboard.estimation.config import EstimatorConfig
from onboard.estimation.error_state_filter import ErrorStateFilter
from onboard.estimation.imu_conditioning import StillStart, VibrationMeter
from onboard.estimation.state import VehicleState
from onboard.estimation.stuck_gyro import StuckGyro
from protocol.mavlink.vehicle import ImuReading
from tests.onboard.c.parity import SETTINGS, array, call, configured, numbers, quaternions, same, vectors, view
from tests.onboard.control.fixture import DT

SEEDS = st.integers(0, 2**31)
NOISE = (0.3, 0.02, 1e-3, 5e-3)


class Both:
    """The two filters, with the same state: a covariance, a history with corrections in it."""

    def __init__(self, core: Core, seed: int, q: list[float], every: int = 1) -> None:
        self.core, self.rng = core, np.random.default_rng(seed)
        self.theirs, self.ours = ErrorStateFilter(every), core.ErrorStateFilter()
        core.filter_init(self.ours, every)
        self.now_ns = 10**10
        bias, sigmas = 0.05 * self.rng.normal(size=3), self.rng.uniform(0.01, 0.5, 15)
        self.theirs.start((*q,), (*bias.tolist(),), (*sigmas.tolist(),))
        core.filter_start(self.ours, *(array(core, one) for one in (q, bias, sigmas)))
        for _ in range(4):
            self.predict()

    def predict(self) -> None:
        self.now_ns += 5_000_000
        force, rate = 9.0 * self.rng.normal(size=3), self.rng.normal(size=3)
        noise = self.core.ImuNoise(*NOISE)
        self.theirs.predict(self.now_ns, DT, (*force.tolist(),), (*rate.tolist(),), NOISE, 0.005)
        given = array(self.core, force), array(self.core, rate)
        self.core.filter_predict(self.ours, self.now_ns, DT, *given, noise, 0.005)

    def compare(self, rtol: float = 1e-12) -> None:
        for name in ("position", "velocity", "quaternion", "rotation", "gyro_bias", "accelerometer_bias"):
            same(getattr(self.ours, name), getattr(self.theirs, name), rtol, scale=1.0)
        same(self.ours.P, self.theirs.P, rtol)
        past = self.core.PastState()
        for back_ns in (0, 3_000_000, 10_000_000, 60_000_000):
            expected = self.theirs.at(self.now_ns - back_ns)
            assert self.core.filter_at(self.ours, self.now_ns - back_ns, past) == (expected is not None)
            if expected is not None:
                for name in ("position", "velocity", "rotation", "rate_world"):
                    same(getattr(past, name), getattr(expected, name), 10.0 * rtol, scale=1.0)


@SETTINGS
@given(seed=SEEDS, q=quaternions(), every=st.integers(1, 3))
def test_prediction(core: Core, seed: int, q: list[float], every: int) -> None:
    Both(core, seed, q, every).compare()


@pytest.mark.parametrize("precision", ["core", "core32"])
def test_a_prediction_makes_the_covariance_symmetric(precision: str, request: pytest.FixtureRequest) -> None:
    core = request.getfixturevalue(precision)
    ours, noise, zero = core.ErrorStateFilter(), core.ImuNoise(*NOISE), array(core, [0.0] * 3)
    core.filter_init(ours, 1)
    core.filter_start(ours, array(core, [0.9, 0.1, -0.3, 0.3]), zero, array(core, [0.1] * 15))
    P = view(ours.P).reshape(15, 15)
    P[9, 6] += 1e-4
    P[6, 9] -= 1e-4
    for k in range(20):
        core.filter_predict(ours, (k + 1) * 5_000_000, DT, array(core, [0.3, -0.2, -9.8]), zero, noise, 0.0)
        np.testing.assert_array_equal(P, P.T)


GATES = st.sampled_from([12.0, math.inf])


@SETTINGS
@given(seed=SEEDS, q=quaternions(), y=vectors(3, 0.6), h=vectors(15, 2.0), index=st.integers(0, 14), gate=GATES)
def test_corrections(
    core: Core, seed: int, q: list[float], y: list[float], h: list[float], index: int, gate: float
) -> None:
    variance, delay = 0.01, 0.03
    steps: list[tuple[str, tuple[Any, ...], Any]] = [
        ("filter_correct_component", (index, y[0]), lambda f: f.correct_scalar(index, y[0], variance, gate)),
        ("filter_correct_scalar", (h, y[0]), lambda f: f.correct_scalar(np.array(h), y[0], variance, gate)),
        ("filter_correct_position", (y, delay), lambda f: f.correct_position((*y,), delay, variance, gate)),
        ("filter_correct_attitude", (y,), lambda f: f.correct_attitude((*y,), variance, gate)),
        ("filter_correct_past_attitude", (y, delay), lambda f: f.correct_past_attitude((*y,), delay, variance, gate)),
    ]
    for name, given_values, theirs in steps:
        both = Both(core, seed, q)
        arguments = [array(core, one) if isinstance(one, list) else one for one in given_values]
        score = getattr(core, name)(both.ours, *arguments, variance, gate)
        same(score, theirs(both.theirs), scale=1.0)
        both.compare(1e-11)
        both.predict()
        both.compare(1e-11)


@SETTINGS
@given(seed=SEEDS, q=quaternions(), d=vectors(9, 0.3), start=st.sampled_from([0, 3, 6, 9, 12]), size=st.integers(1, 3))
def test_other_changes(core: Core, seed: int, q: list[float], d: list[float], start: int, size: int) -> None:
    both = Both(core, seed, q)
    f, ours = both.theirs, both.ours
    f.shift((*d[:3],), (*d[3:6],), (*d[6:],))
    core.filter_shift(ours, array(core, d[:3]), array(core, d[3:6]), array(core, d[6:]))
    f.inflate(start, 0.3, size)
    core.filter_inflate(ours, start, 0.3, size)
    f.inflate_motion(0.4, 0.02)
    core.filter_inflate_motion(ours, 0.4, 0.02)
    both.compare()
    f.restart_error(start, 0.2)
    core.filter_restart_error(ours, start, 0.2)
    both.compare()
    f.forget_history()
    core.filter_forget_history(ours)
    both.compare()


def test_a_history_that_is_full(core: Core) -> None:
    both = Both(core, 1, [1.0, 0.0, 0.0, 0.0])
    for _ in range(300):
        both.predict()
    both.compare(1e-10)
    past = core.PastState()
    for back in (127, 128, 140):
        time_ns = both.now_ns - back * 5_000_000
        assert core.filter_at(both.ours, time_ns, past) == (both.theirs.at(time_ns) is not None)


@pytest.mark.parametrize("precision", ["core", "core32"])
def test_the_covariance_stays_symmetric(request: pytest.FixtureRequest, precision: str) -> None:
    """What is not symmetric would grow from rounding and, in float, take over within half a minute of flight."""
    both = Both(request.getfixturevalue(precision), 1, [1.0, 0.0, 0.0, 0.0])
    ours, still, h = both.ours, array(both.core, np.zeros(3)), array(both.core, np.linspace(-1.0, 1.0, 15))
    for _ in range(200):
        both.predict()
        P = view(ours.P).reshape(15, 15)
        assert (P == P.T).all()
        both.core.filter_correct_position(ours, still, 0.015, 5e-4**2, math.inf)
        both.core.filter_correct_attitude(ours, still, 0.005**2, math.inf)
        both.core.filter_correct_scalar(ours, h, 0.0, 0.01, math.inf)
    assert np.linalg.eigvalsh(P.astype(float)).min() > 0.0


@SETTINGS
@given(seed=SEEDS, shaken=st.integers(0, 30))
def test_conditioning(core: Core, seed: int, shaken: int) -> None:
    rng = np.random.default_rng(seed)
    start, meter = StillStart(20, 0.3), VibrationMeter()
    c_start, c_meter = core.StillStart(), core.VibrationMeter()
    core.still_start_init(c_start, 20, 0.3)
    core.vibration_init(c_meter)
    for k in range(40):
        force = [0.3, -0.2, -9.7] + 0.2 * rng.normal(size=3)
        rate = 0.05 * rng.normal(size=3) + (1.0 if k == shaken else 0.0)
        reading = core.ImuReading()
        view(reading.accelerometer)[:], view(reading.gyroscope)[:] = force, rate
        expected = start.add(ImuReading(k, (*force.tolist(),), (*rate.tolist(),)))
        assert core.still_start_add(c_start, reading) == expected
        same(core.vibration_update(c_meter, force, DT), meter.update((*force.tolist(),), DT), scale=1.0)
    if start._count:
        same(call(core, "still_start_level", c_start, out=2), start.level(), scale=1.0)
        same(call(core, "still_start_mean_rate", c_start, out=3), start.mean_rate(), scale=1.0)


# --- the stuck gyroscope ---


@SETTINGS
@given(
    seed=SEEDS,
    axes=st.lists(st.sampled_from([0, 1, 2]), max_size=3, unique=True),
    begins=st.integers(40, 110),
    sigma=st.sampled_from([0.1, 0.003]),
    needed=st.sampled_from([0, 3, 6, 12]),
    frozen=st.booleans(),
)
def test_stuck_gyro(
    core: Core, seed: int, axes: list[int], begins: int, sigma: float, needed: int, frozen: bool
) -> None:
    rng = np.random.default_rng(seed)
    ours, theirs = core.StuckGyro(), StuckGyro(needed, 0.1)
    core.stuck_gyro_init(ours, needed, 0.1)
    rates = np.round(sigma * rng.standard_normal((160, 3)) / 1e-3) * 1e-3
    rates[begins:, axes] = rates[begins - 1, axes]
    forces = rng.standard_normal((160, 3))
    if frozen:
        rates[70:90], forces[70:90] = rates[70], forces[70]
    for k, (rate, force) in enumerate(zip(rates, forces, strict=True)):
        u_hat, residual, bias = rng.standard_normal((3, 3))
        theirs.expect((*u_hat.tolist(),), (*residual.tolist(),), DT)
        core.stuck_gyro_expect(ours, u_hat, residual, DT)
        found, flying = core.FoundAxes(), k != 100
        core.stuck_gyro_receive(ours, rate, force, DT, flying, found)
        expected = theirs.receive((*rate.tolist(),), (*force.tolist(),), DT, flying)
        assert list(found.axis)[: found.count] == [one.axis for one in expected]
        same(list(found.turn_rad)[: found.count], [one.turn_rad for one in expected], scale=1.0)
        assert core.stuck_gyro_any(ours) == bool(theirs.axes)
        same(call(core, "stuck_gyro_replaced", ours, rate, out=3), theirs.replaced((*rate.tolist(),)), scale=1.0)
        theirs.note_bias((*bias.tolist(),), k, DT)
        core.stuck_gyro_note_bias(ours, bias, k, DT)
    for since in (-1, 100, 150, 158):
        expected_turn = theirs.turn_since(since, (0.1, 0.2, 0.3))
        same(call(core, "stuck_gyro_turn_since", ours, since, [0.1, 0.2, 0.3], out=3), expected_turn, scale=1.0)
    theirs.reset()
    core.stuck_gyro_reset(ours)
    assert not core.stuck_gyro_any(ours)
    assert list(call(core, "stuck_gyro_turn_since", ours, 0, [0.1, 0.2, 0.3], out=3)) == [0.0, 0.0, 0.0]


# --- calibration ---

PHASES = st.lists(
    st.tuples(
        st.integers(1, 350),
        st.sampled_from(["rest", "moved", "turned", "biased", "sparse", "interrupt"]),
    ),
    min_size=1,
    max_size=6,
)


@SETTINGS
@given(seed=SEEDS, phases=PHASES, calibration_s=st.sampled_from([0.0, 0.7, 2.0]))
def test_calibration(core: Core, seed: int, phases: list[tuple[int, str]], calibration_s: float) -> None:
    rng, config = np.random.default_rng(seed), EstimatorConfig(calibration_s=calibration_s)
    ours, theirs, events = core.BenchCalibration(), BenchCalibration(config), core.EstimatorEvents()
    core.calibration_init(ours, configured(core, config))
    now_ns = 0
    for count, what in phases:
        if what == "interrupt":
            theirs.interrupt()
            core.calibration_interrupt(ours)
        for _ in range(count):
            now_ns += 50_000_000 if what == "sparse" else 5_000_000
            force = [0.1, -0.1, -9.6 + 0.5 * (what == "moved")] + 0.2 * rng.normal(size=3)
            rate = [0.02, 0.04 * (what == "turned"), 0.3 * (what == "biased")] + 0.02 * rng.normal(size=3)
            reading = core.ImuReading(time_ns=now_ns)
            view(reading.accelerometer)[:], view(reading.gyroscope)[:] = force, rate
            text = theirs.add(ImuReading(now_ns, (*force.tolist(),), (*rate.tolist(),)))
            core.calibration_add(ours, reading, events)
            assert [estimator_text(one) for one in events.events[: events.count]] == ([text] if text else [])
            assert calibration_text(ours) == theirs.refusal
            events.count = 0
    assert (ours.count, ours.movements) == (theirs.count, theirs.movements)
    if theirs.accepted is not None:
        same(ours.accepted.rate, theirs.accepted.rate, scale=1.0)
        same(ours.accepted.force, theirs.accepted.force, scale=1.0)
        assert (ours.accepted.samples, ours.accepted.seconds) == (theirs.accepted.samples, theirs.accepted.seconds)


def test_events_beyond_the_limit_are_lost(core: Core) -> None:
    events = core.EstimatorEvents()
    for k in range(100):
        core.estimator_report(events, k, core.ESTIMATOR_GAP, 0)
    assert events.count == 64
    assert [events.events[0].time_ns, events.events[63].time_ns] == [0, 63]


@SETTINGS
@given(q=quaternions(), bias=vectors(6, 0.1), x=vectors(6, 2.0), force=numbers(10.0))
def test_published_state(core: Core, q: list[float], bias: list[float], x: list[float], force: float) -> None:
    both = Both(core, 3, q)
    theirs, ours = VehicleState(), core.VehicleState()
    core.state_init(ours)
    assert ours.last_pose_ns == theirs.last_pose_ns
    assert list(ours.rotation) == theirs.rotation.reshape(-1).tolist()
    reading = core.ImuReading(time_ns=7)
    view(reading.accelerometer)[:], view(reading.gyroscope)[:] = (force, 1.0, -9.0), x[:3]
    theirs.publish(both.theirs, ImuReading(7, (force, 1.0, -9.0), (x[0], x[1], x[2])))
    core.state_publish(ours, both.ours, reading)
    theirs.publish_sigmas(both.theirs)
    core.state_publish_sigmas(ours, both.ours)
    for name in ("position", "velocity", "quaternion", "rotation", "euler", "rates", "specific_force", "gyro_bias"):
        same(getattr(ours, name), getattr(theirs, name), scale=1.0)
    for name in ("tilt_rad", "position_sigma_m", "velocity_sigma_m_s"):
        assert getattr(ours, name) == pytest.approx(getattr(theirs, name), rel=1e-10)
