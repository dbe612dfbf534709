"""An error-state Kalman filter for position, velocity, attitude and the two biases of an IMU.

Theory of operation
-------------------
The nominal state runs through the full, nonlinear equations; a 15-dimensional error with covariance P runs beside it:

    error = (dp, dv, phi, dbg, dba), each 3 long; p_true = p + dp, v_true = v + dv, R_true = exp(phi) R,
    gyro_bias_true = gyro_bias + dbg, accelerometer_bias_true = accelerometer_bias + dba.

The attitude error phi is a rotation vector in the *world* frame (a left error): a measured attitude then observes phi
directly, and the transition matrix has only four blocks that differ from identity (Sola, "Quaternion kinematics for
the error-state Kalman filter", 2017, section 7, global angular errors):

    dp' = dp + dv dt          dv' = dv - [f]x phi dt - R dba dt          phi' = phi - R dbg dt

with f = R (accelerometer - bias) in the world frame. The transition is gathered over `covariance_every` samples and
then applied at once, which halves the cost and changes P by less than the noise models are known.

Delayed measurements. A history of past states is kept. A measurement taken at t_c < now is compared with the state of
t_c. Since the error moves as above, the error then was dp - tau dv and phi (tau = now - t_c) in terms of the error now:
that is the measurement matrix, and the correction applies to the present. Corrections made since t_c are part of the
present but not of the stored past; their running sums, stored with each state, put that right without touching the
history: dp_sum, dv_sum, phi_sum, and (dv t)_sum for the way a velocity correction moves the positions before it.

All 3-vectors are tuples of floats: scalar arithmetic on them is several times cheaper than numpy's.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from protocol.conventions import Array
from protocol.geometry import Quaternion, Rotation, Vector3, quaternion_of_rotation_vector, rotation_of, unit_product

GRAVITY_M_S2: Final = 9.80665
HISTORY_LENGTH: Final = 128
"""Past states kept: 0.64 s at 200 Hz."""
POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, ACCELEROMETER_BIAS = 0, 3, 6, 9, 12
"""Where each part of the error begins."""
ERROR_SIZE: Final = 15
_ZERO: Final[Vector3] = (0.0, 0.0, 0.0)


class PastState(NamedTuple):
    """The nominal state at one IMU sample, and the sums of all corrections up to then."""

    time_ns: int
    position: Vector3
    velocity: Vector3
    rotation: Rotation
    rate_world: Vector3
    dp_sum: Vector3
    dv_sum: Vector3
    dvt_sum: Vector3
    phi_sum: Vector3


class ErrorStateFilter:
    """Nominal state, its covariance, and the two things one can do to them: predict and correct."""

    def __init__(self, covariance_every: int) -> None:
        """`covariance_every`: IMU samples per covariance step."""
        self._every = covariance_every
        self.position: Vector3 = _ZERO
        self.velocity: Vector3 = _ZERO
        self.quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self.rotation: Rotation = rotation_of(self.quaternion)
        self.gyro_bias: Vector3 = _ZERO
        self.accelerometer_bias: Vector3 = _ZERO
        self.P: Array = np.zeros((ERROR_SIZE, ERROR_SIZE))
        self._P_diagonal = self.P.reshape(-1)[:: ERROR_SIZE + 1]
        self._Phi: Array = np.eye(ERROR_SIZE)
        self._Phi_T = self._Phi.T
        self._Phi_velocity_bias = self._Phi[3:6, 12:15]
        self._Phi_attitude_bias = self._Phi[6:9, 9:12]
        self._Q: Array = np.zeros(ERROR_SIZE)
        self._scratch: Array = np.zeros((ERROR_SIZE, ERROR_SIZE))
        self._H_position: Array = np.eye(3, ERROR_SIZE)
        self._H_position_T = self._H_position.T
        self._G_inverse: Array = np.zeros(9)
        self._G_inverse_T = self._G_inverse.reshape(3, 3).T
        self._whitened: Array = np.zeros(3)
        self._gathered = 0
        self._gathered_s = 0.0
        self._gathered_dv: Vector3 = _ZERO
        self._last_rate: Vector3 | None = None
        self._sums = (_ZERO, _ZERO, _ZERO, _ZERO)
        self._time_s = 0.0
        self._history: list[PastState | None] = [None] * HISTORY_LENGTH
        self._newest = -1

    def start(self, quaternion: Quaternion, gyro_bias: Vector3, sigmas: tuple[float, ...]) -> None:
        """Sets the attitude and gyro bias at rest in the origin. `sigmas`: standard deviations of the 15 errors."""
        self.quaternion = quaternion
        self.rotation = rotation_of(quaternion)
        self.gyro_bias = gyro_bias
        self.P[:] = np.diag(np.square(sigmas))

    def predict(
        self,
        time_ns: int,
        dt: float,
        accelerometer: Vector3,
        gyroscope: Vector3,
        noise: tuple[float, float, float, float],
        gyro_delay_s: float = 0.0,
    ) -> None:
        """Moves the state by one IMU sample.

        The accelerometer gives the mean over the step. The gyroscope gives a rate `gyro_delay_s` old; its mean over
        the step is read off the straight line through this sample and the one before (without delay: the mean of
        both). `noise`: standard deviations of accelerometer (m/s^2) and gyroscope (rad/s) samples, and the densities
        of the biases' random walks (rad/s and m/s^2 per sqrt(s)).
        """
        bx, by, bz = self.gyro_bias
        gx, gy, gz = gyroscope
        ox, oy, oz = self._last_rate or gyroscope
        ahead = gyro_delay_s / dt - 0.5
        turn = (
            (gx + ahead * (gx - ox) - bx) * dt,
            (gy + ahead * (gy - oy) - by) * dt,
            (gz + ahead * (gz - oz) - bz) * dt,
        )
        self.quaternion = unit_product(self.quaternion, quaternion_of_rotation_vector(turn))
        sa, sb, sc, sd, se, sf, sg, sh, si = self.rotation
        self.rotation = a, b, c, d, e, f, g, h, i = rotation_of(self.quaternion)
        cx, cy, cz = self.accelerometer_bias
        ax, ay, az = accelerometer
        half = 0.5 * dt
        ax = (ax - cx) * half
        ay = (ay - cy) * half
        az = (az - cz) * half
        dvx = (a + sa) * ax + (b + sb) * ay + (c + sc) * az
        dvy = (d + sd) * ax + (e + se) * ay + (f + sf) * az
        dvz = (g + sg) * ax + (h + sh) * ay + (i + si) * az + GRAVITY_M_S2 * dt
        vx, vy, vz = self.velocity
        x, y, z = self.position
        self.position = (x + (vx + 0.5 * dvx) * dt, y + (vy + 0.5 * dvy) * dt, z + (vz + 0.5 * dvz) * dt)
        self.velocity = (vx + dvx, vy + dvy, vz + dvz)
        self._last_rate = gyroscope
        gx -= bx
        gy -= by
        gz -= bz
        rate_world = (a * gx + b * gy + c * gz, d * gx + e * gy + f * gz, g * gx + h * gy + i * gz)
        self._time_s = time_ns * 1e-9
        self._newest = (self._newest + 1) % HISTORY_LENGTH
        self._history[self._newest] = PastState(
            time_ns, self.position, self.velocity, self.rotation, rate_world, *self._sums
        )
        kx, ky, kz = self._gathered_dv
        self._gathered_dv = (kx + dvx, ky + dvy, kz + dvz - GRAVITY_M_S2 * dt)
        self._gathered_s += dt
        self._gathered += 1
        if self._gathered >= self._every:
            self._predict_covariance(noise)

    def _predict_covariance(self, noise: tuple[float, float, float, float]) -> None:
        """P = Phi P Phi^T + Q over the samples gathered."""
        Phi, dt = self._Phi, self._gathered_s
        sample_s = dt / self._gathered
        Phi[0, 3] = Phi[1, 4] = Phi[2, 5] = dt
        fx, fy, fz = self._gathered_dv
        Phi[3, 7], Phi[3, 8], Phi[4, 8] = fz, -fy, fx
        Phi[4, 6], Phi[5, 6], Phi[5, 7] = -fz, fy, -fx
        block = np.array(self.rotation).reshape(3, 3)
        block *= -dt
        self._Phi_velocity_bias[:] = block
        self._Phi_attitude_bias[:] = block
        Phi.dot(self.P, self._scratch)
        self._scratch.dot(self._Phi_T, self.P)
        accelerometer, gyroscope, gyro_walk, accelerometer_walk = noise
        Q = self._Q
        Q[3:6] = accelerometer * accelerometer * sample_s * dt
        Q[6:9] = gyroscope * gyroscope * sample_s * dt
        Q[9:12] = gyro_walk * gyro_walk * dt
        Q[12:15] = accelerometer_walk * accelerometer_walk * dt
        self._P_diagonal += Q
        self._gathered, self._gathered_s, self._gathered_dv = 0, 0.0, _ZERO

    def at(self, time_ns: int) -> PastState | None:
        """The state at `time_ns` as we know it now, all later corrections included; None when it is not in the history.

        Between samples position and attitude run on at constant rate.
        """
        index = self._newest
        for _ in range(HISTORY_LENGTH):
            past = self._history[index]
            if past is None:
                return None
            if past.time_ns <= time_ns:
                return self._corrected(past, time_ns)
            index -= 1
        return None

    def _corrected(self, past: PastState, time_ns: int) -> PastState:
        dp, dv, dvt, phi = self._sums
        stamp_s = past.time_ns * 1e-9
        ahead_s = (time_ns - past.time_ns) * 1e-9
        du = (dv[0] - past.dv_sum[0], dv[1] - past.dv_sum[1], dv[2] - past.dv_sum[2])
        vx, vy, vz = past.velocity[0] + du[0], past.velocity[1] + du[1], past.velocity[2] + du[2]
        position = (
            past.position[0] + dp[0] - past.dp_sum[0] - (dvt[0] - past.dvt_sum[0] - stamp_s * du[0]) + vx * ahead_s,
            past.position[1] + dp[1] - past.dp_sum[1] - (dvt[1] - past.dvt_sum[1] - stamp_s * du[1]) + vy * ahead_s,
            past.position[2] + dp[2] - past.dp_sum[2] - (dvt[2] - past.dvt_sum[2] - stamp_s * du[2]) + vz * ahead_s,
        )
        wx, wy, wz = past.rate_world
        turn = (
            phi[0] - past.phi_sum[0] + wx * ahead_s,
            phi[1] - past.phi_sum[1] + wy * ahead_s,
            phi[2] - past.phi_sum[2] + wz * ahead_s,
        )
        a, b, c, d, e, f, g, h, i = past.rotation
        tx, ty, tz = turn  # R + [turn]x R: the turn is small, being a few corrections and at most one sample
        rotation = (
            a - tz * d + ty * g,
            b - tz * e + ty * h,
            c - tz * f + ty * i,
            d + tz * a - tx * g,
            e + tz * b - tx * h,
            f + tz * c - tx * i,
            g - ty * a + tx * d,
            h - ty * b + tx * e,
            i - ty * c + tx * f,
        )
        return PastState(time_ns, position, (vx, vy, vz), rotation, past.rate_world, dp, dv, dvt, phi)

    def correct_scalar(self, h: Array | int, innovation: float, variance: float, gate: float) -> float:
        """One scalar measurement of the error: h . error (or error[h]) = innovation + noise.

        Returns the squared innovation over its variance; the state changes only when that is within `gate`.
        """
        P = self.P
        if isinstance(h, int):
            PHt = P[:, h].copy()
            S = float(PHt[h]) + variance
        else:
            PHt = P.dot(h)
            S = float(PHt.dot(h)) + variance
        score = innovation * innovation / S
        if score <= gate:
            K = PHt / S
            np.multiply(K[:, None], PHt[None, :], out=self._scratch)
            P -= self._scratch
            K *= innovation
            self._apply(K)
        return score

    def correct_position(self, innovation: Vector3, delay_s: float, variance: float, gate: float) -> float:
        """A position measured `delay_s` ago: H = [I, -tau I, 0, 0, 0]. Returns the score, as correct_scalar does."""
        H = self._H_position
        H[0, 3] = H[1, 4] = H[2, 5] = -delay_s
        PHt = self.P.dot(self._H_position_T)
        (p00, _, _), (p10, p11, _), (p20, p21, p22), (v00, _, _), (v10, v11, _), (v20, v21, v22) = PHt[:6].tolist()
        S = (
            p00 - delay_s * v00,
            p10 - delay_s * v10,
            p11 - delay_s * v11,
            p20 - delay_s * v20,
            p21 - delay_s * v21,
            p22 - delay_s * v22,
        )
        return self._correct_three(PHt, S, innovation, variance, gate)

    def correct_attitude(self, innovation: Vector3, variance: float, gate: float) -> float:
        """A measured attitude: H = [0, 0, I, 0, 0]. Returns the score, as correct_scalar does."""
        PHt = self.P[:, 6:9]
        (a, _, _), (b, d, _), (c, e, f) = PHt[6:9].tolist()
        return self._correct_three(PHt, (a, b, d, c, e, f), innovation, variance, gate)

    def _correct_three(
        self,
        PHt: Array,
        S: tuple[float, float, float, float, float, float],
        innovation: Vector3,
        variance: float,
        gate: float,
    ) -> float:
        """Three measurements at once, with S + variance I = G G^T and G lower triangular.

        `S`: the lower triangle, row by row, of H P H^T.

        The whitened innovation is w = G^-1 y, the score w.w; with L = P H^T G^-T the error is L w and P loses L L^T,
        which is symmetric to the last bit.
        """
        a, b, d, c, e, f = S
        # Of variance I and something positive no pivot is less than the variance, but for rounding.
        g11 = math.sqrt(max(a + variance, variance))
        g21, g31 = b / g11, c / g11
        g22 = math.sqrt(max(d + variance - g21 * g21, variance))
        g32 = (e - g31 * g21) / g22
        g33 = math.sqrt(max(f + variance - g31 * g31 - g32 * g32, variance))
        w1 = innovation[0] / g11
        w2 = (innovation[1] - g21 * w1) / g22
        w3 = (innovation[2] - g31 * w1 - g32 * w2) / g33
        score = w1 * w1 + w2 * w2 + w3 * w3
        if score <= gate:
            i21 = -g21 / (g11 * g22)
            i32 = -g32 / (g22 * g33)
            i31 = -(g31 / g11 + g32 * i21) / g33
            inverse = self._G_inverse
            inverse[:] = (1.0 / g11, 0.0, 0.0, i21, 1.0 / g22, 0.0, i31, i32, 1.0 / g33)
            L = PHt.dot(self._G_inverse_T)
            whitened = self._whitened
            whitened[0], whitened[1], whitened[2] = w1, w2, w3
            error = L.dot(whitened)
            L.dot(L.T, self._scratch)
            self.P -= self._scratch
            self._apply(error)
        return score

    def _apply(self, error: Array) -> None:
        """Moves the estimated error into the nominal state."""
        e = error.tolist()
        self.shift((e[0], e[1], e[2]), (e[3], e[4], e[5]), (e[6], e[7], e[8]))
        x, y, z = self.gyro_bias
        self.gyro_bias = (x + e[9], y + e[10], z + e[11])
        x, y, z = self.accelerometer_bias
        self.accelerometer_bias = (x + e[12], y + e[13], z + e[14])

    def shift(self, dp: Vector3, dv: Vector3, phi: Vector3) -> None:
        """Corrects position, velocity and attitude, and with them the whole history."""
        x, y, z = self.position
        self.position = (x + dp[0], y + dp[1], z + dp[2])
        x, y, z = self.velocity
        self.velocity = (x + dv[0], y + dv[1], z + dv[2])
        self.quaternion = unit_product(quaternion_of_rotation_vector(phi), self.quaternion)
        self.rotation = rotation_of(self.quaternion)
        t = self._time_s
        p_sum, v_sum, vt_sum, phi_sum = self._sums
        self._sums = (
            (p_sum[0] + dp[0], p_sum[1] + dp[1], p_sum[2] + dp[2]),
            (v_sum[0] + dv[0], v_sum[1] + dv[1], v_sum[2] + dv[2]),
            (vt_sum[0] + dv[0] * t, vt_sum[1] + dv[1] * t, vt_sum[2] + dv[2] * t),
            (phi_sum[0] + phi[0], phi_sum[1] + phi[1], phi_sum[2] + phi[2]),
        )

    def forget_history(self) -> None:
        """Drops the past: after a turn too large for sums of small rotations."""
        self._history = [None] * HISTORY_LENGTH

    def restart_error(self, start: int, sigma: float) -> None:
        """Makes three errors from `start` on uncorrelated with all others, with standard deviation `sigma`."""
        self.P[start : start + 3, :] = 0.0
        self.P[:, start : start + 3] = 0.0
        self._P_diagonal[start : start + 3] = sigma * sigma

    def inflate(self, start: int, sigma: float, size: int = 3) -> None:
        """Adds an uncertainty of `sigma` to `size` errors from `start` on."""
        self._P_diagonal[start : start + size] += sigma * sigma

    def inflate_motion(self, sigma: float, seconds: float) -> None:
        """Adds an uncertainty of `sigma` to the velocity, of an error that has been there for so many seconds."""
        variance = sigma * sigma
        P = self.P
        for axis in range(3):
            p, v = POSITION + axis, VELOCITY + axis
            P[p, p] += variance * seconds * seconds
            P[p, v] += variance * seconds
            P[v, p] += variance * seconds
            P[v, v] += variance
