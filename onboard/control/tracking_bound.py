"""A live bound on the tracking error of both channels, m and rad, for every law of the cascade (docs/theory.md).

The tracking error d of an axis obeys, whatever law and limits did,

    d_ddot + 2 zeta omega d_dot + omega^2 d = w = nu_cmd - Delta + (u - u_hat) + (a_d - a_ff),

with u the demand of the law at the present state without its limits. The gains are in both sides, so w is computed as
a_d - u_hat - Delta + 2 zeta omega d_dot + omega^2 d: the same number, without nu_cmd. Its absolute value passes a
positive majorant of the impulse response h1(t) of the left side. Delta_hat stands for Delta; that is why the bound is a
measured one. It is filtered from the rate of change of the estimated velocity and body rates minus u_hat: the
velocity's includes the corrections by poses, without which an error of the estimated tilt would be missing.

In the attitude channel a_d is the acceleration of the commanded attitude, which is noise differentiated twice. The
response s to it is known exactly with its sign, so it is computed apart: bound = |s| + majorant of the rest. In the
rest, what is fed forward (omega_d, alpha_d) takes its place.
"""

from math import exp, sqrt
from typing import Final, NamedTuple

from onboard.control.command_motion import CommandMotion
from onboard.control.records import ControlInputs, ControlOutput
from onboard.control.reference_model import ChannelGains
from protocol.geometry import quaternion_multiply, quaternion_to_rotation_vector

RESIDUAL_FILTER_S: Final = 0.02
"""T of Delta_hat = (2 F - F^2) r, F = 1 / (1 + T s): no lag for a Delta that changes steadily. Not a tuned value."""
ESTIMATE_SIGMAS: Final = 2.0
"""Standard deviations of the estimated position that are added to the bound."""
SPREAD: Final = 0.9
OVERSHOOT: Final = 1.28
"""sin x <= OVERSHOOT (1 - exp(-SPREAD x)) / SPREAD for x >= 0: the majorant of an oscillating response."""


class Majorant(NamedTuple):
    """gain (exp(-slow t) - exp(-fast t)) / (fast - slow) >= |h1(t)|; gain t exp(-slow t) for equal poles."""

    fast: float
    """1/s."""
    slow: float
    """1/s."""
    gain: float


def majorant(omega: float, zeta: float) -> Majorant:
    """The majorant of h1 of one axis: h1 itself for zeta >= 1, else the one of two forms with the smaller integral."""
    if zeta >= 1.0:
        root = sqrt(zeta * zeta - 1.0)
        return Majorant(omega * (zeta + root), omega * (zeta - root), 1.0)
    decay, ripple = zeta * omega, omega * sqrt(1.0 - zeta * zeta)
    spread = Majorant(decay + SPREAD * ripple, decay, OVERSHOOT)
    equal = Majorant(decay, decay, 1.0)
    return min(spread, equal, key=lambda one: one.gain / (one.fast * one.slow))


class AxisBound:
    """The bound of one axis: |d| in m or rad, w in units of u. Its state is seven numbers."""

    __slots__ = (
        *("_feed1", "_feed2", "_keep1", "_keep2", "_majorant", "_once", "_pass2", "_pull", "_response"),
        *("_response_rate", "_share", "_twice", "_z1", "_z2", "k1", "k2"),
    )

    def __init__(self, omega: float, zeta: float) -> None:
        """Poles of the axis, rad/s and 1. Call `prepare` before the first step."""
        self.k1, self.k2 = omega * omega, 2.0 * zeta * omega
        self._majorant = majorant(omega, zeta)
        self._z1 = self._z2 = 0.0
        self._once = self._twice = 0.0
        """The residual through F, and through F twice; Delta_hat = 2 once - twice."""
        self._pull = 0.0
        """a_d + k1 d + k2 d_rate of the last tick."""
        self._response = self._response_rate = 0.0
        """s: error of an undisturbed loop that follows the command, and the rate of that loop's x."""

    def prepare(self, dt: float) -> None:
        """Set the period, s. The steps are exact for |w| constant over it."""
        p1, p2, gain = self._majorant
        a1, a2 = exp(-p1 * dt), exp(-p2 * dt)
        self._keep1, self._feed1 = a1, gain * (1.0 - a1) / p1
        self._keep2, self._pass2 = a2, dt * a2 if p1 - p2 < 1e-6 * p1 else (a2 - a1) / (p1 - p2)
        self._feed2 = gain * ((1.0 - a2) / p2 - self._pass2) / p1
        self._share = 1.0 - exp(-dt / RESIDUAL_FILTER_S)

    def forget(self) -> None:
        """Set Delta_hat to zero."""
        self._once = self._twice = 0.0

    def restart(self, a_d: float, d: float, d_rate: float) -> float:
        """Start from a known error and its rate, with a command at rest; returns |d|."""
        self._pull = a_d + self.k1 * d + self.k2 * d_rate
        self._z1 = self._majorant.gain * abs(d_rate + self._majorant.slow * d)
        self._z2 = abs(d)
        self._response = self._response_rate = 0.0
        return self._z2

    def step(self, a_d: float, u_hat: float, residual: float, d: float, d_rate: float) -> float:
        """The bound after one period, with w = a_d - u_hat - Delta_hat + k1 d + k2 d_rate.

        u_hat and the residual are means over the period, the others its end; w takes their mean with its start.
        """
        self._once = once = self._once + self._share * (residual - self._once)
        self._twice = twice = self._twice + self._share * (once - self._twice)
        before, self._pull = self._pull, a_d + self.k1 * d + self.k2 * d_rate
        size = abs(0.5 * (before + self._pull) - u_hat - 2.0 * once + twice)
        self._z2 = z2 = self._keep2 * self._z2 + self._pass2 * self._z1 + self._feed2 * size
        self._z1 = self._keep1 * self._z1 + self._feed1 * size
        return z2

    def respond(self, turn: float, omega_d: float, alpha_d: float, dt: float) -> float:
        """s after one period at whose end the command turns, rad: an error at once."""
        s, rate = self._response, self._response_rate
        alpha = self.k1 * s - self.k2 * (rate - omega_d) + alpha_d
        self._response = s = s - dt * (rate + 0.5 * dt * alpha) + turn
        self._response_rate = rate + dt * alpha
        return s


