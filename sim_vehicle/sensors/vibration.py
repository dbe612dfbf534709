"""Noise of accelerometer and gyro with the spectrum of real flights.

Theory of operation. A rotor with an imbalance shakes the frame once per revolution (288 Hz in hover), and its two
blades twice per revolution. The frame adds broad-band vibration above its resonances. The sensor samples all of it at
1 kHz and sends the mean of five samples at 200 Hz. The mean weakens a frequency f by sin(5 pi f T) / (5 sin(pi f T)),
T = 1 ms, and sampling folds the rest: 288 Hz becomes 88 Hz and is 4 times weaker; what folds to the band of the
attitude loops (3 to 15 Hz) is near 200 or 400 Hz, where the mean is almost zero. The vehicle therefore shakes strongly
at high frequency and little in that band. Only the small white part is alike at all frequencies.
"""

from math import pi, sqrt, tan
from typing import Any

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.draws import NormalRows
from sim_vehicle.physics.parameters import MeasuredNoiseConfig

SAMPLES = 5
"""1 kHz samples in one reading."""
VIBRATION_STREAM = 1
"""Of the random stream [seed, stream, VIBRATION_STREAM]."""


@compiled
def vibrate(
    state: Array,
    sums: Array,
    shaking: Array,
    hover_thrust: float,
    tones: Array,
    broad: Array,
    white: Array,
    high_pass: Array,
    noise: Array,
    memory: Array,
    out: Array,
) -> None:
    """Write the mean vibration of the last five sub-steps into out[6]: m/s^2, then rad/s; zero the tones' sums.

    Parameters
    ----------
    shaking: [4, 2], see read_imu. hover_thrust: N, of one motor.
    tones: [6, 16] effect of the sums on each axis, in hover. broad: [6] standard deviations in hover. white: [6].
    high_pass: [3] b0, a1, a2; the numerator is b0 (1, -2, 1).
    noise: [6 SAMPLES + 6] unit normal draws. memory: [6, 2] of the high-pass.
    """
    scale = 1.0 / (SAMPLES * hover_thrust)
    level = 0.0
    for i in range(4):
        level += 0.25 * state[at.THRUST + i] / hover_thrust
    b0, a1, a2 = high_pass[0], high_pass[1], high_pass[2]
    for axis in range(6):
        value = 0.0
        for j in range(16):
            value += tones[axis, j] * sums[at.IMU_TONES + j]
        value = value * scale + white[axis] * noise[6 * SAMPLES + axis]
        for k in range(SAMPLES):
            x = level * broad[axis] * noise[axis * SAMPLES + k]
            y = b0 * x + memory[axis, 0]
            memory[axis, 0] = -2.0 * b0 * x - a1 * y + memory[axis, 1]
            memory[axis, 1] = b0 * x - a2 * y
            value += y / SAMPLES
        out[axis] = value
    for i in range(4):
        c, s = scale * sums[at.IMU_TONES + 4 * i], scale * sums[at.IMU_TONES + 4 * i + 1]
        out[0] += shaking[i, 0] * c
        out[1] += shaking[i, 0] * s
        out[3] += shaking[i, 1] * s
        out[4] += shaking[i, 1] * c
    sums[at.IMU_TONES : at.IMU_TONES + 16] = 0.0


class Vibration:
    """Vibration of one vehicle: its tones are drawn from the seed. The random stream is [seed, stream, 1]."""

    def __init__(self, config: MeasuredNoiseConfig, hover_thrust_n: float, seed: int, stream: int) -> None:
        rng = np.random.default_rng([seed, stream, VIBRATION_STREAM])
        tone = config.factor * np.array(config.accelerometer_tone_m_s2 + config.gyroscope_tone_rad_s)
        tones = draw_tones(rng, tone, config.blade_share, config.rotor_spread)
        broad = config.factor * np.array(config.accelerometer_broad_m_s2 + config.gyroscope_broad_rad_s)
        white = config.factor * np.array(config.accelerometer_white_m_s2 + config.gyroscope_white_rad_s)
        self._constants = hover_thrust_n, tones, broad, white, butterworth_high_pass(config.broad_above_hz)
        self._noise = NormalRows(rng, 6 * SAMPLES + 6)
        self._memory, self._out = np.zeros((6, 2)), np.zeros(6)

    def arguments(self) -> tuple[Any, ...]:
        """The arguments of `vibrate` for the next reading, but for the first three: its result is in the last one."""
        return *self._constants, self._noise.take(), self._memory, self._out


def draw_tones(rng: np.random.Generator, tone: Array, blade_share: float, rotor_spread: float) -> Array:
    """[6, 16] effect of cos, sin of phase and of twice the phase of each rotor on each axis, in hover.

    Each rotor has its own amplitude, and its own phase on each axis. tone: [6] standard deviations of all rotors.
    """
    amplitude = 1.0 + rotor_spread * rng.uniform(-1.0, 1.0, 4)
    amplitude *= sqrt(2.0) / np.linalg.norm(amplitude)
    phase = rng.uniform(0.0, 2.0 * pi, (6, 4, 2))
    once_and_twice = np.stack([np.cos(phase), -np.sin(phase)], axis=-1) * np.array([1.0, blade_share])[:, None]
    tones: Array = tone[:, None] * (amplitude[:, None, None] * once_and_twice).reshape(6, 16)
    return tones


def butterworth_high_pass(corner_hz: float) -> Array:
    """[3] b0, a1, a2 of a second-order high-pass at 1 kHz; its numerator is b0 (1, -2, 1)."""
    k = tan(pi * corner_hz / 1000.0)
    b0 = 1.0 / (1.0 + sqrt(2.0) * k + k * k)
    return np.array([b0, 2.0 * (k * k - 1.0) * b0, (1.0 - sqrt(2.0) * k + k * k) * b0])
