"""The estimator and its inertial sensors: start, gaps, wrong order, vibration, delay."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.estimation.config import EstimatorConfig
from onboard.estimation.estimator import Estimator
from protocol.mavlink.vehicle import ImuReading
from tests.onboard.estimation.estimator_flights import RATE, STEP_NS, Flight, Truth


def still_imu(estimator, seconds, start_ns=0, roll=0.0, pitch=0.0, gyro=(0.05, -0.02, 0.01), rng=None):
    """Send samples of a vehicle at rest; returns the time of the last one."""
    rng = rng or np.random.default_rng(1)
    force = Rotation.from_euler("ZYX", (0.3, pitch, roll)).inv().apply((0.0, 0.0, -9.80665))
    for k in range(int(seconds * RATE)):
        acc = force + 0.2 * rng.standard_normal(3)
        rate = np.array(gyro) + 0.01 * rng.standard_normal(3)
        estimator.receive(ImuReading(start_ns + (k + 1) * STEP_NS, tuple(acc), tuple(rate), 101325.0))
    return start_ns + int(seconds * RATE) * STEP_NS


def test_the_start_finds_attitude_and_gyro_bias():
    estimator = Estimator(EstimatorConfig())
    still_imu(estimator, 0.2, roll=0.2, pitch=-0.15)
    assert not estimator.state.initialised
    still_imu(estimator, 2.0, 10**9, roll=0.2, pitch=-0.15)
    assert estimator.state.initialised
    np.testing.assert_allclose(estimator.state.euler[:2], (0.2, -0.15), atol=0.02)
    np.testing.assert_allclose(estimator.state.gyro_bias, (0.05, -0.02, 0.01), atol=0.004)
    np.testing.assert_allclose(estimator.state.rates, 0.0, atol=0.05)
    assert "attitude found" in estimator.take_events()[0][1]
    np.testing.assert_allclose(estimator.state.velocity, 0.0, atol=0.05)


def test_the_start_waits_for_a_still_vehicle():
    estimator = Estimator(EstimatorConfig())
    still_imu(estimator, 2.0, gyro=(0.5, 0.0, 0.0))
    assert not estimator.state.initialised


def test_carrying_the_vehicle_does_not_change_the_gyro_bias():
    estimator = Estimator(EstimatorConfig())
    now_ns = still_imu(estimator, 2.0)
    for k in range(RATE):  # lifted at one end, at 1 rad/s
        angle = (k + 1) / RATE
        force = (0.0, -9.80665 * math.sin(angle), -9.80665 * math.cos(angle))
        estimator.receive(ImuReading(now_ns + (k + 1) * STEP_NS, force, (1.05, -0.02, 0.01), 101325.0))
    np.testing.assert_allclose(estimator.state.gyro_bias, (0.05, -0.02, 0.01), atol=0.01)
    assert estimator.state.euler[0] == pytest.approx(1.0, abs=0.1)


def test_out_of_order_samples_change_nothing():
    estimator = Estimator(EstimatorConfig())
    now_ns = still_imu(estimator, 1.0)
    before = estimator.state.position.copy(), estimator.covariance.copy()
    for time_ns in (now_ns, now_ns - STEP_NS):
        estimator.receive(ImuReading(time_ns, (50.0, 0.0, 0.0), (9.0, 9.0, 9.0)))
    assert estimator.counts["imu_out_of_order"] == 2
    np.testing.assert_array_equal(estimator.state.position, before[0])
    np.testing.assert_array_equal(estimator.covariance, before[1])


def test_after_an_imu_gap_the_pose_corrects_and_the_gap_is_reported():
    def gap(t, imu):
        return None if 6.0 < t < 6.3 else imu

    flight = Flight(truth=Truth(9.0, speed=1.5)).run(imu_fault=gap)
    assert flight.estimator.counts["imu_gap"] >= 1
    assert flight.position_rmse(7.5) < 0.02
    assert any("IMU gap of 3" in text for _, text in flight.events)


@pytest.mark.parametrize("sigma", [0.25, 2.0])
def test_vibration_measures_white_noise(sigma):
    """Mean length of three high-passed Gaussians: 1.596 sigma times the high-pass's gain of 0.84."""
    estimator = Estimator(EstimatorConfig())
    now_ns = still_imu(estimator, 0.5)
    rng, levels = np.random.default_rng(2), []
    for k in range(800):
        force = np.array([0.0, 0.0, -9.8]) + sigma * rng.standard_normal(3)
        estimator.receive(ImuReading(now_ns + (k + 1) * STEP_NS, tuple(force), (0.0, 0.0, 0.0)))
        levels.append(estimator.state.vibration)
    assert np.mean(levels[200:]) == pytest.approx(1.596 * 0.843 * sigma, rel=0.05)


def test_vibration_ignores_manoeuvres_and_detects_a_chipped_rotor():
    def level(force):
        estimator = Estimator(EstimatorConfig())
        now_ns = still_imu(estimator, 0.5)
        for k in range(200):
            t = (k + 1) / RATE
            estimator.receive(ImuReading(now_ns + (k + 1) * STEP_NS, (force(t), 0.0, -9.8), (0.0, 0.0, 0.0)))
        return estimator.state.vibration

    assert level(lambda t: 2.0 * math.sin(2 * math.pi * 1.0 * t)) < 0.35
    assert level(lambda t: 5.0 * math.sin(2 * math.pi * 88.0 * t)) == pytest.approx(5.0 * 2 / math.pi * 0.9, rel=0.15)
    rise = []
    estimator = Estimator(EstimatorConfig())
    now_ns = still_imu(estimator, 0.5)
    for k in range(100):
        force = 5.0 * (-1.0) ** k
        estimator.receive(ImuReading(now_ns + (k + 1) * STEP_NS, (force, 0.0, -9.8), (0.0, 0.0, 0.0)))
        rise.append(estimator.state.vibration)
    settled = rise[-1]
    assert 0.1 < next(k for k, level in enumerate(rise) if level > 0.63 * settled) / RATE < 0.2


def test_the_delay_of_the_gyro_counts_in_fast_turns():
    """A roll oscillation of 8 rad/s: with the delay the attitude is right; without, it lags by a sample."""

    def error(delay_s):
        estimator = Estimator(EstimatorConfig(gyro_delay_s=delay_s))
        now_ns = still_imu(estimator, 0.5, gyro=(0.0, 0.0, 0.0), rng=np.random.default_rng(3))
        estimator.set_on_ground(False)
        start, errors = estimator.state.euler[0], []
        for k in range(100):
            t, before = (k + 1) / RATE, max(k / RATE, 0.0)
            angle = 0.4 * (1 - math.cos(20.0 * t))
            force = (0.0, -9.8 * math.sin(angle), -9.8 * math.cos(angle))
            estimator.receive(ImuReading(now_ns + (k + 1) * STEP_NS, force, (8.0 * math.sin(20.0 * before), 0.0, 0.0)))
            errors.append(abs(estimator.state.euler[0] - start - angle))
        return max(errors)

    assert error(0.005) < 0.012
    assert error(0.0) > 0.03
