"""Trajectories: paths with smooth starts, and the path clock.

A path gives position, velocity and acceleration at any path time, so a controller can look ahead. The path clock can
stop and start again (hold) without a jump of the target's velocity.
"""

from collections.abc import Sequence
from math import cos, pi, sin
from typing import Annotated, Final, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from configs.loader import ConfigRecord
from protocol.geometry import Vector3

Positive = Annotated[float, Field(gt=0)]
Coordinate = Annotated[float, Field(ge=-8, le=8, description="m")]
StartPhase = Annotated[float, Field(ge=0, le=1, description="where on the lap the path begins, share of a lap")]
LISSAJOUS_STREAM: Final = 211
FREQUENCY_RATIOS: Final = ((1.6, 1.9), (2.1, 2.4))
"""East frequency by north frequency of a Lissajous path; 2 would be a figure that repeats."""


class PathPoint(NamedTuple):
    """Target at one instant, world NED."""

    position: Vector3
    """m."""
    velocity: Vector3
    """m/s."""
    acceleration: Vector3
    """m/s^2."""


class Hover(ConfigRecord):
    """Hover above the take-off point."""

    kind: Literal["hover"]


class Figure8(ConfigRecord):
    """Lemniscate of Gerono: north A sin(theta), east B/2 sin(2 theta)."""

    kind: Literal["figure8"]
    length_m: Annotated[float, Field(gt=0, le=10, description="north extent, tip to tip")]
    width_m: Annotated[float, Field(gt=0, le=10, description="east extent")]
    period_s: Annotated[float, Field(ge=2, le=120, description="one lap")]
    start_phase: StartPhase = 0.0
    """theta = 2 pi start_phase at the beginning; 0: the centre, northward."""


class Lissajous(ConfigRecord):
    """Path without laps: north A sin(omega_n t + phi_n), east B/2 sin(omega_e t + phi_e); frequencies drawn by seed.

    It has the extent and the RMS speed of a figure-8 with the same three values.
    """

    kind: Literal["lissajous"]
    length_m: Annotated[float, Field(gt=0, le=10, description="north extent, tip to tip")]
    width_m: Annotated[float, Field(gt=0, le=10, description="east extent")]
    period_s: Annotated[float, Field(ge=2, le=120, description="one lap of the figure-8 with the same RMS speed")]
    seed: Annotated[int, Field(ge=0, lt=2**31, description="of frequencies and phases; default: the flight's seed")] = 1


class Circle(ConfigRecord):
    """Circle through the take-off point, its centre to the north."""

    kind: Literal["circle"]
    radius_m: Annotated[float, Field(gt=0, le=8)]
    period_s: Annotated[float, Field(ge=2, le=120, description="one lap")]
    start_phase: StartPhase = 0.0
    """0: the take-off point, eastward."""


class Waypoints(ConfigRecord):
    """Straight legs between points relative to the hover point, each flown rest to rest with a smooth profile."""

    kind: Literal["waypoints"]
    points_m: Annotated[tuple[tuple[Coordinate, Coordinate, Coordinate], ...], Field(min_length=1, max_length=64)]
    """North, east, down from the hover point."""
    speed_m_s: Annotated[float, Field(gt=0, le=5, description="mean speed along a leg")]
    wait_s: Annotated[float, Field(ge=0, le=60, description="rest at each point")]


