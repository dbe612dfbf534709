"""An error-state Kalman filter for position, velocity, attitude and the two biases of an IMU.

Theory of operation
-------------------
The nominal state (p, v, q, b_g, b_a) is integrated with the full, nonlinear equations. A 15-dimensional error with
covariance P is estimated beside it:

    error = (dp, dv, phi, db_g, db_a), each 3 long; p_true = p + dp, v_true = v + dv, R_true = exp([phi]x) R,
    b_g_true = b_g + db_g, b_a_true = b_a + db_a.

The attitude error phi is a rotation vector in the *world* frame (a left error). A measured attitude then observes phi
directly, and the transition matrix has only four blocks that differ from identity (Sola, "Quaternion kinematics for
the error-state Kalman filter", 2017, section 7, global angular errors):

    dp' = dp + dv dt          dv' = dv - [f]x phi dt - R db_a dt          phi' = phi - R db_g dt

with f = R (accelerometer - b_a) in the world frame. The transition is collected over `covariance_every` samples and
then applied at once: this halves the cost and changes P by less than the noise models are known.

Delayed measurements: see state_history.py. All 3-vectors are tuples of floats. Where the arithmetic is written out
axis by axis for speed, the equation stands above it.
"""

import math
from typing import Any

import numpy as np

from onboard.estimation.state_history import PastState, StateHistory
from protocol.conventions import GRAVITY, Array
from protocol.geometry import (
    ZERO,
    Quaternion,
    Rotation,
    Vector3,
    add,
    matrix_times,
    quaternion_of_rotation_vector,
    rotation_of,
    subtract,
    unit_product,
)

POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, ACCELEROMETER_BIAS = 0, 3, 6, 9, 12
"""Index of the first component of each part of the error."""
ERROR_SIZE = 15


