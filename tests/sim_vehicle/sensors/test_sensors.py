"""The sensors against their specification; pymavlink reads the frames."""

from math import cos, pi, sin

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sim_vehicle.physics.layout as at
from protocol.conventions import GRAVITY
from sim_vehicle.config import load_vehicle
from sim_vehicle.physics.draws import BLOCK, Draws
from sim_vehicle.sensors.flow import Flow
from sim_vehicle.sensors.imu import Imu, imu_settings, read_imu
from sim_vehicle.sensors.motion_capture import MotionCapture
from sim_vehicle.sensors.schedule import Schedule
from sim_vehicle.sensors.ultrasonic import Ultrasonic
from sim_vehicle.vehicle import SimVehicle, initial_state

CONFIG = load_vehicle("mambo", {"sensors": {"imu": {"noise": "white"}}})
SENSORS = CONFIG.sensors
NO_AIR = {"linear_n_s_m": 0.0, "quadratic_n_s2_m2": 0.0}
HOVER = 0.063 * GRAVITY / 4
QUIET = {
    "imu": {
        "noise": "white",
        "accelerometer_bias_sigma_m_s2": [0.0, 0.0, 0.0],
        "accelerometer_noise_m_s2": 0.0,
        "accelerometer_vibration_m_s2": 0.0,
        "gyroscope_bias_bound_rad_s": [0.0, 0.0, 0.0],
        "gyroscope_noise_rad_s": 0.0,
        "pressure_noise_pa": 0.0,
        "pressure_bias_sigma_pa": 0.0,
    },
    "flow": {"noise_rad_s": 0.0, "gyroscope_noise_rad_s": 0.0},
    "motion_capture": {"position_noise_m": 0.0, "attitude_noise_rad": 0.0, "loss_probability": 0.0},
}


def still(height=1.0):
    state = initial_state(CONFIG)
    state[2], state[5] = -height, 0.0
    return state


def imu_readings(count, state=None, shaking=None, seed=1, thrust=0.0):
    imu = Imu(SENSORS.imu, HOVER, seed, 1)
    state = still() if state is None else state
    state[at.THRUST : at.THRUST + 4] = thrust
    sums, shaking = np.zeros(at.SUMS_SIZE), np.zeros((4, 2)) if shaking is None else shaking
    values = np.empty((count, 7))
    for k in range(count):
        sums[at.IMU_TIME : at.IMU_FORCE + 3] = 0.005, 0.0, 0.0, -GRAVITY * 0.005
        sample = imu.sample(state, sums, shaking)
        values[k] = *sample.accelerometer_m_s2, *sample.gyroscope_rad_s, sample.pressure_pa
    return imu, values


def test_imu_bias_and_noise():
    imu, values = imu_readings(8000)
    truth = np.array([0, 0, -GRAVITY, 0, 0, 0, 101325.0 - 1.184 * GRAVITY])
    sigma = np.array([0.24] * 3 + [0.015] * 3 + [2.0])
    np.testing.assert_allclose((values.mean(axis=0) - truth - imu.bias) / sigma, 0.0, atol=0.05)
    np.testing.assert_allclose(values.std(axis=0), sigma, rtol=0.03)


def test_motors_shake_the_accelerometer():
    _, values = imu_readings(4000, thrust=HOVER)
    np.testing.assert_allclose(values[:, :3].std(axis=0), 0.6, rtol=0.05)


def test_biases_are_drawn_from_the_seed():
    biases = np.array([Imu(SENSORS.imu, HOVER, seed, 1).bias for seed in range(500)])
    np.testing.assert_allclose(biases[:, :3].std(axis=0), [0.09, 0.06, 0.34], rtol=0.12)
    assert np.abs(biases[:, 3:6]).max() <= 0.09
    np.testing.assert_allclose(biases[:, 3:6].std(axis=0), 0.09 / np.sqrt(3), rtol=0.12)
    np.testing.assert_array_equal(biases[3], Imu(SENSORS.imu, HOVER, 3, 1).bias)