class TrajectoryConfig(ConfigRecord):
    """Take-off, hover, path, landing."""

    path: Annotated[Hover | Figure8 | Lissajous | Circle | Waypoints, Field(discriminator="kind")]
    altitude_m: Annotated[float, Field(ge=0.3, le=8)]
    takeoff_s: Annotated[float, Field(ge=1, le=30)]
    settle_s: Annotated[float, Field(ge=0, le=60, description="hover between take-off and path")]
    ramp_s: Annotated[float, Field(ge=0, le=60, description="time in which a periodic path reaches its speed")]
    landing_speed_m_s: Annotated[float, Field(gt=0.05, le=1)]
    yaw_rad: Annotated[float, Field(ge=-pi, le=pi)]

    @model_validator(mode="after")
    def _start_is_smooth(self) -> Self:
        path = self.path
        off_centre = isinstance(path, Lissajous) or (isinstance(path, Figure8 | Circle) and path.start_phase > 0.0)
        if off_centre and self.ramp_s <= 0.0:
            what = "a lissajous path" if isinstance(path, Lissajous) else "a path with a start_phase"
            raise ValueError(f"ramp_s {self.ramp_s:g}: expected more than 0, because {what} starts off centre")
        return self


def smooth_step(s: float) -> tuple[float, float, float]:
    """Quintic 0..1 with zero velocity and acceleration at both ends; value, first and second derivative in s."""
    if s <= 0.0:
        return 0.0, 0.0, 0.0
    if s >= 1.0:
        return 1.0, 0.0, 0.0
    s2 = s * s
    return (
        s2 * s * (10.0 + s * (-15.0 + 6.0 * s)),
        30.0 * s2 * (1.0 + s * (-2.0 + s)),
        60.0 * s * (1.0 + s * (-3.0 + 2.0 * s)),
    )


class Path:
    """A path relative to the point where the vehicle took off, as a pure function of path time."""

    def __init__(self, config: TrajectoryConfig) -> None:
        self._config = config
        self._start_s = config.takeoff_s + config.settle_s
        self._height_m, self._takeoff_s, self._ramp_s = config.altitude_m, config.takeoff_s, config.ramp_s
        path = config.path
        self._legs = _legs(path) if isinstance(path, Waypoints) else ()
        # Stored once: a failed isinstance of a pydantic record costs more than the whole path.
        self._figure8 = path if isinstance(path, Figure8) else None
        self._circle = path if isinstance(path, Circle) else None
        self._lissajous = swings(path) if isinstance(path, Lissajous) else None
        periodic = path if isinstance(path, Figure8 | Circle) else None
        self._omega = 2.0 * pi / periodic.period_s if periodic else 0.0
        self._theta = 2.0 * pi * periodic.start_phase if periodic else 0.0
        self._begin = self._begin_of_path()

    @property
    def start_s(self) -> float:
        """Path time at which the path begins, after take-off and settling."""
        return self._start_s

    @property
    def lap_s(self) -> float:
        """Period of one lap, s; 0 for a path without laps."""
        path = self._config.path
        return path.period_s if isinstance(path, Figure8 | Circle) else 0.0

    @property
    def window_s(self) -> float:
        """Length of the windows of a flight's metrics, s: one lap, or as long on a lissajous path; 0 for none."""
        path = self._config.path
        return path.period_s if isinstance(path, Lissajous) else self.lap_s

    def laps_from_s(self) -> float:
        """Path time at which the first lap at full speed begins."""
        return self._start_s + self._config.ramp_s

    def lap_phase(self, t: float) -> float:
        """Share of the lap flown at path time t, in [0, 1); -1 before the first full lap and on a path without laps."""
        since, lap_s = t - self.laps_from_s(), self.lap_s
        return since / lap_s % 1.0 if lap_s > 0.0 and since >= 0.0 else -1.0

    def at(self, t: float) -> PathPoint:
        """Target at path time t [s], relative to the take-off point on the floor."""
        d, vd, ad = self._rise(t)
        since = t - self._start_s
        if since > 0.0:
            if self._figure8 is not None:
                th, th1, th2 = _phase(since, self._omega, self._ramp_s)
                point = _figure8(self._figure8, self._theta + th, th1, th2, d, vd, ad)
                return point if self._begin is None else _approach(point, self._begin, since, self._ramp_s)
            if self._lissajous is not None:
                (north, v_n, a_n), (east, v_e, a_e) = (_swing(one, since, self._ramp_s) for one in self._lissajous)
                return PathPoint((north, east, d), (v_n, v_e, vd), (a_n, a_e, ad))
            if self._circle is not None:
                th, th1, th2 = _phase(since, self._omega, self._ramp_s)
                point = _circle(self._circle, self._theta + th, th1, th2, d, vd, ad)
                return point if self._begin is None else _approach(point, self._begin, since, self._ramp_s)
            if self._legs:
                p, v, a = _along_legs(self._legs, since)
                return PathPoint((p[0], p[1], p[2] + d), (v[0], v[1], v[2] + vd), (a[0], a[1], a[2] + ad))
        return PathPoint((0.0, 0.0, d), (0.0, 0.0, vd), (0.0, 0.0, ad))

    def _begin_of_path(self) -> tuple[float, float] | None:
        """Where the path begins, north and east of the take-off point, m; None: there."""
        if self._theta == 0.0:
            return None
        still = (self._theta, 0.0, 0.0, 0.0, 0.0, 0.0)
        if self._figure8 is not None:
            return _figure8(self._figure8, *still).position[:2]
        assert self._circle is not None
        return _circle(self._circle, *still).position[:2]

    def _rise(self, t: float) -> Vector3:
        """Take-off: down, its rate and its acceleration."""
        height, takeoff_s = self._height_m, self._takeoff_s
        if t >= takeoff_s:
            return -height, 0.0, 0.0
        rise, rise_1, rise_2 = smooth_step(t / takeoff_s)
        return -height * rise, -height * rise_1 / takeoff_s, -height * rise_2 / takeoff_s**2


