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
- **slope over the box and the last second**, the derivative, as a share of its limit.

theta of law (2a), whose nu_cmd fades to it where nothing was measured; W of law (2).
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


class VersionTest:
    """The test of one channel's maps."""

    def __init__(self, config: VersionTestConfig, channel: int, limits: SlopeLimits) -> None:
        self._config, self._slope_limits = config, limits
        self._limits = config.bound_max[channel], config.spread_max[channel]
        self._slopes = config.path_slope[channel], config.box_slope[channel]
        self._place_limit = next(limit for names, limit in limits.groups if names == PLACE)
        self._misfit_floor = config.misfit_floor[channel]
        self.found: tuple[float, ...] = (0.0,) * 5
        """Bound, spread, slope along the path, slope over the box, misfit over what is allowed, of the last test."""

    def refusal(self, features: Features, theta: Array, now: Array, recent: Array, residuals: Array) -> str:
        """The refusal (protocol.messages.REFUSALS) of a map theta'Phi, theta [k, 3], before it flies; "" for none.

        Parameters
        ----------
        now: [SIGNAL_COUNT], the present state.
        recent: [SIGNAL_COUNT, n], those of the last second. residuals: [n, 3], measured there.
        """
        path, box = ahead(self._config, now)
        spread, along = self._reach(features, theta, path, np.hstack([recent, box]))
        size = float(np.linalg.norm(theta[:-1], axis=0).max()) * (theta.shape[0] - 1) ** 0.5
        over = 0.0
        if isinstance(features, NetworkFeatures):
            over = float(
                largest_shares(features.channel, theta, self._slope_limits, np.hstack([path, box, recent])).max()
            )
        misfit = self._misfit(features, theta, recent, residuals)
        self.found = size, spread, along, over, misfit
        if misfit > 1.0:
            return "misfit"
        if size > self._limits[0] or spread > self._limits[1]:
            return "reach"
        return "slope" if along > self._slopes[0] or over > self._slopes[1] else ""

    def still_good(self, features: Features, theta: Array, now: Array) -> bool:
        """Whether the map that flies passes on the path and the box ahead of here."""
        path, box = ahead(self._config, now)
        spread, along = self._reach(features, theta, path, box)
        self.found = 0.0, spread, along, 0.0, 0.0
        return spread <= self._limits[1] and along <= self._slopes[0]

    def _misfit(self, features: Features, theta: Array, recent: Array, residuals: Array) -> float:
        """Misfit over the last second, as a share of what is allowed."""
        if recent.shape[1] == 0:
            return 0.0
        nu = (theta.T @ features.evaluate(features.select(recent))).T
        sizes = [float(np.sqrt(np.square(one).sum(axis=1).mean())) for one in (nu - residuals, residuals)]
        return sizes[0] / (self._config.misfit * sizes[1] + self._misfit_floor)

    def _reach(self, features: Features, theta: Array, path: Array, states: Array) -> tuple[float, float]:
        """The largest change from here, and the largest slope along the path as a share of its limit."""
        n = path.shape[1]
        nu = theta.T @ features.evaluate(features.select(np.hstack([path, states])))
        spread = float(np.abs(nu - nu[:, :1]).max())
        apart = float(np.linalg.norm(path[PLACES, 1] - path[PLACES, 0]))
        steps = np.abs(np.diff(nu[:, :n], axis=1)).max(axis=1) / apart
        return spread, float((steps / self._place_limit).max())
