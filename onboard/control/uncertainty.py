"""What the actuators deliver (u_hat) and what they do not explain (the residual), in both channels.

The vehicle obeys x_dot = A x + B (u_hat + Delta). Delta itself cannot be measured; the residual

    r = x_dot - A x - u_hat          (the three rows that B selects)

is Delta plus the noise of the sensors. Controllers filter it (Delta_hat); the trainer smooths it over time.
"""

from collections.abc import Sequence

from onboard.control.actuators import Delivered
from onboard.control.airframe import AirframeConfig
from onboard.control.records import ChannelMeasurement
from onboard.estimation.state import VehicleState
from protocol.conventions import GRAVITY
from protocol.geometry import Vector3, vector


class UncertaintyMeasurement:
    """u_hat and residual of the position channel (m/s^2, world NED) and the attitude channel (rad/s^2, body FRD)."""

    def __init__(self, airframe: AirframeConfig, period_s: float) -> None:
        self._airframe = airframe
        self._dt = period_s
        self._position, self._attitude = ChannelMeasurement(), ChannelMeasurement()
        self._last_rates: Vector3 = (0.0, 0.0, 0.0)
        self._last_delivered = (0.0, 0.0, 0.0, 0.0)

    def step(self, state: VehicleState, passed: Sequence[Delivered]) -> tuple[ChannelMeasurement, ChannelMeasurement]:
        """Position and attitude channel at the present. The records are rewritten in the next tick.

        passed: thrust and torque at the end of each period since the last tick: one, or more if ticks were missed.
        Their mean has moved the vehicle since then.
        """
        sums, latest = (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)
        for delivered in passed:
            now = (delivered.thrust_n, *delivered.torque_nm)
            T, x, y, z = (0.5 * (before + after) for before, after in zip(self._last_delivered, now, strict=True))
            latest, self._last_delivered = (T, x, y, z), now
            sums = (sums[0] + T, sums[1] + x, sums[2] + y, sums[3] + z)
        periods = len(passed)
        T, x, y, z = (one / periods for one in sums)
        self._translation(state, T, latest[0])
        self._rotation(state, (x, y, z), self._dt * periods)
        return self._position, self._attitude

    def coming(self, state: VehicleState, delivered: Delivered, ahead: Delivered) -> tuple[Vector3, Vector3]:
        """Angular acceleration by the actuators now and one tick later, rad/s^2, at the present rates."""
        rates = vector(state.rates.tolist())
        return self._angular_acceleration(delivered.torque_nm, rates), self._angular_acceleration(
            ahead.torque_nm, rates
        )

    def _angular_acceleration(self, tau: Vector3, rates: Vector3) -> Vector3:
        """J^-1 (tau - omega x J omega), rad/s^2."""
        Jx, Jy, Jz = self._airframe.inertia_kg_m2
        (tx, ty, tz), (p, q, r) = tau, rates
        return (tx - (Jz - Jy) * q * r) / Jx, (ty - (Jx - Jz) * p * r) / Jy, (tz - (Jy - Jx) * p * q) / Jz

    def _translation(self, state: VehicleState, T: float, T_last: float) -> None:
        """u_hat = g e_3 - (T / m) R e_3;  r = R f + (T_last / m) R e_3, f the specific force of the last period."""
        lift, last_lift = -T / self._airframe.mass_kg, -T_last / self._airframe.mass_kg
        f = state.specific_force.tolist()
        u_hat, r = self._position.u_hat, self._position.residual
        for axis, (R0, R1, R2) in enumerate(state.rotation.tolist()):
            u_hat[axis] = lift * R2
            r[axis] = R0 * f[0] + R1 * f[1] + R2 * f[2] - last_lift * R2
        u_hat[2] += GRAVITY

    def _rotation(self, state: VehicleState, tau: Vector3, dt: float) -> None:
        """u_hat = J^-1 (tau - omega x J omega);  r = omega_dot - u_hat, over the time `dt` since the last tick."""
        p, q, r = state.rates.tolist()
        last_p, last_q, last_r = self._last_rates
        up, uq, ur = self._angular_acceleration(tau, (p, q, r))
        self._attitude.u_hat[:] = up, uq, ur
        self._attitude.residual[:] = (p - last_p) / dt - up, (q - last_q) / dt - uq, (r - last_r) / dt - ur
        self._last_rates = (p, q, r)