def test_readings_are_quantised_and_limited():
    state = still()
    state[at.RATES] = 60.0
    _, values = imu_readings(50, state)
    for column, step in ((0, 0.0024), (4, 0.00106), (6, 0.1)):
        np.testing.assert_allclose(values[:, column] / step, np.round(values[:, column] / step), atol=1e-6)
    assert np.all(np.abs(values[:, 3] - 34.9) < 0.00106)


def test_gyro_lags_one_sample(vehicle, motors, frames):
    flying = vehicle({"sensors": QUIET, "initial": {"position_ned_m": [0, 0, -3]}})
    rates, readings = [], []
    for k in range(40):
        flying.receive(motors([0.5, 0.6, 0.6, 0.5]), k * 5_000_000)
        output = flying.step((k + 1) * 5_000_000)
        rates.append(output.truth[10])
        readings.append(frames(output.to_onboard, "HIL_SENSOR")[0].xgyro)
    np.testing.assert_allclose(readings[1:], rates[:-1], atol=0.0006)
    assert rates[-1] > 1.0


def test_accelerometer_integrates_to_the_velocity(vehicle, motors, frames):
    """It is the mean specific force: its sum is the velocity gained, up to the rotation within a tick."""
    flying = vehicle({"sensors": QUIET, "initial": {"position_ned_m": [0, 0, -3]}})
    velocity = np.zeros(3)
    for k in range(30):
        flying.receive(motors([0.8] * 4), k * 5_000_000)
        output = flying.step((k + 1) * 5_000_000)
        imu = frames(output.to_onboard, "HIL_SENSOR")[0]
        velocity += 0.005 * np.array([imu.xacc, imu.yacc, imu.zacc + GRAVITY])
    np.testing.assert_allclose(velocity, output.truth[3:6], atol=2e-4)


def test_imbalance_aliases_rotor_speed():
    """A chipped rotor at 1810 rad/s (288 Hz) shows at 88 Hz in a 200 Hz IMU, in accelerometer and gyro."""
    settings, reading, noise = imu_settings(SENSORS.imu, HOVER), np.zeros(7), np.zeros(7)
    shaking, state, sums = np.zeros((4, 2)), still(), np.zeros(at.SUMS_SIZE)
    shaking[2], state[at.THRUST + 2] = (5.0, 0.2), HOVER
    speed = np.sqrt(HOVER / 4.72e-8)
    assert speed / (2 * pi) == pytest.approx(288, abs=1)
    values = np.empty((2000, 7))
    for k in range(2000):
        sums[at.IMU_TIME] = 0.005
        state[at.ROTOR_PHASE + 2] = (speed * 0.005 * k) % (2 * pi)
        read_imu(state, sums, shaking, np.zeros(6), np.zeros(7), noise, settings, reading)
        values[k] = reading
    spectrum = np.abs(np.fft.rfft(values, axis=0)) / 1000
    frequency = np.fft.rfftfreq(2000, 0.005)
    for column, amplitude in ((0, 5.0), (1, 5.0), (3, 0.2), (4, 0.2)):
        peak = np.argmax(spectrum[1:, column]) + 1
        assert frequency[peak] == pytest.approx(speed / (2 * pi) - 200.0, abs=0.1)
        assert values[:, column].std() == pytest.approx(amplitude / np.sqrt(2), rel=0.01)


def test_pressure_follows_height(vehicle, frames):
    readings = [
        frames(vehicle({"sensors": QUIET, "initial": {"position_ned_m": [0, 0, d]}}).step(5_000_000).to_onboard)[0]
        for d in (-1.0, -3.0)
    ]
    fall = 100 * (readings[0].abs_pressure - readings[1].abs_pressure)
    assert fall == pytest.approx(2.0 * 1.184 * GRAVITY, abs=0.15)


def test_ultrasonic_floor_noise_and_outliers():
    sensor = Ultrasonic(SENSORS.ultrasonic, 1, 2)
    high = np.array([sensor.sample(still(1.2)) for _ in range(4000)])
    far = np.abs(high - 1.2) > 0.1
    assert far.mean() == pytest.approx(0.02 * 3.36 / 3.56, abs=0.007)
    assert high[~far].std() == pytest.approx(0.02, rel=0.05)
    assert high[far].min() >= 0.44
    low = np.array([sensor.sample(still(0.2)) for _ in range(300)])
    assert np.median(low) == 0.44
    assert low.min() == 0.44
    assert sum(sensor.sample(still(5.0)) is None for _ in range(300)) > 280