def _phase(t: float, omega: float, ramp_s: float) -> tuple[float, float, float]:
    """Phase angle, rate and acceleration: the rate rises from 0 to omega over ramp_s along a smooth step."""
    if ramp_s <= 0.0:
        return omega * t, omega, 0.0
    s = t / ramp_s
    if s >= 1.0:
        return omega * (t - 0.5 * ramp_s), omega, 0.0
    value, first, _ = smooth_step(s)
    s4 = s**4
    integral = s4 * (2.5 + s * (-3.0 + s))
    return omega * ramp_s * integral, omega * value, omega * first / ramp_s


def _figure8(path: Figure8, th: float, th1: float, th2: float, d: float, vd: float, ad: float) -> PathPoint:
    A, B = 0.5 * path.length_m, 0.5 * path.width_m
    s, c, s2, c2 = sin(th), cos(th), sin(2.0 * th), cos(2.0 * th)
    return PathPoint(
        (A * s, B * s2, d),
        (A * c * th1, 2.0 * B * c2 * th1, vd),
        (A * (c * th2 - s * th1 * th1), B * (2.0 * c2 * th2 - 4.0 * s2 * th1 * th1), ad),
    )


def _circle(path: Circle, th: float, th1: float, th2: float, d: float, vd: float, ad: float) -> PathPoint:
    R = path.radius_m
    s, c = sin(th), cos(th)
    return PathPoint(
        (R * (1.0 - c), R * s, d),
        (R * s * th1, R * c * th1, vd),
        (R * (s * th2 + c * th1 * th1), R * (c * th2 - s * th1 * th1), ad),
    )


def _approach(point: PathPoint, begin: tuple[float, float], t: float, ramp_s: float) -> PathPoint:
    """The point, moved by what is left of the way to the path's beginning; it shrinks to 0 over ramp_s smoothly."""
    s = t / ramp_s
    if s >= 1.0:
        return point
    share, rise, change = smooth_step(s)
    left, rise, change = 1.0 - share, rise / ramp_s, change / ramp_s**2
    north, east = begin
    p, v, a = point
    return PathPoint(
        (p[0] - left * north, p[1] - left * east, p[2]),
        (v[0] + rise * north, v[1] + rise * east, v[2]),
        (a[0] + change * north, a[1] + change * east, a[2]),
    )


class Swing(NamedTuple):
    """A harmonic motion along one axis."""

    amplitude_m: float
    omega_rad_s: float
    phase_rad: float


