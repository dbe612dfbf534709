"""Finds an axis of the gyroscope that is stuck in flight, and replaces its rate by one from the motors' torque.

A gyroscope in flight hardly ever gives the same value twice in a row: the rotors shake it by many times its step. An
axis that repeats its value while the rest of the IMU changes is stuck. From then on its rate is

    rate <- rate + (u_hat + d) dt

with u_hat the angular acceleration by the motors, and d the disturbance: the residual, filtered. The filter holds the
error of this rate as the gyroscope's bias of that axis, with a fast random walk. Poses and flow correct it. Each
correction is part of the residual, so d follows.
"""

from collections import deque
from itertools import islice, pairwise
from typing import Final, NamedTuple

from protocol.geometry import ZERO, Vector3, add, vector

KEPT: Final = 64
"""Samples that are kept. Those before a run of equal ones show how often the axis repeats a value by chance."""
PER_REPEAT: Final = 3
"""Each such repeat makes the run that is needed so much longer."""
REPEATS_MAX: Final = 16
"""An axis with more of them is too quiet to be judged."""


class _Sample(NamedTuple):
    rates: Vector3
    dt: float
    u_hat: Vector3
    """rad/s^2, since the sample before."""
    disturbance: Vector3
    """rad/s^2, known before this sample."""


class Found(NamedTuple):
    """An axis that is stuck."""

    axis: int
    """0 to 2."""
    turn_rad: float
    """About that axis, since it is stuck, beyond the turn by its samples."""


class StuckGyro:
    """Rates of the gyroscope, with those of stuck axes replaced."""

    def __init__(self, samples: int, disturbance_filter_s: float) -> None:
        """`samples`: equal ones in a row that mean stuck; 0: never."""
        self._needed = samples
        self._filter_s = disturbance_filter_s
        self._samples: deque[_Sample] = deque(maxlen=KEPT)
        self._last: tuple[Vector3, Vector3] = (ZERO, ZERO)
        self._runs = [1, 1, 1]
        self._limits = [0, 0, 0]
        self._found: list[int] = []
        self._u_hat: Vector3 = ZERO
        self._disturbance: Vector3 = ZERO
        self._rates = [0.0, 0.0, 0.0]
        self._biases: deque[tuple[float, int, Vector3]] = deque(maxlen=KEPT)
        self.axes: list[int] = []
        """The axes that are stuck, 0 to 2."""

    def reset(self) -> None:
        """Believe the gyroscope again: on the floor the checks before arming judge it."""
        self._biases.clear()
        self.axes = []

    def expect(self, u_hat: Vector3, residual: Vector3, dt: float) -> None:
        """The motors' angular acceleration over the last `dt`, and what it left unexplained, rad/s^2, body FRD."""
        self._u_hat, share = u_hat, dt / (self._filter_s + dt)
        (dx, dy, dz), (rx, ry, rz) = self._disturbance, residual
        if self._found:  # the rate jumps to the new one, which is no disturbance
            rx, ry, rz = (
                d if axis in self._found else r for axis, (r, d) in enumerate(zip(residual, (dx, dy, dz), strict=True))
            )
            self._found = []
        self._disturbance = (dx + share * (rx - dx), dy + share * (ry - dy), dz + share * (rz - dz))

    def receive(self, rates: Vector3, accelerometer: Vector3, dt: float, flying: bool = True) -> list[Found]:
        """Add a sample, rad/s and m/s^2; returns the axes that are found stuck by it, in flight only."""
        self._samples.append(_Sample(rates, dt, self._u_hat, self._disturbance))
        for axis in self.axes:
            self._rates[axis] += (self._u_hat[axis] + self._disturbance[axis]) * dt
        (p, q, r), (last_p, last_q, last_r) = rates, self._last[0]
        found = []
        if flying and (p == last_p or q == last_q or r == last_r):
            found = self._judge(rates, accelerometer)
        elif self._runs != [1, 1, 1]:
            self._runs = [1, 1, 1]
        self._last = rates, accelerometer
        return found

    def replaced(self, rates: Vector3) -> Vector3:
        """The rates of a sample, rad/s, with those of stuck axes replaced."""
        if not self.axes:
            return rates
        return vector(self._rates[axis] if axis in self.axes else rates[axis] for axis in (0, 1, 2))

    def note_bias(self, bias: Vector3, time_ns: int, dt: float) -> None:
        """The filter's bias, which a sample has been integrated with."""
        self._biases.append((dt, time_ns, bias))

    def turn_since(self, time_ns: int, bias: Vector3) -> Vector3:
        """The turn that the present bias, had it been known, would have added since `time_ns`; rad, body FRD."""
        x, y, z = 0.0, 0.0, 0.0
        for dt, then_ns, (bx, by, bz) in reversed(self._biases):
            if then_ns <= time_ns:
                break
            x, y, z = x + (bx - bias[0]) * dt, y + (by - bias[1]) * dt, z + (bz - bias[2]) * dt
        return x, y, z

    def _judge(self, rates: Vector3, accelerometer: Vector3) -> list[Found]:
        """Count the samples in a row that are equal; the axes that are found stuck by this one."""
        if (rates, accelerometer) == self._last:  # the whole IMU repeats: the vehicle's link judges that
            self._runs = [1, 1, 1]
            return []
        found = []
        for axis in (0, 1, 2):
            if rates[axis] != self._last[0][axis]:
                self._runs[axis] = 1
                continue
            self._runs[axis] += 1
            if self._runs[axis] == self._needed:
                self._limits[axis] = self._limit(axis)
            if self._runs[axis] == self._limits[axis]:
                found.append(self._replace(axis))
        return found

    def _limit(self, axis: int) -> int:
        """The run that means stuck, samples; 0: none does."""
        if axis in self.axes or len(self._samples) < KEPT:
            return 0
        before = (sample.rates[axis] for sample in islice(self._samples, KEPT - self._needed))
        repeats = sum(first == second for first, second in pairwise(before))
        return self._needed + PER_REPEAT * repeats if repeats <= REPEATS_MAX else 0

    def _replace(self, axis: int) -> Found:
        """Begin with the last rate before the run, and add the motors' turn since then."""
        run = list(self._samples)[-self._runs[axis] - 1 :]
        rate, turn, disturbance = run[0].rates[axis], 0.0, run[0].disturbance
        for sample in run[1:]:
            rate += add(sample.u_hat, disturbance)[axis] * sample.dt
            turn += (rate - sample.rates[axis]) * sample.dt
        kept = list(self._disturbance)
        kept[axis] = disturbance[axis]
        self._disturbance = vector(kept)
        self._rates[axis] = rate
        self.axes = [*self.axes, axis]
        self._found.append(axis)
        return Found(axis, turn)