def _axes(gains: ChannelGains) -> tuple[AxisBound, AxisBound, AxisBound]:
    x, y, z = (AxisBound(*one) for one in zip(gains.natural_frequency_rad_s, gains.damping, strict=True))
    return x, y, z


class TrackingBounds:
    """The live bounds of both channels. They start anew whenever the laws do not adapt."""

    def __init__(self, position: ChannelGains, attitude: ChannelGains) -> None:
        self._position, self._attitude = _axes(position), _axes(attitude)
        self._period = 0.0
        self._running = False
        self._resets_seen = 0
        self._velocity = [0.0, 0.0, 0.0]

    def reset(self) -> None:
        """Start anew at the next step."""
        self._running = False

    def step(self, inputs: ControlInputs, output: ControlOutput, motion: CommandMotion) -> None:
        """Write the bounds of this tick into the telemetry, 0 while the laws do not adapt.

        Parameters
        ----------
        output: with the commanded attitude of this tick.
        motion: of the commanded attitude, and what of it is fed forward.
        """
        if not inputs.adapt:
            self._running = False
            output.position.tracking_bound = output.attitude.tracking_bound = 0.0
            return
        restart = not self._running or inputs.missed > 0 or inputs.state.position_reset_count != self._resets_seen
        if not self._running or inputs.period != self._period:
            self._start(inputs.period)
        self._resets_seen = inputs.state.position_reset_count
        output.position.tracking_bound = self._position_bound(inputs, restart)
        output.attitude.tracking_bound = self._attitude_bound(inputs, output, motion, restart)

    def _start(self, period: float) -> None:
        self._running, self._period = True, period
        for axis in (*self._position, *self._attitude):
            axis.forget()
            axis.prepare(period)

    def _position_bound(self, inputs: ControlInputs, restart: bool) -> float:
        """Bound on the true distance to the path, m: that of the estimate, and what the estimate may be off."""
        state, (place, speed, a_d) = inputs.state, inputs.target.path
        p, v, u_hat = state.position.tolist(), state.velocity.tolist(), inputs.position.u_hat.tolist()
        before, self._velocity = self._velocity, v
        squared = 0.0
        for i, axis in enumerate(self._position):
            d, d_rate, u = place[i] - p[i], speed[i] - v[i], u_hat[i]
            if restart:
                bound = axis.restart(a_d[i], d, d_rate)
            else:
                bound = axis.step(a_d[i], u, (v[i] - before[i]) / inputs.dt - u, d, d_rate)
            squared += bound * bound
        return sqrt(squared) + ESTIMATE_SIGMAS * state.position_sigma_m

    def _attitude_bound(
        self, inputs: ControlInputs, output: ControlOutput, motion: CommandMotion, restart: bool
    ) -> float:
        """Bound on the angle between the vehicle and the commanded attitude, rad; axes: body FRD."""
        w, x, y, z = inputs.state.quaternion.tolist()
        e = quaternion_to_rotation_vector(quaternion_multiply((w, -x, -y, -z), output.commanded_quaternion))
        rates, dt = inputs.state.rates.tolist(), inputs.dt
        u_hat, residual = inputs.attitude.u_hat.tolist(), inputs.attitude.residual.tolist()
        turn, omega_d, alpha_d = motion.turn, motion.omega_d, motion.alpha_d
        squared = 0.0
        for i, axis in enumerate(self._attitude):
            if restart:
                bound = axis.restart(0.0, e[i], -rates[i])
            else:
                bound = abs(axis.respond(turn[i], omega_d[i], alpha_d[i], dt))
                bound += axis.step(alpha_d[i], u_hat[i], residual[i], e[i], omega_d[i] - rates[i])
            squared += bound * bound
        return sqrt(squared)
