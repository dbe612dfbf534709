"""The estimator compared with an independent truth: consistency, with and without pose."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from onboard.estimation.config import EstimatorConfig
from protocol.mavlink.vehicle import ImuReading
from protocol.messages import Pose
from tests.onboard.estimation.estimator_flights import RATE, STEP_NS, Flight, Noise, Truth

MATCHED = EstimatorConfig(
    accelerometer_sigma=0.3,
    vibration_to_sigma=0.0,
    gyro_sigma=0.02,
    pose_position_sigma_m=0.006,
    pose_attitude_sigma_rad=0.012,
    pose_time_sigma_s=0.0,
    flow_rate_sigma_rad_s=0.06,
    flow_scale_sigma=0.02,
    range_sigma_m=0.03,
)
"""The true noise of Noise's sensors."""
BLOCKS = {
    "position": slice(0, 3),
    "velocity": slice(3, 6),
    "attitude": slice(6, 9),
    "gyro_bias": slice(9, 12),
    "accelerometer_bias": slice(12, 15),
    "all": slice(0, 15),
}
SEEDS = [pytest.param(range(3), id="3 seeds"), pytest.param(range(50), id="50 seeds", marks=pytest.mark.full)]


# -- consistency ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("pose", [True, False], ids=["pose", "no pose"])
def test_errors_agree_with_the_covariance(seeds, pose):
    """Mean NEES of each block against its dimension, for sensors with the noise that the filter assumes.

    The biases are constant here while the filter lets them walk, and the start is exact, so values below the
    dimension are right; values above it would be dangerous.
    """
    windows = ((0.0, 1e9),) if pose else ()
    nees = {name: [] for name in BLOCKS}
    for seed in seeds:
        truth = Truth(14.0, speed=1.5)
        flight = Flight(truth=truth, config=MATCHED, seed=seed, pose_windows=windows).run()
        for name, block in BLOCKS.items():
            nees[name].append(flight.nees(block, 4.0).mean())
    for name, block in BLOCKS.items():
        dimension = block.stop - block.start
        mean = np.mean(nees[name])
        # One flight holds about ten independent errors a block; three standard deviations of their mean.
        slack = 3.0 * math.sqrt(2.0 / dimension / (10 * len(seeds)))
        assert mean < dimension * (1.15 + slack), name
        assert mean > 0.2 * dimension, name


@pytest.mark.parametrize("seeds", SEEDS)
def test_innovations_agree_with_the_filter(seeds):
    """Mean NIS against the dimension, and the share above the 95 % quantile; for range, with outliers, the median."""
    scores = {"pose_position": [], "pose_attitude": [], "flow": []}
    ranges = []
    for seed in seeds:
        flight = Flight(truth=Truth(10.0, speed=1.5), config=MATCHED, seed=seed).run()
        for aid, values in scores.items():
            values += flight.scores[aid]
        ranges += flight.scores["range"]
    for aid, values in scores.items():
        dimension = 1 if aid == "flow" else 3
        assert 0.6 * dimension < np.mean(values) < 1.3 * dimension, aid
        assert np.mean(np.array(values) > chi2.ppf(0.95, dimension)) < 0.1, aid
    assert 0.2 < np.median(ranges) < 0.9  # 0.45 for one degree of freedom


# -- with pose --------------------------------------------------------------------------------------------------------


def test_accuracy_with_pose():
    flight = Flight(truth=Truth(speed=1.5)).run()
    assert flight.position_rmse(4.0) < 0.01
    assert np.nanmax(np.abs(flight.errors[800:, 3:6])) < 0.1
    assert np.nanmax(np.abs(flight.errors[800:, 6:9])) < 0.02
    assert np.abs(flight.errors[-1, 9:12]).max() < 0.01
    assert np.abs(flight.errors[-1, 12:15]).max() < 0.1


@pytest.mark.parametrize("delay_s", [0.01, 0.1, 0.3])
def test_the_delay_of_a_pose_does_not_matter(delay_s):
    noise = Noise(pose_delay_s=delay_s, pose_rate=100)
    assert Flight(noise=noise, truth=Truth(12.0, speed=1.5)).run().position_rmse(4.0) < 0.012


