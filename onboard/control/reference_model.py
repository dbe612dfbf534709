"""Hedged reference models: the motion of the vehicle if its disturbances were cancelled exactly.

    x_rm_dot = A_rm x_rm + B K_r r - B (u - u_hat)

The last term is pseudo-control hedging: what the actuators could not deliver is taken out of the reference too, so that
e = x_rm - x obeys e_dot = A_rm e + B (nu_ad - Delta) exactly, in saturation as well, and adaptation never learns
from a limit.
"""

from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from configs.loader import ConfigRecord
from protocol.conventions import Array
from protocol.geometry import (
    Quaternion,
    Vector3,
    cross,
    quaternion_multiply,
    quaternion_to_rotation_vector,
    rotate,
    vector,
)

Damping = Annotated[float, Field(ge=0.3, le=3)]


def _each_axis(damping: Any) -> Any:
    return (damping, damping, damping) if isinstance(damping, int | float) else damping


class ChannelGains(ConfigRecord):
    """Poles of one channel's closed loop."""

    natural_frequency_rad_s: tuple[
        Annotated[float, Field(gt=0, le=60)], Annotated[float, Field(gt=0, le=60)], Annotated[float, Field(gt=0, le=60)]
    ]
    damping: Annotated[tuple[Damping, Damping, Damping], BeforeValidator(_each_axis)]
    """Per axis; one number stands for all three."""

    def stiffness(self) -> Array:
        """[3], omega_n^2."""
        return np.array([w * w for w in self.natural_frequency_rad_s])

    def rate_gain(self) -> Array:
        """[3], 2 zeta omega_n."""
        return np.array([2.0 * zeta * w for zeta, w in zip(self.damping, self.natural_frequency_rad_s, strict=True)])

    def pairs(self) -> list[tuple[float, float]]:
        """(K_1, K_2) of each axis."""
        return list(zip(self.stiffness().tolist(), self.rate_gain().tolist(), strict=True))

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
        self._k1 = tuple(gains.stiffness().tolist())
        self._k2 = tuple(gains.rate_gain().tolist())
        self.position: Array = np.zeros(3)
        self.velocity: Array = np.zeros(3)

    def reset(self, position: Array, velocity: Array) -> None:
        """Set the reference to the vehicle's state [3], [3]."""
        self.position[:] = position
        self.velocity[:] = velocity

    def shift(self, jump: Array) -> None:
        """Move with a jump [3] of the position estimate, which is no motion."""
        self.position += jump

    def error(self, position: Array, velocity: Array, out: Array) -> None:
        """Compute e = x_rm - x [6] against the vehicle's position and velocity [3], m and m/s."""
        np.subtract(self.position, position, out=out[:3])
        np.subtract(self.velocity, velocity, out=out[3:])

    def step(self, command: Vector3, hedge: Vector3, dt: float) -> None:
        """Advance one period: v_rm_dot = K_r r - K_1 p_rm - K_2 v_rm - (u - u_hat).

        Parameters
        ----------
        command: K_r r, m/s^2.
        hedge: u - u_hat, m/s^2.
        """
        p, v = self.position.tolist(), self.velocity.tolist()
        each_axis = zip(command, self._k1, p, self._k2, v, hedge, strict=True)
        a = [K_r_r - k1 * p_i - k2 * v_i - h for K_r_r, k1, p_i, k2, v_i, h in each_axis]
        half = 0.5 * dt * dt
        self.position[:] = [p_i + (dt * v_i + half * a_i) for p_i, v_i, a_i in zip(p, v, a, strict=True)]
        self.velocity[:] = [v_i + dt * a_i for v_i, a_i in zip(v, a, strict=True)]


class AttitudeReferenceModel:
    """Attitude quaternion and body rates of the reference, and the error e against the vehicle's.

    e_1 is the rotation vector from the vehicle to the reference and e_2 = R(e_1) omega_rm - omega, the difference of
    the rates in the vehicle's axes. Then e_1_dot = e_2 + O(|e_1| |e_2|), at any tilt and any rate: without the
    singularity of Euler angles, and without a term in omega that would turn e about. The reference is driven through
    e as well, omega_rm_dot = R(e_1)' (K_r r - K x - K e - (u - u_hat) + omega x e_2), which makes e_2_dot =
    -K e + nu_ad - Delta hold however far away the commanded attitude is.
    """

    def __init__(self, gains: ChannelGains) -> None:
        self._k1 = tuple(gains.stiffness().tolist())
        self._k2 = tuple(gains.rate_gain().tolist())
        self.quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self.rates: Vector3 = (0.0, 0.0, 0.0)
        """Body rates of the reference, in its own axes, rad/s."""
        self._turn: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self._e: tuple[float, ...] = (0.0,) * 6
        self._vehicle_rates: Vector3 = (0.0, 0.0, 0.0)

    def reset(self, quaternion: Array, rates: Array) -> None:
        """Set the reference to the vehicle's attitude [4] and rates [3]."""
        w, x, y, z = quaternion.tolist()
        self.quaternion = (w, x, y, z)
        p, q, r = rates.tolist()
        self.rates = self._vehicle_rates = (p, q, r)
        self._turn = (1.0, 0.0, 0.0, 0.0)
        self._e = (0.0,) * 6

    def error(self, quaternion: Array, rates: Array, out: Array) -> None:
        """Compute e = [e_1; e_2] [6] against the vehicle's attitude [4] and rates [3], rad and rad/s."""
        w, x, y, z = quaternion.tolist()
        p, q, r = rates.tolist()
        self._turn = quaternion_multiply((w, -x, -y, -z), self.quaternion)
        e1, e2, e3 = quaternion_to_rotation_vector(self._turn)
        wx, wy, wz = rotate(self._turn, self.rates)
        self._e = (e1, e2, e3, wx - p, wy - q, wz - r)
        self._vehicle_rates = (p, q, r)
        out[:] = self._e

    def step(self, command: Vector3, hedge: Vector3, dt: float) -> None:
        """Advance one period: omega_rm_dot = R(e_1)' (K_r r - K x - (u - u_hat) - K e + omega x e_2).

        The vehicle's attitude and rates are those of the last call of `error`.

        Parameters
        ----------
        command: K_r r - K x in the vehicle's axes, that is u + nu_ad; rad/s^2.
        hedge: u - u_hat, rad/s^2.
        """
        e_1, e_2 = self._e[:3], self._e[3:]
        gyration = cross(self._vehicle_rates, vector(e_2))
        each_axis = zip(command, hedge, self._k1, e_1, self._k2, e_2, gyration, strict=True)
        alpha = vector(c - h - k1 * e1 - k2 * e2 + g for c, h, k1, e1, k2, e2, g in each_axis)
        w, x, y, z = self._turn
        alpha_rm = rotate((w, -x, -y, -z), alpha)
        h = 0.5 * dt
        turn = vector(h * (w_i + h * a_i) for w_i, a_i in zip(self.rates, alpha_rm, strict=True))
        nw, nx, ny, nz = quaternion_multiply(self.quaternion, (1.0, *turn))
        norm = (nw * nw + nx * nx + ny * ny + nz * nz) ** 0.5
        self.quaternion = (nw / norm, nx / norm, ny / norm, nz / norm)
        self.rates = vector(w_i + dt * a_i for w_i, a_i in zip(self.rates, alpha_rm, strict=True))