def swings(path: Lissajous) -> tuple[Swing, Swing]:
    """Draw the north and the east motion of a Lissajous path from its seed."""
    rng = np.random.default_rng([path.seed, LISSAJOUS_STREAM])
    ratio = float(rng.uniform(*FREQUENCY_RATIOS[int(rng.integers(2))]))
    north_rad, east_rad = rng.uniform(-pi, pi, 2).tolist()
    A, B = 0.5 * path.length_m, 0.5 * path.width_m
    omega = 2.0 * pi / path.period_s * ((A * A + 4.0 * B * B) / (A * A + ratio * ratio * B * B)) ** 0.5
    return Swing(A, omega, north_rad), Swing(B, ratio * omega, east_rad)


def _swing(swing: Swing, t: float, ramp_s: float) -> Vector3:
    """Position, velocity and acceleration along one axis; the amplitude grows over ramp_s along a smooth step."""
    A, omega, phase = swing
    p, v = A * sin(omega * t + phase), A * omega * cos(omega * t + phase)
    share, rise, change = smooth_step(t / ramp_s)
    rise, change = rise / ramp_s, change / ramp_s**2
    return share * p, rise * p + share * v, change * p + 2.0 * rise * v - share * omega * omega * p


Leg = tuple[float, float, Vector3, Vector3]
"""Start time, moving time, start point, displacement."""


def _legs(path: Waypoints) -> tuple[Leg, ...]:
    legs: list[Leg] = []
    here: Vector3 = (0.0, 0.0, 0.0)
    t = 0.0
    for point in path.points_m:
        step = (point[0] - here[0], point[1] - here[1], point[2] - here[2])
        moving = max(sum(x * x for x in step) ** 0.5 / path.speed_m_s, 0.1)
        legs.append((t, moving, here, step))
        t += moving + path.wait_s
        here = point
    return tuple(legs)


def _along_legs(legs: Sequence[Leg], t: float) -> tuple[Vector3, Vector3, Vector3]:
    start, moving, origin, step = next(leg for leg in reversed(legs) if t >= leg[0])
    value, first, second = smooth_step((t - start) / moving)
    first, second = first / moving, second / moving**2
    x, y, z = step
    return (
        (origin[0] + x * value, origin[1] + y * value, origin[2] + z * value),
        (x * first, y * first, z * first),
        (x * second, y * second, z * second),
    )


class PathClock:
    """Path time. Its rate changes between 0 and 1 within `ease_s`, so the target's velocity never jumps."""

    def __init__(self, ease_s: float = 1.0) -> None:
        self._ease_s = ease_s
        self._x = 1.0
        self.time_s = 0.0
        self.rate = 1.0
        self.rate_change = 0.0
        """d rate / dt, 1/s."""
        self.stop_s = 0.5 * ease_s
        """Path time that still passes when a running clock is stopped."""

    def step(self, run: bool, dt: float) -> None:
        """Advance by dt [s]; `run`: whether path time runs."""
        target = 1.0 if run else 0.0
        move = dt / self._ease_s
        self._x = min(self._x + move, target) if target > self._x else max(self._x - move, target)
        value, first, _ = smooth_step(self._x)
        moving = self._x != target
        self.rate, self.rate_change = value, (first / self._ease_s * (1.0 if run else -1.0) if moving else 0.0)
        self.time_s += value * dt

    @property
    def steady(self) -> bool:
        """Whether path time runs like real time."""
        return self.rate == 1.0 and self.rate_change == 0.0

    def ahead(self, point: PathPoint) -> PathPoint:
        """The point with derivatives in real time, at the present rate of the clock."""
        r, r1 = self.rate, self.rate_change
        v, a = point.velocity, point.acceleration
        return PathPoint(
            point.position,
            (r * v[0], r * v[1], r * v[2]),
            (r * r * a[0] + r1 * v[0], r * r * a[1] + r1 * v[1], r * r * a[2] + r1 * v[2]),
        )
