"""Analytic flights for the estimator: truth, sensors computed from their definitions, noise, and recorded errors."""

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from onboard.estimation.config import EstimatorConfig
from onboard.estimation.estimator import Estimator
from protocol.conventions import GRAVITY
from protocol.mavlink.vehicle import FlowReading, ImuReading, RangeReading
from protocol.messages import Pose

RATE = 200
STEP_NS = 10**9 // RATE
DOWN = np.array([0.0, 0.0, GRAVITY])


DEFAULTS = EstimatorConfig()


@dataclass
class Truth:
    """Analytic flight: 1 s on the ground, then up to 1.2 m and along a tilted figure with slow yaw."""

    seconds: float = 20.0
    speed: float = 1.0
    start: tuple[float, float] = (0.0, 0.0)
    yaw_start: float = 0.0
    take_off_s: float = 1.0

    def __post_init__(self):
        n = int(self.seconds * RATE)
        self.n = n
        self.time_ns = (np.arange(n) + 1) * STEP_NS
        dt = 1e-3
        at = [self._position(self.time_ns * 1e-9 + k * dt) for k in (-2, -1, 0, 1, 2)]
        self.position = at[2]
        self.velocity = (at[3] - at[1]) / (2 * dt)
        self.rotation = self._rotation(self.time_ns * 1e-9)
        before, after = self._rotation(self.time_ns * 1e-9 - dt), self._rotation(self.time_ns * 1e-9 + dt)
        self.rates = (before.inv() * after).as_rotvec() / (2 * dt)
        self.force = self._mean_force()
        self.airborne = self.time_ns * 1e-9 > self.take_off_s

    def _mean_force(self):
        """Specific force in the body frame, the mean over the step that ends at each sample."""
        dt = 1e-3
        middle = self.time_ns * 1e-9 - 0.5 / RATE
        acceleration = self._position(middle + dt) - 2 * self._position(middle) + self._position(middle - dt)
        return self._rotation(middle).inv().apply(acceleration / dt**2 - DOWN)

    def _position(self, t):
        s = np.clip((t - self.take_off_s) / 2.0, 0.0, 1.0)
        rise = s**3 * (10 - 15 * s + 6 * s**2)
        u = self.speed * np.maximum(t - self.take_off_s - 2.0, 0.0)
        blend = 1.0 - np.exp(-((u / 2.0) ** 3))
        n = blend * np.sin(0.9 * u)
        e = blend * 0.7 * np.sin(1.4 * u)
        d = -1.2 * rise - blend * 0.2 * np.sin(0.7 * u)
        return np.column_stack((self.start[0] + n, self.start[1] + e, d))

    def _rotation(self, t):
        dt = 1e-3
        acceleration = (self._position(t + dt) - 2 * self._position(t) + self._position(t - dt)) / dt**2
        down = DOWN - acceleration
        z = down / np.linalg.norm(down, axis=1, keepdims=True)
        yaw = self.yaw_start + 0.3 * np.sin(0.4 * np.maximum(t - self.take_off_s, 0.0)) ** 3
        heading = np.column_stack((np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)))
        y = np.cross(z, heading)
        y /= np.linalg.norm(y, axis=1, keepdims=True)
        return Rotation.from_matrix(np.stack((np.cross(y, z), y, z), axis=2))


@dataclass
class Noise:
    accelerometer: float = 0.3
    gyro: float = 0.02
    gyro_delay_samples: int = 1
    accelerometer_bias: tuple[float, float, float] = (0.09, -0.06, 0.34)
    gyro_bias: tuple[float, float, float] = (0.05, -0.03, 0.02)
    flow_rate: float = 0.06
    range_m: float = 0.03
    range_outliers: float = 0.03
    pressure_pa: float = 3.0
    pose_m: float = 0.006
    pose_rad: float = 0.012
    pose_delay_s: float = 0.05
    pose_rate: int = 50


