"""Accelerometer, gyro and barometer. The reading is one compiled function, because it runs in every 200 Hz tick."""

from collections import deque
from math import cos, sin, sqrt
from typing import Final, NamedTuple

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.conventions import GRAVITY, Array
from protocol.geometry import Vector3
from protocol.named_tuple import of_members
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.draws import NormalRows
from sim_vehicle.physics.parameters import ImuConfig
from sim_vehicle.sensors.vibration import Vibration, vibrate

AIR_DENSITY = 1.184
"""kg/m^3, the value of the thrust map."""
PRESSURE_RANGE = 2.0e5
"""Pa, full scale."""
NO_VIBRATION: Array = np.zeros(6)
NO_SHAKING: Array = np.zeros((4, 2))
ACCELEROMETER_NOISE, VIBRATION, HOVER_THRUST, GYROSCOPE_NOISE, PRESSURE_NOISE, FLOOR_PRESSURE = 0, 1, 2, 3, 4, 5
ACCELEROMETER_STEP, ACCELEROMETER_RANGE, GYROSCOPE_STEP, GYROSCOPE_RANGE, PRESSURE_STEP = 6, 7, 8, 9, 10


def imu_settings(config: ImuConfig, hover_thrust_n: float) -> Array:
    """[11] settings of `read_imu`. hover_thrust_n: of one motor."""
    white = config.accelerometer_noise_m_s2, config.accelerometer_vibration_m_s2, config.gyroscope_noise_rad_s
    if config.vibration is not None:  # it contains white noise of its own
        white = 0.0, 0.0, 0.0
    return np.array(
        [
            white[0],
            white[1],
            hover_thrust_n,
            white[2],
            config.pressure_noise_pa,
            config.pressure_at_floor_pa,
            config.accelerometer_step_m_s2,
            config.accelerometer_range_m_s2,
            config.gyroscope_step_rad_s,
            config.gyroscope_range_rad_s,
            config.pressure_step_pa,
        ]
    )


@compiled
def quantised(value: float, step: float, full: float) -> float:
    """The nearest multiple of `step`, within plus or minus `full`."""
    return float(step * np.rint(max(-full, min(full, value)) / step))


@compiled
def read_imu(
    state: Array,
    sums: Array,
    shaking: Array,
    vibration: Array,
    bias: Array,
    noise: Array,
    settings: Array,
    reading: Array,
) -> None:
    """Write accelerometer (m/s^2) and gyro (rad/s), both body FRD, and pressure (Pa) into reading[7]; zero the sums.

    shaking: [4, 2] amplitude of each rotor's imbalance at hover speed, m/s^2 and rad/s. It turns with the rotor's
    phase, so that 200 Hz sampling aliases it as in a real IMU without a filter. It grows with the squared rotor speed.
    vibration: [6] m/s^2 and rad/s to add, see Vibration. bias: [7]. noise: [7] unit normal draws.
    settings: see imu_settings.
    """
    time = max(sums[at.IMU_TIME], 1.0e-9)
    for i in range(3):
        reading[i] = sums[at.IMU_FORCE + i] / time + vibration[i]
        reading[3 + i] = state[at.RATES + i] + vibration[3 + i]
    sums[at.IMU_TIME : at.IMU_FORCE + 3] = 0.0
    level = 0.0
    for i in range(4):
        share = state[at.THRUST + i] / settings[HOVER_THRUST]
        level += 0.25 * share
        if shaking[i, 0] + shaking[i, 1] > 0.0:
            c, s = share * cos(state[at.ROTOR_PHASE + i]), share * sin(state[at.ROTOR_PHASE + i])
            reading[0] += shaking[i, 0] * c
            reading[1] += shaking[i, 0] * s
            reading[3] += shaking[i, 1] * s
            reading[4] += shaking[i, 1] * c
    shaken = settings[VIBRATION] * level
    sigma = sqrt(settings[ACCELEROMETER_NOISE] ** 2 + shaken * shaken)
    for i in range(3):
        value = reading[i] + bias[i] + sigma * noise[i]
        reading[i] = quantised(value, settings[ACCELEROMETER_STEP], settings[ACCELEROMETER_RANGE])
        value = reading[3 + i] + bias[3 + i] + settings[GYROSCOPE_NOISE] * noise[3 + i]
        reading[3 + i] = quantised(value, settings[GYROSCOPE_STEP], settings[GYROSCOPE_RANGE])
    pressure = settings[FLOOR_PRESSURE] + AIR_DENSITY * GRAVITY * state[at.POSITION + 2]
    value = pressure + bias[6] + settings[PRESSURE_NOISE] * noise[6]
    reading[6] = quantised(value, settings[PRESSURE_STEP], PRESSURE_RANGE)


@compiled
def read_vibrating_imu(
    state: Array,
    sums: Array,
    shaking: Array,
    no_shaking: Array,
    bias: Array,
    noise: Array,
    settings: Array,
    reading: Array,
    hover_thrust: float,
    tones: Array,
    broad: Array,
    white: Array,
    high_pass: Array,
    vibration_noise: Array,
    memory: Array,
    vibration: Array,
) -> None:
    """`vibrate` into vibration[6], then `read_imu` with it: one call from Python for both. no_shaking: NO_SHAKING."""
    vibrate(state, sums, shaking, hover_thrust, tones, broad, white, high_pass, vibration_noise, memory, vibration)
    read_imu(state, sums, no_shaking, vibration, bias, noise, settings, reading)


class ImuSample(NamedTuple):
    """One reading, body FRD."""

    accelerometer_m_s2: Vector3
    gyroscope_rad_s: Vector3
    pressure_pa: float


_sample: Final = of_members(ImuSample)


class Imu:
    """Accelerometer (mean specific force since the last sample), delayed gyro, barometer.

    The random stream is [seed, stream]. hover_thrust_n: of one motor.
    """

    def __init__(self, config: ImuConfig, hover_thrust_n: float, seed: int, stream: int) -> None:
        rng = np.random.default_rng([seed, stream])
        self.bias: Array = np.concatenate(
            [
                rng.standard_normal(3) * config.accelerometer_bias_sigma_m_s2,
                rng.uniform(-1.0, 1.0, 3) * config.gyroscope_bias_bound_rad_s,
                rng.standard_normal(1) * config.pressure_bias_sigma_pa,
            ]
        )
        """[7] accelerometer m/s^2, gyro rad/s, pressure Pa."""
        self._settings = imu_settings(config, hover_thrust_n)
        self._noise = NormalRows(rng, 7)
        self._reading = np.zeros(7)
        self._vibration: Vibration | None = None
        if config.vibration is not None:
            self._vibration = Vibration(config.vibration, hover_thrust_n, seed, stream)
        self._delayed: deque[Vector3] = deque(maxlen=config.gyroscope_delay_samples + 1)

    def sample(self, state: Array, sums: Array, shaking: Array) -> ImuSample:
        """Read the sensors and zero the IMU's sums. shaking: [4, 2], see `read_imu`."""
        noise, settings, reading = self._noise.take(), self._settings, self._reading
        if self._vibration is None:
            read_imu(state, sums, shaking, NO_VIBRATION, self.bias, noise, settings, reading)
        else:
            vibration = self._vibration.arguments()
            read_vibrating_imu(state, sums, shaking, NO_SHAKING, self.bias, noise, settings, reading, *vibration)
        ax, ay, az, p, q, r, pressure = reading.tolist()
        self._delayed.append((p, q, r))
        return _sample(((ax, ay, az), self._delayed[0], pressure))
