"""The test of a map before it flies, on the states of the last second and on a box around the path ahead.

The box holds what the vehicle can reach within `reach_s`: each signal by its rate now and what it can change beside it.
The path ahead is a line through it, with points so close that no cliff lies between two of them unseen. Tested:

- **misfit**: theta'Phi against the residual at the states of the last second, root mean square, against the size of the
  residual itself. A map that does not know what has just been measured is not believed about what comes.
- **bound**: norm(theta) norm(Phi), row of the constant apart, bounds how much the map can vary anywhere in the world.
- **spread**: the largest change of theta'Phi from here to a state of the box.
- **slope along the path**: change from point to point over the distance, as a share of its limit (a steep map is
  feedback: onboard.control.slope, which owns the limits). By differences, so that a cliff counts that is
  narrower than the points are apart.
- **slope in the box and over the last second**, the derivative, as a share of its limit.

theta of law (2a), whose nu_cmd fades to it where nothing was measured; W of law (2).

The states ahead are looked at in parts, one a tick (`Ahead`): first the slopes in a box of then, which takes long, and
then the map on the path and in a box of now. What has been seen by the last part was in reach some 0.1 s before; the
box reaches farther than that.
"""

from typing import Annotated, Final

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.features import Features, NetworkFeatures, halton
from onboard.control.slope import PLACE, SlopeLimits, largest_shares
from protocol.conventions import Array
from protocol.signals import SIGNAL_INDEX

Size = Annotated[float, Field(gt=0, le=1e4)]
BOX_SLOPES_PER_PART: Final = 1
"""States of the box whose slope one part looks at, of a version that is to fly."""
AHEAD_PER_PART: Final = 4
"""States ahead at which one part evaluates the map of such a version."""
CHECKED_PER_PART: Final = 3
"""The same of the map that flies."""
BOX_POINTS: Final = 32
BOX_AXES: Final = 15
PATH_POINTS: Final = 16
STEP_MIN_M: Final = 0.03
"""Least distance of two points of the path, for a vehicle at rest."""
PLACES: Final = slice(SIGNAL_INDEX["position_n"], SIGNAL_INDEX["position_n"] + 3)
VELOCITIES: Final = slice(SIGNAL_INDEX["velocity_n"], SIGNAL_INDEX["velocity_n"] + 3)
CORNERS: Final = 2.0 * halton(BOX_POINTS, BOX_AXES).T - 1.0
"""[BOX_AXES, n], of the unit box: places, velocities, angles, body velocities, motor thrusts alike."""


class VersionTestConfig(ConfigRecord):
    """Limits of the test. Pairs: position channel, attitude channel."""

    enabled: Annotated[bool, Field(description="false: ablation")] = True
    reach_s: Annotated[float, Field(gt=0, le=5, description="s, the box is what can be reached in this time")] = 0.4
    check_s: Annotated[
        float, Field(gt=0, le=5, description="s, between two checks of the map that flies, on its box of then")
    ] = 0.1
    acceleration_m_s2: Annotated[float, Field(gt=0, le=50, description="m/s^2, by which the path may turn away")] = 3.0
    misfit: Annotated[float, Field(gt=0, le=10, description="of the map, over the size of the residual")] = 1.3
    misfit_floor: Annotated[tuple[Size, Size], Field(description="plus this, units of u")] = (2.0, 40.0)
    bound_max: Annotated[tuple[Size, Size], Field(description="norm(theta) norm(Phi), units of u")] = (30.0, 350.0)
    spread_max: Annotated[tuple[Size, Size], Field(description="largest change in the box, units of u")] = (10.0, 160.0)
    path_slope: Annotated[tuple[Size, Size], Field(description="along the path, share of its limit")] = (1.0, 1.0)
    box_slope: Annotated[tuple[Size, Size], Field(description="over the states, share of its limit")] = (2.0, 2.0)


def ahead(config: VersionTestConfig, now: Array) -> tuple[Array, Array]:
    """States [SIGNAL_COUNT, PATH_POINTS] on the line ahead, from here on, and [SIGNAL_COUNT, BOX_POINTS] in the box."""
    h, velocity = config.reach_s, now[VELOCITIES]
    speed = float(np.linalg.norm(velocity))
    forward = velocity / speed if speed > 0.0 else np.array([1.0, 0.0, 0.0])
    length = max(speed * h, STEP_MIN_M * (PATH_POINTS - 1))
    line, box = np.repeat(now[:, None], PATH_POINTS, axis=1), np.repeat(now[:, None], BOX_POINTS, axis=1)
    line[PLACES] += forward[:, None] * np.linspace(0.0, length, PATH_POINTS)
    turn = config.acceleration_m_s2 * h
    box[PLACES] += 0.5 * h * velocity[:, None] + (0.5 * h * (np.abs(velocity) + turn))[:, None] * CORNERS[:3]
    box[VELOCITIES] += turn * CORNERS[3:6]
    for first, size, rows in (("roll", 0.2, 6), ("body_velocity_x", turn, 9)):
        box[SIGNAL_INDEX[first] : SIGNAL_INDEX[first] + 3] += size * CORNERS[rows : rows + 3]
    motors = slice(SIGNAL_INDEX["motor_thrust_1"], SIGNAL_INDEX["motor_thrust_1"] + 4)
    box[motors] *= 1.0 + 0.5 * CORNERS[[12, 13, 14, 12]]
    return line, box


