"""Hedged reference models: how the vehicle would move if its disturbances were cancelled exactly.

    x_rm_dot = A_rm x_rm + B K_r r - B (u - u_hat)

The last term is pseudo-control hedging: what the actuators could not deliver is taken out of the reference too, so that
e = x_rm - x obeys e_dot = A_rm e + B (nu_ad - Delta) exactly, in saturation as well, and adaptation never learns
from a limit.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from configs.loader import Record
from onboard.rotation import quaternion_multiply, quaternion_to_rotation_vector

Array = NDArray[np.float64]
Vector3 = tuple[float, float, float]


class ChannelGains(Record):
    """Poles of one channel's closed loop."""

    natural_frequency_rad_s: tuple[
        Annotated[float, Field(gt=0, le=60)], Annotated[float, Field(gt=0, le=60)], Annotated[float, Field(gt=0, le=60)]
    ]
    damping: Annotated[float, Field(ge=0.3, le=3)]

    def stiffness(self) -> Array:
        """[3], omega_n^2."""
        return np.array([w * w for w in self.natural_frequency_rad_s])

    def rate_gain(self) -> Array:
        """[3], 2 zeta omega_n."""
        return np.array([2.0 * self.damping * w for w in self.natural_frequency_rad_s])

    def closed_loop_matrix(self) -> Array:
        """A_rm = A - B K, [6, 6]."""
        A_rm = np.zeros((6, 6))
        A_rm[:3, 3:] = np.eye(3)
        A_rm[3:, :3] = -np.diag(self.stiffness())
        A_rm[3:, 3:] = -np.diag(self.rate_gain())
        return A_rm


class PositionReferenceModel:
    """Position and velocity, world NED."""

    def __init__(self, gains: ChannelGains) -> None:
        self._k1 = gains.stiffness()
        self._k2 = gains.rate_gain()
        self.position: Array = np.zeros(3)
        self.velocity: Array = np.zeros(3)

    def reset(self, position: Array, velocity: Array) -> None:
        """Starts over at the vehicle's state [3], [3]."""
        self.position[:] = position
        self.velocity[:] = velocity

    def shift(self, jump: Array) -> None:
        """Follows a jump [3] of the position estimate, which is no motion."""
        self.position += jump

    def step(self, command: Array, hedge: Array, dt: float) -> None:
        """Advances one period.

        Parameters
        ----------
        command: [3], K_r r, m/s^2.
        hedge: [3], u - u_hat, m/s^2.
        """
        acceleration = command - self._k1 * self.position - self._k2 * self.velocity - hedge
        self.position += dt * self.velocity + (0.5 * dt * dt) * acceleration
        self.velocity += dt * acceleration


class AttitudeReferenceModel:
    """Attitude quaternion and body rates; the error lives in the tangent space at the vehicle's attitude.

    With e_1 the rotation vector from the vehicle to the reference and e_2 = omega_rm - omega,
    e_1_dot = e_2 + O(|omega| |e_1|): linear for small errors at any tilt, without the Euler angles' singularity.
    """

    def __init__(self, gains: ChannelGains) -> None:
        self._k1 = tuple(gains.stiffness().tolist())
        self._k2 = tuple(gains.rate_gain().tolist())
        self.quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
        self.rates: Vector3 = (0.0, 0.0, 0.0)

    def reset(self, quaternion: Array, rates: Array) -> None:
        """Starts over at the vehicle's attitude [4] and rates [3]."""
        w, x, y, z = quaternion.tolist()
        self.quaternion = (w, x, y, z)
        p, q, r = rates.tolist()
        self.rates = (p, q, r)

    def error(self, quaternion: Array, rates: Array, out: Array) -> None:
        """E = [e_1; e_2] [6] against the vehicle's attitude [4] and rates [3], rad and rad/s."""
        w, x, y, z = quaternion.tolist()
        out[:3] = quaternion_to_rotation_vector(quaternion_multiply((w, -x, -y, -z), self.quaternion))
        out[3:] = self.rates
        out[3:] -= rates

    def step(self, commanded: tuple[float, float, float, float], rates_ff: Vector3, hedge: Vector3, dt: float) -> None:
        """Advances one period towards the commanded attitude (quaternion) and feed-forward rates [rad/s].

        hedge: u - u_hat, rad/s^2.
        """
        w, x, y, z = self.quaternion
        ex, ey, ez = quaternion_to_rotation_vector(quaternion_multiply((w, -x, -y, -z), commanded))
        p, q, r = self.rates
        k1, k2 = self._k1, self._k2
        ap = k1[0] * ex + k2[0] * (rates_ff[0] - p) - hedge[0]
        aq = k1[1] * ey + k2[1] * (rates_ff[1] - q) - hedge[1]
        ar = k1[2] * ez + k2[2] * (rates_ff[2] - r) - hedge[2]
        h = 0.5 * dt
        mp, mq, mr = p + h * ap, q + h * aq, r + h * ar
        step = (1.0, h * mp, h * mq, h * mr)
        nw, nx, ny, nz = quaternion_multiply(self.quaternion, step)
        norm = (nw * nw + nx * nx + ny * ny + nz * nz) ** 0.5
        self.quaternion = (nw / norm, nx / norm, ny / norm, nz / norm)
        self.rates = (p + dt * ap, q + dt * aq, r + dt * ar)
