"""The calibration of the IMU at rest: what it finds and refuses, what is kept, what the estimator makes of it."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.estimation.calibration import CALIBRATING, MOVED, BenchCalibration
from onboard.estimation.config import GYRO_BIAS_MAX_RAD_S, EstimatorConfig
from onboard.estimation.estimator import Estimator
from onboard.preflight.checks import PreflightConfig
from protocol.conventions import GRAVITY
from protocol.mavlink.vehicle import ImuReading
from protocol.messages import Pose
from tests.onboard.estimation.estimator_flights import RATE, STEP_NS

FORCE_BIAS = np.array([0.09, -0.06, 0.34])
RATE_BIAS = np.array([0.07, -0.03, 0.09])


class Bench:
    """Sends samples of a vehicle that rests, with the largest noise measured on a real bench."""

    def __init__(self, rate_bias=RATE_BIAS, noise=(0.27, 0.03), seed=1, **settings):
        self.calibration = BenchCalibration(EstimatorConfig(**settings))
        self.rng, self.noise = np.random.default_rng(seed), noise
        self.rate_bias = np.array(rate_bias)
        self.k, self.events = 0, []

    def rest(self, seconds, force=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0)):
        """Samples with an additional force and rate."""
        for _ in range(round(seconds * RATE)):
            mean = np.array([0.0, 0.0, -GRAVITY]) + FORCE_BIAS + force, self.rate_bias + rate
            a, g = (m + s * self.rng.standard_normal(3) for m, s in zip(mean, self.noise, strict=True))
            event = self.calibration.add(ImuReading(self.k * STEP_NS, tuple(a), tuple(g)))
            self.events += [event] if event else []
            self.k += 1
        return self

    @property
    def refusal(self):
        return self.calibration.refusal


@pytest.mark.parametrize("seed", range(20))
def test_two_seconds_at_rest_give_the_biases(seed):
    bench = Bench(seed=seed).rest(1.9)
    assert bench.refusal == CALIBRATING
    bench.rest(0.15)
    assert (bench.refusal, bench.calibration.count, bench.calibration.movements) == ("", 1, 0)
    found = bench.calibration.accepted
    assert found.seconds == pytest.approx(2.0, abs=0.05)
    np.testing.assert_allclose(found.rate, RATE_BIAS, atol=4 * 0.03 / 20)
    assert found.along_gravity_m_s2 == pytest.approx(-FORCE_BIAS[2], abs=4 * 0.27 / 20)  # z is upside down at rest
    assert bench.events == [f"IMU calibrated: {found}"]
    assert str(found).startswith(f"gyroscope bias ({found.rate[0]:+.4f}, ")
    assert bench.calibration.summary()["gyro_bias_rad_s"] == list(found.rate)


@pytest.mark.parametrize(
    ("motion", "named"),
    [
        ({"rate": (0.0, 0.05, 0.0)}, "gyroscope y off by +0.0"),
        ({"force": (0.5, 0.0, 0.0)}, "accelerometer x off by +0."),
        ({"force": (0.0, 0.0, -0.6)}, "accelerometer z off by -0."),
    ],
)
def test_a_vehicle_that_moved_is_refused_until_it_has_rested(motion, named):
    bench = Bench().rest(1.0).rest(0.6, **motion)
    assert bench.refusal == MOVED
    assert bench.events[0].startswith(f"{MOVED}: {named}")
    bench.rest(1.5, **motion).rest(1.0)
    assert bench.refusal == MOVED
    assert len(bench.events) == 1  # said once
    bench.rest(2.1)
    assert bench.refusal == ""
    np.testing.assert_allclose(bench.calibration.accepted.rate, RATE_BIAS, atol=0.006)


def test_a_vehicle_that_is_shaken_all_the_time_is_never_accepted():
    bench = Bench()
    for k in range(20):
        bench.rest(0.5, rate=(0.1 * (-1) ** k, 0.0, 0.0))
    assert bench.refusal == MOVED
    assert bench.calibration.accepted is None
    assert bench.calibration.summary() == {"accepted": 0, "movements": 1}


def test_the_calibration_is_kept_for_the_next_flight():
    bench = Bench().rest(2.1)
    kept = bench.calibration.accepted
    bench.calibration.interrupt()  # a flight
    bench.rest(3.0, force=(0.5, 0.3, 0.0))  # landed where the floor slopes
    assert (bench.refusal, bench.calibration.count) == ("", 1)
    assert bench.calibration.accepted is kept


def test_a_vehicle_that_was_carried_is_calibrated_again():
    bench = Bench().rest(2.1)
    bench.rest(1.0, rate=(0.0, 0.0, 0.4))
    assert bench.refusal == MOVED
    bench.rest(3.0)
    assert (bench.refusal, bench.calibration.count, bench.calibration.movements) == ("", 2, 1)


def test_a_flight_interrupts_a_calibration():
    bench = Bench().rest(1.8)
    bench.calibration.interrupt()
    bench.rest(1.8)
    assert bench.refusal == CALIBRATING
    assert bench.rest(0.3).refusal == ""


def test_a_large_bias_is_refused_with_the_figure():
    bench = Bench(rate_bias=(0.02, -0.21, 0.0)).rest(4.5)
    assert bench.refusal == "gyroscope y has a bias of -0.21 rad/s, the limit is 0.15"
    assert bench.events == [bench.refusal]
    assert PreflightConfig().gyro_bias_max_rad_s == EstimatorConfig().calibration_bias_max_rad_s == GYRO_BIAS_MAX_RAD_S
    assert Bench(rate_bias=(0.02, -0.21, 0.0), calibration_bias_max_rad_s=0.3).rest(2.1).refusal == ""


def test_without_a_calibration_nothing_is_waited_for():
    bench = Bench(calibration_s=0.0)
    assert bench.refusal == ""
    assert bench.rest(3.0).calibration.count == 0


def test_a_stream_with_too_few_samples_is_no_calibration():
    bench = Bench()
    for k in range(10):
        bench.k = k * RATE // 5
        bench.rest(0.005)
    assert bench.refusal == CALIBRATING


# -- in the estimator -------------------------------------------------------------------------------------------------


def standing(seconds, with_pose, tilt, seed=1, pose_from_s=0.3, **settings):
    """An estimator on the bench, and the true attitude; poses at 100 Hz."""
    estimator, rng = Estimator(EstimatorConfig(**settings)), np.random.default_rng(seed)
    attitude = Rotation.from_euler("ZYX", (0.0, -tilt, tilt))
    force = attitude.inv().apply((0.0, 0.0, -GRAVITY)) + FORCE_BIAS
    for k in range(round(seconds * RATE)):
        now_ns = (k + 1) * STEP_NS
        a = force + 0.24 * rng.standard_normal(3)
        estimator.receive(ImuReading(now_ns, tuple(a), tuple(RATE_BIAS + 0.015 * rng.standard_normal(3)), 101325.0))
        if with_pose and k % 2 == 0 and k > pose_from_s * RATE:
            seen = (Rotation.from_rotvec(0.005 * rng.standard_normal(3)) * attitude).as_quat()[[3, 0, 1, 2]]
            place = 0.0005 * rng.standard_normal(3)
            pose = Pose(now_ns, place.astype(np.float32), seen.astype(np.float32))
            estimator.receive_pose(pose, now_ns, now_ns)
    return estimator, attitude


def tilt_error(estimator, attitude):
    """Angle between the true and the estimated vertical, rad."""
    cosine = float(estimator.state.rotation[2] @ attitude.as_matrix()[2])
    return math.acos(min(1.0, cosine))


@pytest.mark.parametrize("tilt", [0.0, 0.1])
def test_with_a_pose_the_horizontal_bias_is_known_before_arming_also_on_an_incline(tilt):
    for seed in range(3):
        estimator, attitude = standing(2.2, True, tilt, seed)
        assert estimator.calibration.refusal == ""
        np.testing.assert_allclose(estimator.state.accelerometer_bias, FORCE_BIAS, atol=0.05)
        np.testing.assert_allclose(estimator.state.gyro_bias, RATE_BIAS, atol=0.003)
        assert tilt_error(estimator, attitude) < 0.004
        assert np.sqrt(estimator.covariance.diagonal()[12:14]).max() < 0.03


def test_a_pose_that_comes_after_the_calibration_finds_the_horizontal_bias_within_half_a_second():
    for seed in range(3):
        estimator, attitude = standing(4.6, True, 0.1, seed, 4.0)
        np.testing.assert_allclose(estimator.state.accelerometer_bias[:2], FORCE_BIAS[:2], atol=0.06)
        assert tilt_error(estimator, attitude) < 0.006


@pytest.mark.parametrize("tilt", [0.0, 0.1])
def test_without_a_pose_the_accelerometer_gives_the_tilt_and_its_horizontal_bias_stays_unknown(tilt):
    for seed in range(3):
        estimator, attitude = standing(2.2, False, tilt, seed)
        assert estimator.calibration.refusal == ""
        bias = estimator.state.accelerometer_bias
        assert np.hypot(*bias[:2]) < (0.08 if tilt else 0.04)  # on an incline, the part along gravity
        assert bias[2] == pytest.approx(FORCE_BIAS[2], abs=0.05)
        wrong = math.hypot(*FORCE_BIAS[:2]) / GRAVITY
        assert tilt_error(estimator, attitude) == pytest.approx(wrong, abs=0.005)
        deviation = math.sqrt(estimator.covariance[6, 6])
        assert wrong < 2.0 * deviation < 0.1  # and the filter knows it
        np.testing.assert_allclose(estimator.state.gyro_bias, RATE_BIAS, atol=0.003)


def test_the_calibration_halves_the_error_of_the_gyro_bias():
    errors = {}
    for seconds in (0.0, 2.0):
        found = [standing(2.1, True, 0.0, seed, calibration_s=seconds)[0].state.gyro_bias for seed in range(8)]
        errors[seconds] = np.sqrt(np.mean((np.array(found) - RATE_BIAS) ** 2))
    assert errors[2.0] < 0.7 * errors[0.0], errors


def test_the_filter_states_the_error_of_the_calibrated_accelerometer():
    """Its mean square error over seeds against the variance; the samples must not count twice."""
    ratios = []
    for seed in range(10):
        estimator, _ = standing(2.1, True, 0.0, seed)
        error = estimator.state.accelerometer_bias - FORCE_BIAS
        ratios += (error**2 / estimator.covariance.diagonal()[12:15]).tolist()
    assert np.mean(ratios) < 2.0