def test_an_unknown_delay_matters():
    """Ablation: poses of 100 ms age without their time stamps put the estimate 100 ms behind."""
    noise = Noise(pose_delay_s=0.1, pose_rate=100)
    flight = Flight(noise=noise, truth=Truth(12.0, speed=1.5)).run(stamp_fault=lambda pose, now_ns: now_ns)
    assert flight.position_rmse(4.0) > 0.05


def test_a_clock_error_within_its_sigma_does_not_disturb_the_estimate():
    """A clock error of 50 ms on a slow link. Without its sigma the estimate is much worse."""

    def errors(time_sigma_s):
        noise = Noise(pose_m=0.0007, pose_delay_s=0.2, pose_rate=100)
        flight = Flight(noise=noise, truth=Truth(12.0, speed=2.0)).run(
            stamp_fault=lambda pose, now_ns: pose.time_ns + 50_000_000, time_sigma_s=time_sigma_s
        )
        return np.nanmax(np.abs(flight.errors[800:, 3:6])), np.nanmax(np.abs(flight.errors[800:, 6:9]))

    velocity, attitude = errors(0.02)
    assert velocity < 0.35
    assert attitude < 0.03
    worse_velocity, worse_attitude = errors(0.0)
    assert worse_velocity > 1.5 * velocity
    assert worse_attitude > 1.5 * attitude


def test_the_first_poses_make_one_announced_jump():
    flight = Flight(truth=Truth(8.0, start=(2.0, -1.0), yaw_start=1.0)).run()
    ((when, jump, yaw),) = flight.jumps
    assert when < 0.6
    np.testing.assert_allclose(jump, (2.0, -1.0, 0.0), atol=0.05)
    assert yaw == pytest.approx(1.0, abs=0.05)
    assert flight.position_rmse(1.0) < 0.02
    assert any("jumped 2.2" in text for _, text in flight.events)


def test_a_first_pose_in_flight_makes_one_announced_jump_and_keeps_the_velocity():
    """Flown on flow alone in its own frame; then poses in the room's frame, shifted and turned."""
    truth = Truth(14.0, start=(2.0, -1.0), yaw_start=0.8)
    flight = Flight(truth=truth, pose_windows=((8.0, 99.0),)).run()
    ((when, jump, yaw),) = flight.jumps
    assert 8.0 < when < 8.4
    assert yaw == pytest.approx(0.8, abs=0.15)
    assert np.linalg.norm(jump[:2]) > 1.0
    assert flight.position_rmse(8.5) < 0.02
    assert np.abs(flight.errors[int(8.2 * RATE) :, 3:6]).max() < 0.15


def test_outliers_among_poses_are_refused():
    rng = np.random.default_rng(8)

    def fault(t, position, quaternion):
        return (
            (position + rng.uniform(-2, 2, 3), quaternion)
            if t > 2.0 and rng.random() < 0.15
            else (position, quaternion)
        )

    flight = Flight(truth=Truth(12.0)).run(pose_fault=fault)
    assert flight.position_rmse(4.0) < 0.012
    assert flight.estimator.counts["pose_refused"] > 40
    assert len(flight.jumps) == 1


def test_a_pose_with_a_swapped_attitude_is_refused():
    """Swapped markers: right position, upside down."""

    def fault(t, position, quaternion):
        return position, np.array([0.0, 1.0, 0.0, 0.0]) if 5.0 < t < 5.05 else quaternion

    flight = Flight(truth=Truth(8.0)).run(pose_fault=fault)
    assert flight.estimator.counts["pose_implausible"] >= 2
    assert np.nanmax(np.abs(flight.errors[800:, 6:9])) < 0.02