def test_ultrasonic_and_tilt():
    config = SENSORS.ultrasonic.model_copy(update={"noise_m": 0.0, "outlier_probability": 0.0})
    sensor, state = Ultrasonic(config, 1, 2), still(1.0)
    for tilt, expected in ((0.3, 1.0), (0.35 + 0.6, 1.0 / cos(0.6)), (1.5, None)):
        state[6:10] = cos(tilt / 2), sin(tilt / 2), 0.0, 0.0
        assert sensor.sample(state) == (None if expected is None else pytest.approx(expected))


@pytest.mark.parametrize(("velocity", "rates"), [((0.7, -0.4, 0.0), (0, 0, 0)), ((0.3, 0.5, 0.0), (0.4, -0.6, 0.2))])
def test_flow_keeps_px4s_signs(vehicle, frames, velocity, rates):
    """Flow minus gyro gives the velocity; rotation alone gives no velocity."""
    start = {"position_ned_m": [0, 0, -2], "velocity_ned_m_s": list(velocity)}
    flying = vehicle({"sensors": QUIET, "initial": start, "drag": NO_AIR})
    flying._state[at.RATES : at.RATES + 3] = rates
    output = flying.step(20_000_000)
    flow = frames(output.to_onboard, "HIL_OPTICAL_FLOW")[0]
    dt = flow.integration_time_us * 1e-6
    assert dt == pytest.approx(0.02)
    v_x = (flow.integrated_y - flow.integrated_ygyro) / dt * 2.0
    v_y = -(flow.integrated_x - flow.integrated_xgyro) / dt * 2.0
    np.testing.assert_allclose([v_x, v_y], velocity[:2], atol=0.02)
    np.testing.assert_allclose(
        [flow.integrated_xgyro, flow.integrated_ygyro, flow.integrated_zgyro], np.array(rates) * dt, atol=2e-4
    )
    assert flow.quality == 200


def test_flow_of_a_fast_changing_rotation_is_no_velocity(vehicle, motors, frames):
    """The camera's gyro is summed over the flow's own interval: nothing of a rotation is left in the velocity."""
    flying = vehicle({"sensors": QUIET, "initial": {"position_ned_m": [0, 0, -3]}, "drag": NO_AIR})
    turned, errors = [], []
    now_ns = 0
    for side in (1.0, -1.0) * 3:
        for _ in range(8):
            flying.receive(motors([0.5 - 0.2 * side, 0.5 + 0.2 * side, 0.5 + 0.2 * side, 0.5 - 0.2 * side]), now_ns)
            now_ns += 5_000_000
            for flow in frames(flying.step(now_ns).to_onboard, "HIL_OPTICAL_FLOW"):
                dt = flow.integration_time_us * 1e-6
                state = flying._state
                down = 1.0 - 2.0 * (state[at.QUATERNION + 1] ** 2 + state[at.QUATERNION + 2] ** 2)
                rate = (flow.integrated_x - flow.integrated_xgyro) / dt
                velocity = Rotation.from_quat(state[6:10][[1, 2, 3, 0]]).inv().apply(state[3:6])
                turned.append(flow.integrated_xgyro / dt)
                errors.append(rate + velocity[1] / (-state[2] / down))
    assert np.abs(np.diff(turned)).max() > 0.5  # rad/s from one frame to the next
    assert np.abs(errors).max() < 0.02


def test_flow_noise_and_quality():
    flow, sums, state = Flow(SENSORS.flow, 1, 3), np.zeros(at.SUMS_SIZE), still(1.0)

    def sample(height, rate=0.0):
        state[2] = -height
        sums[at.FLOW_TIME], sums[at.FLOW_ANGLE] = 0.0167, rate * 0.0167
        return flow.sample(state, sums)

    noise = np.array([sample(1.0).flow_rad for _ in range(3000)]) / 0.0167
    np.testing.assert_allclose(noise.std(axis=0), 0.08, rtol=0.05)
    assert [sample(1.0).quality, sample(0.05).quality, sample(4.5).quality, sample(1.0, 8.0).quality] == [200, 0, 0, 0]