class Ahead:
    """A map on the path and the box ahead, in parts."""

    def __init__(self, config: VersionTestConfig, limits: SlopeLimits) -> None:
        self._config, self._limits = config, limits
        self._place_limit = next(limit for names, limit in limits.groups if names == PLACE)
        self._states: Array = np.zeros((0, PATH_POINTS + BOX_POINTS))
        self._nu: Array = np.zeros((3, PATH_POINTS + BOX_POINTS))
        self._seen, self._sloped, self._over = 0, 0, 0.0

    def begin(self, now: Array) -> None:
        """Start at the present state, [SIGNAL_COUNT]. What `steepest` has found stays."""
        self._states = np.hstack(ahead(self._config, now))
        self._seen = 0

    def begin_slopes(self, now: Array) -> None:
        """Start with the slopes in the box of the present state."""
        self.begin(now)
        self._sloped, self._over = 0, 0.0

    def steepest(self, features: Features, theta: Array, most: int) -> bool:
        """The slope of theta'Phi, theta [k, 3], at so many states of the box; whether all are done."""
        first = PATH_POINTS + self._sloped
        if isinstance(features, NetworkFeatures):
            states = self._states[:, first : first + most]
            shares = largest_shares(features.channel, theta, self._limits, states)
            self._over = float(np.maximum(self._over, shares.max()))
        self._sloped += most
        return self._sloped >= BOX_POINTS

    def step(self, features: Features, theta: Array, most: int) -> bool:
        """The map at so many states; whether all have been seen."""
        states = self._states[:, self._seen : self._seen + most]
        self._nu[:, self._seen : self._seen + most] = theta.T @ features.evaluate(features.select(states))
        self._seen += most
        return self._seen >= PATH_POINTS + BOX_POINTS

    def found(self) -> tuple[float, float, float]:
        """The largest change from here, the slope along the path and that over the states, as shares of their limits.

        NaN if the map is not finite.
        """
        nu, path = self._nu, self._states[PLACES, :2]
        spread = float(np.abs(nu - nu[:, :1]).max())
        apart = float(np.linalg.norm(path[:, 1] - path[:, 0]))
        steps = np.abs(np.diff(nu[:, :PATH_POINTS], axis=1)).max(axis=1) / apart
        return spread, float((steps / self._place_limit).max()), self._over

    def change_to(self, nu: Array) -> float:
        """The largest change of the map from here to where it is nu [3, n]."""
        return float(np.abs(nu - self._nu[:, :1]).max()) if nu.shape[1] else 0.0


class VersionTest:
    """The test of one channel's maps."""

    def __init__(self, config: VersionTestConfig, channel: int, limits: SlopeLimits) -> None:
        self._config, self._slope_limits = config, limits
        self._limits = config.bound_max[channel], config.spread_max[channel]
        self._slopes = config.path_slope[channel], config.box_slope[channel]
        self._misfit_floor = config.misfit_floor[channel]
        self.ahead, self._look = Ahead(config, limits), Ahead(config, limits)
        self.looks = False
        """Whether the map that flies is being checked."""
        self.found: tuple[float, ...] = (0.0,) * 5
        """Bound, spread, slope along the path, slope over the box, misfit over what is allowed, of the last test."""

    def refusal(self, features: Features, theta: Array, now: Array, recent: Array, residuals: Array) -> str:
        """The refusal (protocol.messages.REFUSALS) of a map theta'Phi, theta [k, 3], before it flies; "" for none.

        All parts at once.

        Parameters
        ----------
        now: [SIGNAL_COUNT], the present state.
        recent: [SIGNAL_COUNT, n], those of the last second. residuals: [n, 3], measured there.
        """
        self.ahead.begin_slopes(now)
        self.ahead.steepest(features, theta, BOX_POINTS)
        self.ahead.step(features, theta, PATH_POINTS + BOX_POINTS)
        over = 0.0
        if isinstance(features, NetworkFeatures):
            over = float(largest_shares(features.channel, theta, self._slope_limits, recent).max())
        Phi = features.evaluate(features.select(recent))
        return self.verdict(theta, Phi, residuals, over)

    def verdict(self, theta: Array, Phi: Array, residuals: Array, over: float) -> str:
        """The refusal, once `ahead` has seen all states.

        Parameters
        ----------
        Phi: [k, n], features of the recent states. residuals: [n, 3], measured there.
        over: the largest slope at the recent states, share of its limit.
        """
        nu = theta.T @ Phi
        spread, along, box = self.ahead.found()
        spread, over = float(np.maximum(spread, self.ahead.change_to(nu))), float(np.maximum(over, box))
        size = float(np.linalg.norm(theta[:-1], axis=0).max()) * (theta.shape[0] - 1) ** 0.5
        misfit = self._misfit(nu.T, residuals)
        self.found = size, spread, along, over, misfit
        if misfit > 1.0:
            return "misfit"
        if size > self._limits[0] or spread > self._limits[1]:
            return "reach"
        return "slope" if along > self._slopes[0] or over > self._slopes[1] else ""

    def look(self, features: Features, theta: Array, now: Array) -> bool | None:
        """One part of a check of the map that flies, on what is ahead; after the last one whether it is good."""
        if not self.looks:
            self._look.begin(now)
        self.looks = not self._look.step(features, theta, CHECKED_PER_PART)
        if self.looks:
            return None
        spread, along, _ = self._look.found()
        self.found = 0.0, spread, along, 0.0, 0.0
        return spread <= self._limits[1] and along <= self._slopes[0]

    def _misfit(self, nu: Array, residuals: Array) -> float:
        """Misfit over the last second, as a share of what is allowed. nu, residuals: [n, 3]."""
        if nu.shape[0] == 0:
            return 0.0
        sizes = [float(np.sqrt(np.square(one).sum(axis=1).mean())) for one in (nu - residuals, residuals)]
        return sizes[0] / (self._config.misfit * sizes[1] + self._misfit_floor)