@dataclass
class Flight:
    """Runs an estimator along a truth and records its errors."""

    truth: Truth = field(default_factory=Truth)
    noise: Noise = field(default_factory=Noise)
    config: EstimatorConfig = DEFAULTS
    seed: int = 1
    pose_windows: tuple[tuple[float, float], ...] = ((0.0, 1e9),)
    flow_windows: tuple[tuple[float, float], ...] = ((0.0, 1e9),)

    def run(self, pose_fault=None, range_fault=None, imu_fault=None, stamp_fault=None, time_sigma_s=0.0):
        truth, noise = self.truth, self.noise
        rng = np.random.default_rng([self.seed, 77])
        estimator = Estimator(self.config)
        n = truth.n
        bias_a = np.array(noise.accelerometer_bias) * rng.choice([-1.0, 1.0], 3)
        bias_g = np.array(noise.gyro_bias) * rng.choice([-1.0, 1.0], 3)
        accelerometer = (truth.force + bias_a + noise.accelerometer * rng.standard_normal((n, 3))).tolist()
        rates = np.roll(truth.rates, noise.gyro_delay_samples, axis=0)
        gyroscope = (rates + bias_g + noise.gyro * rng.standard_normal((n, 3))).tolist()
        pressure = (101325.0 + 11.8 * truth.position[:, 2] + noise.pressure_pa * rng.standard_normal(n)).tolist()
        queue = []
        errors, covariances, sigmas = [], [], []
        rotation = truth.rotation.as_matrix()
        attitude_errors = noise.pose_rad * rng.standard_normal((n, 3))
        quaternions = (Rotation.from_rotvec(attitude_errors) * truth.rotation).as_quat()[:, [3, 0, 1, 2]]
        positions = truth.position + noise.pose_m * rng.standard_normal((n, 3))
        flow_noise = noise.flow_rate * rng.standard_normal((n, 2))
        jumps, self.scores = [], {"pose_position": [], "pose_attitude": [], "flow": [], "range": []}
        for k in range(n):
            now_ns = int(truth.time_ns[k])
            t = now_ns * 1e-9
            estimator.set_on_ground(not truth.airborne[k])
            imu = ImuReading(now_ns, tuple(accelerometer[k]), tuple(gyroscope[k]), pressure[k])
            imu = imu if imu_fault is None else imu_fault(t, imu)
            if imu is not None:
                estimator.receive(imu)
            if k % 3 == 0 and k > 5 and any(a <= t < b for a, b in self.flow_windows):
                estimator.receive(flow_of(truth, rotation, k, flow_noise[k]))
                self._note("flow", estimator)
            if k % 8 == 0:
                distance = range_of(truth, rotation, k, noise, rng)
                if range_fault is not None:
                    distance = range_fault(t, distance)
                estimator.receive(RangeReading(now_ns, distance))
                self._note("range", estimator)
            if k % (RATE // noise.pose_rate) == 0 and any(a <= t < b for a, b in self.pose_windows):
                queue.append((now_ns + int(noise.pose_delay_s * 1e9), k))
            while queue and queue[0][0] <= now_ns:
                i = queue.pop(0)[1]
                position, quaternion = positions[i], quaternions[i]
                if pose_fault is not None:
                    position, quaternion = pose_fault(t, position, quaternion)
                pose = Pose(int(truth.time_ns[i]), position.astype(np.float32), quaternion.astype(np.float32))
                count = estimator.state.position_reset_count
                taken_ns = pose.time_ns if stamp_fault is None else stamp_fault(pose, now_ns)
                estimator.receive_pose(pose, taken_ns, now_ns, time_sigma_s)
                self._note("pose_position", estimator)
                self._note("pose_attitude", estimator)
                if estimator.state.position_reset_count != count:
                    jumps.append((t, estimator.state.position_jump.copy(), estimator.state.yaw_jump))
            state = estimator.state
            errors.append(self._error(k, state, bias_g, bias_a))
            sigmas.append(state.position_sigma_m)
            covariances.append(estimator.covariance.copy() if k % 20 == 0 else None)
        self.estimator, self.errors, self.covariances = estimator, np.array(errors), covariances
        self.sigmas, self.jumps, self.events = np.array(sigmas), jumps, estimator.take_events()
        return self

    def _error(self, k, state, bias_g, bias_a):
        """[15] true minus estimated state at sample k; the attitude only at every 20th."""
        truth = self.truth
        phi = (truth.rotation[k] * Rotation.from_matrix(state.rotation).inv()).as_rotvec() if k % 20 == 0 else None
        position, velocity = truth.position[k] - state.position, truth.velocity[k] - state.velocity
        attitude = np.full(3, np.nan) if phi is None else phi
        biases = bias_g - state.gyro_bias, bias_a - state.accelerometer_bias
        return np.concatenate((position, velocity, attitude, *biases))

    def _note(self, aid, estimator):
        """Record the newest score of an aid, after the first 4 s."""
        score = estimator.scores.pop(aid, None)
        if score is not None and estimator.state.time_ns > 4e9:
            self.scores[aid].append(score)

    def nees(self, part: slice, after_s: float):
        """Normalised estimation error squared of some of the 15 errors, ten times a second."""
        indices = range(int(after_s * RATE) // 20 * 20, self.truth.n, 20)
        return np.array(
            [
                self.errors[k, part] @ np.linalg.solve(self.covariances[k][part, part], self.errors[k, part])
                for k in indices
            ]
        )

    def position_rmse(self, after_s: float, before_s: float = 1e9):
        t = self.truth.time_ns * 1e-9
        chosen = (t >= after_s) & (t < before_s)
        return float(np.sqrt(np.mean(np.sum(self.errors[chosen, 0:3] ** 2, axis=1))))


def flow_of(truth, rotation, k, noise):
    """From the definition of HIL_OPTICAL_FLOW: rotation about +x gives +x flow, motion along +y gives -x flow."""
    dt = 3 / RATE
    x, y = noise[0] * dt, noise[1] * dt
    turned = np.zeros(3)
    for i, weight in zip(range(k - 3, k + 1), (0.5, 1.0, 1.0, 0.5), strict=True):  # trapezoidal rule over three steps
        v = rotation[i].T @ truth.velocity[i]
        distance = max(-truth.position[i, 2] / rotation[i, 2, 2], 0.05)
        turned += weight * truth.rates[i] / RATE
        x += weight * (truth.rates[i, 0] - v[1] / distance) / RATE
        y += weight * (truth.rates[i, 1] + v[0] / distance) / RATE
    return FlowReading(int(truth.time_ns[k]), dt, x, y, turned[0], turned[1], 200)


def range_of(truth, rotation, k, noise, rng):
    """The first echo: straight below while the tilt is within the beam's half cone of 0.35 rad."""
    tilt = math.acos(min(1.0, rotation[k, 2, 2]))
    distance = -truth.position[k, 2] / math.cos(max(0.0, tilt - 0.35)) + noise.range_m * rng.standard_normal()
    if rng.random() < noise.range_outliers:
        distance += rng.uniform(0.3, 1.5)
    return max(distance, 0.44)