def chipped_rotor(t, imu):
    """From 5 s on a rotor's imbalance, 25 m/s^2, aliased to a frequency that varies from 40 Hz to 0."""
    if t < 5.0:
        return imu
    phase = 2.0 * math.pi * 20.0 * (t - 5.0) + 20.0 / 0.7 * (1.0 - math.cos(2.0 * math.pi * 0.7 * (t - 5.0)))
    x, y, z = imu.accelerometer
    shaken = (x + 25.0 * math.cos(phase), y + 25.0 * math.sin(phase), z)
    return ImuReading(imu.time_ns, shaken, imu.gyroscope, imu.pressure_pa)


def test_the_velocity_does_not_drift_with_a_chipped_rotor():
    """The poses determine the velocity; with the accelerometer alone the estimate would drift away."""

    def flight(config):
        noise = Noise(pose_m=0.0007, pose_delay_s=0.015, pose_rate=100)
        flown = Flight(truth=Truth(10.0), noise=noise, config=config).run(imu_fault=chipped_rotor)
        off = flown.errors[5 * RATE :]
        return np.linalg.norm(off[:, 0:3], axis=1).max(), np.linalg.norm(off[:, 3:6], axis=1).max()

    position_m, velocity_m_s = flight(EstimatorConfig())
    assert position_m < 0.08
    assert velocity_m_s < 2.5
    position_m, velocity_m_s = flight(EstimatorConfig(vibration_white_max_m_s2=1e6))
    assert position_m > 0.5
    assert velocity_m_s > 5.0


def test_an_attitude_error_explained_by_the_capture_time_is_ignored():
    """In a fast turn a pose with a wrong time looks turned and must not turn the estimate; a turned pose must."""
    truth = Truth(9.0)
    flight = Flight(truth=truth).run()
    state, estimator = flight.estimator.state, flight.estimator
    now_ns = state.last_imu_ns

    def poses(rates, angle):
        before = state.quaternion.copy()
        for k in range(6):
            time_ns = now_ns + (k + 1) * STEP_NS
            force = tuple((state.rotation.T @ (0.0, 0.0, -9.81)).tolist())
            shaking = tuple(rate + 0.002 * (k % 2) for rate in rates)  # a rate that repeats is a stuck axis
            estimator.receive(ImuReading(time_ns, force, shaking, 101325.0))
            turned = Rotation.from_matrix(state.rotation) * Rotation.from_rotvec((angle, 0.0, 0.0))
            pose = Pose(time_ns, state.position.astype(np.float32), turned.as_quat()[[3, 0, 1, 2]].astype(np.float32))
            estimator.receive_pose(pose, time_ns, time_ns)
        return 2.0 * math.acos(min(1.0, abs(float(before @ state.quaternion))))

    turned_rad = poses((6.0, 0.0, 0.0), 0.6)
    assert estimator.counts["pose_attitude_refused"] == 6
    assert turned_rad == pytest.approx(6.0 * 6 / RATE, abs=0.05)  # by the gyroscope alone
    now_ns = state.last_imu_ns
    assert poses((0.0, 0.0, 0.0), 0.6) > 0.5


def test_poses_at_wrong_times_are_refused():
    flight = Flight(truth=Truth(3.0)).run()
    estimator, now_ns = flight.estimator, int(flight.truth.time_ns[-1])
    estimator.counts.clear()
    pose = Pose(1, np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32))
    for capture_ns in (now_ns - 10**9, now_ns + 10**9, -(10**15), 10**18):
        estimator.receive_pose(pose, capture_ns, now_ns)
    assert estimator.counts["pose_wrong_time"] + estimator.counts["pose_out_of_order"] == 4
    estimator.receive_pose(pose, now_ns - 10_000_000, now_ns)
    estimator.receive_pose(pose, now_ns - 10_000_000, now_ns)
    estimator.receive_pose(pose, now_ns - 20_000_000, now_ns)
    assert estimator.counts["pose_out_of_order"] >= 2


