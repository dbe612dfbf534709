"""Past states of the filter, for measurements that arrive late.

A measurement taken at t_c < now is compared with the state at t_c. The error at t_c is, in terms of the error now,
dp - tau dv and phi (tau = now - t_c), so the correction applies to the present state. Corrections made after t_c are in
the present state but not in the stored one. Their running sums, stored with each state, add them without a change of
the history: sums of dp, dv, phi, and dv t for the distance by which a velocity correction moves earlier positions.
"""

from typing import Final, NamedTuple

from protocol.geometry import ZERO, Rotation, Vector3, add, scale, subtract

LENGTH: Final = 128
"""Stored states: 0.64 s at 200 Hz."""


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


class StateHistory:
    """A ring of past states, and the sums of all corrections."""

    def __init__(self) -> None:
        self._states: list[PastState | None] = [None] * LENGTH
        self._newest = -1
        self._time_s = 0.0
        self._sums = (ZERO, ZERO, ZERO, ZERO)

    def append(
        self, time_ns: int, position: Vector3, velocity: Vector3, rotation: Rotation, rate_world: Vector3
    ) -> None:
        """Store the state of a new IMU sample."""
        self._time_s = time_ns * 1e-9
        self._newest = (self._newest + 1) % LENGTH
        self._states[self._newest] = PastState(time_ns, position, velocity, rotation, rate_world, *self._sums)

    def correct(self, dp: Vector3, dv: Vector3, phi: Vector3) -> None:
        """Apply a correction of the present state to all stored states."""
        dp_sum, dv_sum, dvt_sum, phi_sum = self._sums
        self._sums = (add(dp_sum, dp), add(dv_sum, dv), add(dvt_sum, scale(dv, self._time_s)), add(phi_sum, phi))

    def at(self, time_ns: int) -> PastState | None:
        """The state at `time_ns` with all later corrections; None if the history does not reach it.

        Between samples the state moves on with constant velocity and rate.
        """
        index = self._newest
        for _ in range(LENGTH):
            past = self._states[index]
            if past is None:
                return None
            if past.time_ns <= time_ns:
                return self._corrected(past, time_ns)
            index -= 1
        return None

    def clear(self) -> None:
        """Remove all states: after a rotation too large for sums of small rotations."""
        self._states = [None] * LENGTH

    def _corrected(self, past: PastState, time_ns: int) -> PastState:
        dp, dv, dvt, phi = self._sums
        t = past.time_ns * 1e-9
        ahead = (time_ns - past.time_ns) * 1e-9
        # du = dv_sum - dv_sum_past, v = v_past + du
        du = subtract(dv, past.dv_sum)
        vx, vy, vz = v = add(past.velocity, du)
        # p = p_past + dp_sum - dp_sum_past - ((dv t)_sum - (dv t)_sum_past - t_past du) + v (t_c - t_past)
        position = (
            past.position[0] + dp[0] - past.dp_sum[0] - (dvt[0] - past.dvt_sum[0] - t * du[0]) + vx * ahead,
            past.position[1] + dp[1] - past.dp_sum[1] - (dvt[1] - past.dvt_sum[1] - t * du[1]) + vy * ahead,
            past.position[2] + dp[2] - past.dp_sum[2] - (dvt[2] - past.dvt_sum[2] - t * du[2]) + vz * ahead,
        )
        # turn = phi_sum - phi_sum_past + omega (t_c - t_past): a few corrections and at most one sample, so small
        tx, ty, tz = add(subtract(phi, past.phi_sum), scale(past.rate_world, ahead))
        # R = R_past + [turn]x R_past
        a, b, c, d, e, f, g, h, i = past.rotation
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
        return PastState(time_ns, position, v, rotation, past.rate_world, dp, dv, dvt, phi)