def test_rates_of_all_messages(vehicle, frames):
    flying = vehicle({"sensors": {"motion_capture": {"loss_probability": 0.0}}})
    onboard, capture = [], []
    for k in range(1, 801):
        output = flying.step(k * 5_000_000)
        onboard += output.to_onboard
        capture += output.to_motion_capture
    kinds = [message.get_type() for message in frames(onboard)]
    counts = {kind: kinds.count(kind) for kind in set(kinds)}
    assert counts == {
        "HIL_SENSOR": 800,
        "HIL_OPTICAL_FLOW": 240,
        "DISTANCE_SENSOR": 100,
        "HEARTBEAT": 4,
        "BATTERY_STATUS": 4,
    }
    assert len(capture) in (399, 400)


def test_schedule_after_a_jump():
    schedule = Schedule(100.0)
    assert schedule.is_due(500_000_000)
    assert not schedule.is_due(505_000_000)
    assert schedule.is_due(510_000_000)


def test_motion_capture_latency(vehicle, frames):
    flying = vehicle({"sensors": {"motion_capture": {"latency_s": 0.012, "loss_probability": 0.0}}})
    for k in range(1, 60):
        now = k * 1_000_000
        for pose in frames(flying.step(now).to_motion_capture):
            assert now - pose.time_usec * 1000 == 12_000_000
            assert pose.time_usec % 10_000 == 0


def test_motion_capture_pose(vehicle, frames):
    flying = vehicle(
        {
            "sensors": QUIET | {"motion_capture": QUIET["motion_capture"] | {"latency_s": 0.0}},
            "initial": {"position_ned_m": [1.0, -2.0, -3.0], "velocity_ned_m_s": [0.5, 0.0, 0.0], "yaw_rad": pi / 2},
        }
    )
    flying.step(15_000_000)
    output = flying.step(20_000_000)
    pose = frames(output.to_motion_capture)[0]
    np.testing.assert_allclose([pose.x, pose.y, pose.z], output.truth[:3], atol=1e-6)
    np.testing.assert_allclose(pose.q, output.truth[6:10], atol=1e-6)
    assert pose.vy == pytest.approx(-0.5, abs=0.01)  # flying north with the nose east: to the left
    assert (pose.frame_id, pose.child_frame_id, pose.estimator_type) == (20, 12, 6)


def test_motion_capture_noise_drop_outs_and_outages():
    config = SENSORS.motion_capture.model_copy(update={"loss_probability": 0.1})
    capture, state = MotionCapture(config, 1, 4), still()
    poses = [capture.sample(state, k * 10_000_000) for k in range(1, 3001)]
    assert sum(pose is None for pose in poses) / 3000 == pytest.approx(0.1, abs=0.02)
    seen = [pose for pose in poses if pose is not None]
    np.testing.assert_allclose(np.std([pose.position_m for pose in seen], axis=0), 0.0005, rtol=0.1)
    np.testing.assert_allclose(2 * np.std([pose.quaternion[1:] for pose in seen], axis=0), 0.005, rtol=0.1)


def test_motion_capture_outage():
    outage = {"outages": [{"start_s": 0.1, "end_s": 0.3}], "loss_probability": 0.0}
    flying = SimVehicle(load_vehicle("mambo", {"sensors": {"motion_capture": outage}}), 1)
    times = [k * 5 for k in range(1, 100) if flying.step(k * 5_000_000).to_motion_capture]
    assert not [time for time in times if 110 <= time <= 305]
    assert len(times) > 25


def test_several_draws_at_once_are_those_of_one_at_a_time() -> None:
    one, several = (Draws(np.random.default_rng(5).standard_normal) for _ in range(2))
    drawn = [value for _ in range(2 * BLOCK // 7) for value in several.several(7)]  # across the end of a block
    assert len(drawn) > BLOCK
    assert drawn == [one.take() for _ in drawn]