# -- without pose -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seeds", SEEDS)
def test_drift_in_an_outage_of_ten_seconds_is_bounded(seeds):
    for seed in seeds:
        windows = ((0.0, 5.0), (15.0, 99.0))
        flight = Flight(truth=Truth(18.0, speed=1.5), seed=seed, pose_windows=windows).run()
        drift = np.linalg.norm(flight.errors[5 * RATE : 15 * RATE, 0:3], axis=1)
        assert drift.max() < 0.3
        assert drift.max() < 5.0 * flight.sigmas[15 * RATE - 1]
        assert flight.position_rmse(15.5) < 0.015


def test_a_jump_at_the_end_of_an_outage_is_announced():
    windows = ((0.0, 5.0), (15.0, 99.0))
    jumped = 0
    for seed in range(4):
        flight = Flight(truth=Truth(17.0, speed=1.5), seed=seed, pose_windows=windows).run()
        drift = float(np.linalg.norm(flight.errors[15 * RATE - 1, 0:3]))
        announced = [jump for when, jump, _ in flight.jumps if when > 15.0]
        if drift > 0.08:
            assert announced
            assert np.linalg.norm(np.sum(announced, axis=0)) == pytest.approx(drift, abs=0.06)
        jumped += bool(announced)
    assert jumped > 0 or drift < 0.08


def test_a_flight_without_pose_on_flow_and_range():
    flight = Flight(truth=Truth(speed=1.5), pose_windows=()).run()
    assert flight.position_rmse(4.0) < 0.15
    assert np.abs(flight.errors[800:, 2]).max() < 0.06
    assert flight.estimator.state.height_valid
    assert flight.estimator.state.last_pose_ns < 0
    assert flight.jumps == []


def test_without_flow_the_same_flight_drifts_away():
    """Ablation: range and pressure do not measure horizontal motion."""
    flight = Flight(truth=Truth(12.0, speed=1.5), pose_windows=(), flow_windows=()).run()
    assert np.abs(flight.errors[:, 0:2]).max() > 0.5


def test_with_no_aid_at_all_the_attitude_stays_level():
    flight = Flight(truth=Truth(14.0), pose_windows=((0, 5),), flow_windows=((0, 5),)).run()
    state = flight.estimator.state
    assert np.nanmax(np.abs(flight.errors[5 * RATE :, 6:8])) < math.radians(5.0)
    assert state.time_ns - state.last_velocity_aid_ns > 8 * 10**9
    assert state.velocity_sigma_m_s > 0.2


def test_the_covariance_stays_symmetric_and_positive():
    P = Flight(truth=Truth(40.0), pose_windows=()).run().estimator.covariance
    assert np.abs(P - P.T).max() < 1e-14
    assert np.linalg.eigvalsh(0.5 * (P + P.T)).min() > 0.0


def test_below_its_least_distance_the_ultrasonic_sensor_does_not_count():
    truth = Truth(4.0)
    flight = Flight(truth=truth, pose_windows=()).run()
    low = (-truth.position[:, 2] < 0.4) & (truth.time_ns > 1.2e9)
    assert low.any()
    assert np.abs(flight.errors[low, 2]).max() < 0.08


def test_outliers_of_the_range_are_refused():
    noise = Noise(range_outliers=0.25)
    flight = Flight(truth=Truth(10.0), noise=noise, pose_windows=()).run()
    assert np.abs(flight.errors[800:, 2]).max() < 0.1
    assert flight.estimator.counts["range_refused"] > 30


def test_a_range_that_disagrees_for_long_is_accepted_only_without_pose():
    """A table under the vehicle: height above the table. With a pose, the pose counts."""

    def table(t, distance):
        return max(0.44, distance - 0.6) if t > 5.0 else distance

    alone = Flight(truth=Truth(9.0), pose_windows=()).run(range_fault=table)
    assert alone.estimator.counts["range_recovered"] >= 1
    assert abs(alone.errors[-1, 2]) == pytest.approx(0.6, abs=0.15)
    posed = Flight(truth=Truth(9.0)).run(range_fault=table)
    assert posed.estimator.counts["range_recovered"] == 0
    assert np.abs(posed.errors[800:, 2]).max() < 0.03