class ErrorStateFilter:
    """Nominal state and covariance, with prediction and correction."""

    def __init__(self, covariance_every: int) -> None:
        """`covariance_every`: IMU samples per covariance step."""
        self._every = covariance_every
        self.position: Vector3 = ZERO
        self.velocity: Vector3 = ZERO
        self.quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self.rotation: Rotation = rotation_of(self.quaternion)
        self.gyro_bias: Vector3 = ZERO
        self.accelerometer_bias: Vector3 = ZERO
        self.P: Array = np.zeros((ERROR_SIZE, ERROR_SIZE))
        self._Phi: Array = np.eye(ERROR_SIZE)
        self._Q: Array = np.zeros(ERROR_SIZE)
        self._scratch: Array = np.zeros((ERROR_SIZE, ERROR_SIZE))
        self._H_position: Array = np.eye(3, ERROR_SIZE)
        self._G_inverse: Array = np.zeros(9)
        self._whitened: Array = np.zeros(3)
        self._collected = 0
        self._collected_s = 0.0
        self._collected_dv: Vector3 = ZERO
        self._last_rate: Vector3 | None = None
        self._history = StateHistory()
        self._make_views()

    def _make_views(self) -> None:
        """Parts of the arrays under names of their own."""
        self._P_diagonal = self.P.reshape(-1)[:: ERROR_SIZE + 1]
        self._P_T = self.P.T
        self._Phi_T = self._Phi.T
        self._Phi_velocity_bias = self._Phi[3:6, 12:15]
        self._Phi_attitude_bias = self._Phi[6:9, 9:12]
        self._H_position_T = self._H_position.T
        self._G_inverse_T = self._G_inverse.reshape(3, 3).T

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Of a copy: its views are of its own arrays."""
        self.__dict__.update(state)
        self._make_views()

    def start(self, quaternion: Quaternion, gyro_bias: Vector3, sigmas: tuple[float, ...]) -> None:
        """Set the attitude and gyro bias at rest in the origin. `sigmas`: standard deviations of the 15 errors."""
        self.quaternion = quaternion
        self.rotation = rotation_of(quaternion)
        self.gyro_bias = gyro_bias
        self.P[:] = np.diag(np.square(sigmas))

    # -- prediction ---------------------------------------------------------------------------------------------------

    def predict(
        self,
        time_ns: int,
        dt: float,
        accelerometer: Vector3,
        gyroscope: Vector3,
        noise: tuple[float, float, float, float],
        gyro_delay_s: float = 0.0,
    ) -> None:
        """Integrate one IMU sample.

        The accelerometer gives the mean over the step. The gyroscope gives a rate that is `gyro_delay_s` old.
        `noise`: standard deviations of accelerometer (m/s^2) and gyroscope (rad/s) samples, and the densities of the
        biases' random walks (rad/s and m/s^2 per sqrt(s)).
        """
        R_before = self.rotation
        self._rotate(dt, gyroscope, gyro_delay_s)
        self._move(dt, accelerometer, R_before)
        rate_world = matrix_times(self.rotation, subtract(gyroscope, self.gyro_bias))
        self._history.append(time_ns, self.position, self.velocity, self.rotation, rate_world)
        self._collected_s += dt
        self._collected += 1
        if self._collected >= self._every:
            self._predict_covariance(noise)

    def _rotate(self, dt: float, gyroscope: Vector3, delay_s: float) -> None:
        """Attitude after the step. The mean rate lies on the line through this sample and the one before."""
        bx, by, bz = self.gyro_bias
        gx, gy, gz = gyroscope
        ox, oy, oz = self._last_rate or gyroscope
        self._last_rate = gyroscope
        # omega = g + (delay / dt - 1/2) (g - g_before) - b_g;  without delay: the mean of both samples
        ahead = delay_s / dt - 0.5
        turn = (
            (gx + ahead * (gx - ox) - bx) * dt,
            (gy + ahead * (gy - oy) - by) * dt,
            (gz + ahead * (gz - oz) - bz) * dt,
        )
        # q <- q exp(omega dt)
        self.quaternion = unit_product(self.quaternion, quaternion_of_rotation_vector(turn))
        self.rotation = rotation_of(self.quaternion)

    def _move(self, dt: float, accelerometer: Vector3, R_before: Rotation) -> None:
        """Velocity and position after the step."""
        sa, sb, sc, sd, se, sf, sg, sh, si = R_before
        a, b, c, d, e, f, g, h, i = self.rotation
        cx, cy, cz = self.accelerometer_bias
        ax, ay, az = accelerometer
        # dv = 1/2 (R_before + R) (accelerometer - b_a) dt + g dt
        half = 0.5 * dt
        ax = (ax - cx) * half
        ay = (ay - cy) * half
        az = (az - cz) * half
        dvx = (a + sa) * ax + (b + sb) * ay + (c + sc) * az
        dvy = (d + sd) * ax + (e + se) * ay + (f + sf) * az
        dvz = (g + sg) * ax + (h + sh) * ay + (i + si) * az + GRAVITY * dt
        # p <- p + (v + 1/2 dv) dt,  v <- v + dv
        vx, vy, vz = self.velocity
        x, y, z = self.position
        self.position = (x + (vx + 0.5 * dvx) * dt, y + (vy + 0.5 * dvy) * dt, z + (vz + 0.5 * dvz) * dt)
        self.velocity = (vx + dvx, vy + dvy, vz + dvz)
        kx, ky, kz = self._collected_dv
        self._collected_dv = (kx + dvx, ky + dvy, kz + dvz - GRAVITY * dt)

    def _predict_covariance(self, noise: tuple[float, float, float, float]) -> None:
        """P <- Phi P Phi^T + Q over the collected samples."""
        Phi, dt = self._Phi, self._collected_s
        sample_s = dt / self._collected
        # dp' = dp + dv dt
        Phi[0, 3] = Phi[1, 4] = Phi[2, 5] = dt
        # dv' = dv - [f dt]x phi - R db_a dt
        fx, fy, fz = self._collected_dv
        Phi[3, 7], Phi[3, 8], Phi[4, 8] = fz, -fy, fx
        Phi[4, 6], Phi[5, 6], Phi[5, 7] = -fz, fy, -fx
        R_dt = np.array(self.rotation).reshape(3, 3)
        R_dt *= -dt
        self._Phi_velocity_bias[:] = R_dt
        # phi' = phi - R db_g dt
        self._Phi_attitude_bias[:] = R_dt
        Phi.dot(self.P, self._scratch)
        self._scratch.dot(self._Phi_T, self.P)
        accelerometer, gyroscope, gyro_walk, accelerometer_walk = noise
        Q = self._Q
        Q[3:6] = accelerometer * accelerometer * sample_s * dt
        Q[6:9] = gyroscope * gyroscope * sample_s * dt
        Q[9:12] = gyro_walk * gyro_walk * dt
        Q[12:15] = accelerometer_walk * accelerometer_walk * dt
        self._P_diagonal += Q
        # Corrections leave an antisymmetric part of P as it is, and Phi lets what rounding adds grow with t^6.
        np.add(self.P, self._P_T, out=self._scratch)
        np.multiply(self._scratch, 0.5, out=self.P)
        self._collected, self._collected_s, self._collected_dv = 0, 0.0, ZERO

    # -- corrections --------------------------------------------------------------------------------------------------

    def at(self, time_ns: int) -> PastState | None:
        """The state at `time_ns` with all later corrections; None if the history does not reach it."""
        return self._history.at(time_ns)

    def correct_scalar(self, h: Array | int, innovation: float, variance: float, gate: float) -> float:
        """One scalar measurement of the error: h . error (or error[h]) = innovation + noise.

        Returns the score: the squared innovation over its variance. The state changes only if it is within `gate`.
        """
        P = self.P
        # S = h P h^T + variance
        if isinstance(h, int):
            PHt = P[:, h].copy()
            S = float(PHt[h]) + variance
        else:
            PHt = P.dot(h)
            S = float(PHt.dot(h)) + variance
        score = innovation * innovation / S
        if score <= gate:
            # K = P h^T / S,  P <- P - K h P,  error = K innovation
            K = PHt / S
            np.multiply(K[:, None], PHt[None, :], out=self._scratch)
            P -= self._scratch
            K *= innovation
            self._apply(K)
        return score

    def correct_position(self, innovation: Vector3, delay_s: float, variance: float, gate: float) -> float:
        """A position measured tau = `delay_s` ago: H = [I, -tau I, 0, 0, 0]. Returns the score, as correct_scalar."""
        H = self._H_position
        H[0, 3] = H[1, 4] = H[2, 5] = -delay_s
        PHt = self.P.dot(self._H_position_T)
        (p00, _, _), (p10, p11, _), (p20, p21, p22), (v00, _, _), (v10, v11, _), (v20, v21, v22) = PHt[:6].tolist()
        # H P H^T = (P H^T)[p] - tau (P H^T)[v]
        HPHt = (
            p00 - delay_s * v00,
            p10 - delay_s * v10,
            p11 - delay_s * v11,
            p20 - delay_s * v20,
            p21 - delay_s * v21,
            p22 - delay_s * v22,
        )
        return self._correct_three(PHt, HPHt, innovation, variance, gate)

    def correct_attitude(self, innovation: Vector3, variance: float, gate: float) -> float:
        """A measured attitude: H = [0, 0, I, 0, 0]. Returns the score, as correct_scalar."""
        PHt = self.P[:, 6:9]
        (a, _, _), (b, d, _), (c, e, f) = PHt[6:9].tolist()
        return self._correct_three(PHt, (a, b, d, c, e, f), innovation, variance, gate)

    def correct_past_attitude(self, innovation: Vector3, delay_s: float, variance: float, gate: float) -> float:
        """An attitude measured tau = `delay_s` ago: H = [0, 0, I, tau R, 0]. Returns the score, as correct_scalar.

        For a rate that is so uncertain that its error matters within that time.
        """
        tau_R = delay_s * np.array(self.rotation).reshape(3, 3)
        PHt = self.P[:, 6:9] + self.P[:, 9:12].dot(tau_R.T)
        (a, _, _), (b, d, _), (c, e, f) = (PHt[6:9] + tau_R.dot(PHt[9:12])).tolist()
        return self._correct_three(PHt, (a, b, d, c, e, f), innovation, variance, gate)

    def _correct_three(
        self,
        PHt: Array,
        HPHt: tuple[float, float, float, float, float, float],
        y: Vector3,
        variance: float,
        gate: float,
    ) -> float:
        """Three measurements at once, innovation y, by the Cholesky factor G of S; a symmetric P stays so.

        `HPHt`: the lower triangle, row by row.
        """
        a, b, d, c, e, f = HPHt
        # G G^T = S = H P H^T + variance I. No pivot is less than the variance, except by rounding.
        g11 = math.sqrt(max(a + variance, variance))
        g21, g31 = b / g11, c / g11
        g22 = math.sqrt(max(d + variance - g21 * g21, variance))
        g32 = (e - g31 * g21) / g22
        g33 = math.sqrt(max(f + variance - g31 * g31 - g32 * g32, variance))
        # w = G^-1 y,  score = w . w = y^T S^-1 y
        w1 = y[0] / g11
        w2 = (y[1] - g21 * w1) / g22
        w3 = (y[2] - g31 * w1 - g32 * w2) / g33
        score = w1 * w1 + w2 * w2 + w3 * w3
        if score <= gate:
            i21 = -g21 / (g11 * g22)
            i32 = -g32 / (g22 * g33)
            i31 = -(g31 / g11 + g32 * i21) / g33
            self._G_inverse[:] = (1.0 / g11, 0.0, 0.0, i21, 1.0 / g22, 0.0, i31, i32, 1.0 / g33)
            whitened = self._whitened
            whitened[0], whitened[1], whitened[2] = w1, w2, w3
            # L = P H^T G^-T,  error = L w = K y,  P <- P - L L^T
            L = PHt.dot(self._G_inverse_T)
            error = L.dot(whitened)
            L.dot(L.T, self._scratch)
            self.P -= self._scratch
            self._apply(error)
        return score

    def _apply(self, error: Array) -> None:
        """Add the estimated error to the nominal state."""
        e = error.tolist()
        self.shift((e[0], e[1], e[2]), (e[3], e[4], e[5]), (e[6], e[7], e[8]))
        self.gyro_bias = add(self.gyro_bias, (e[9], e[10], e[11]))
        self.accelerometer_bias = add(self.accelerometer_bias, (e[12], e[13], e[14]))

    def shift(self, dp: Vector3, dv: Vector3, phi: Vector3) -> None:
        """Correct position, velocity and attitude, now and in the history: p + dp, v + dv, exp(phi) q."""
        self.position = add(self.position, dp)
        self.velocity = add(self.velocity, dv)
        self.quaternion = unit_product(quaternion_of_rotation_vector(phi), self.quaternion)
        self.rotation = rotation_of(self.quaternion)
        self._history.correct(dp, dv, phi)

    def forget_history(self) -> None:
        """Remove the stored states: after a rotation too large for sums of small rotations."""
        self._history.clear()

    # -- uncertainty --------------------------------------------------------------------------------------------------

    def restart_error(self, start: int, sigma: float) -> None:
        """Make three errors from `start` on uncorrelated with all others, with standard deviation `sigma`."""
        self.P[start : start + 3, :] = 0.0
        self.P[:, start : start + 3] = 0.0
        self._P_diagonal[start : start + 3] = sigma * sigma

    def inflate(self, start: int, sigma: float, size: int = 3) -> None:
        """Add an uncertainty of `sigma` to `size` errors from `start` on."""
        self._P_diagonal[start : start + size] += sigma * sigma

    def inflate_motion(self, sigma: float, seconds: float) -> None:
        """Add an uncertainty of `sigma` to the velocity, of an error that has lasted for `seconds`."""
        variance = sigma * sigma
        P = self.P
        for axis in range(3):
            p, v = POSITION + axis, VELOCITY + axis
            P[p, p] += variance * seconds * seconds
            P[p, v] += variance * seconds
            P[v, p] += variance * seconds
            P[v, v] += variance
