"""Guidance: the target of each tick from the flight mode, continuous over take-off, path, hold and landing."""

from typing import Annotated

from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.records import Target
from onboard.estimation.state import VehicleState
from onboard.flight.trajectory import Path, PathClock, PathPoint, TrajectoryConfig
from protocol.geometry import Vector3


class GuidanceConfig(ConfigRecord):
    """Trajectory and look-ahead times."""

    trajectory: TrajectoryConfig
    land_after_s: Annotated[float, Field(gt=0, description="path time at which the landing begins")]
    feed_forward_lead_s: Annotated[float, Field(ge=0, le=0.5, description="t_ff: lag of the inner loops")]
    look_ahead_s: Annotated[float, Field(ge=0, le=0.5, description="t_ahead of the position channel's features")]
    attitude_look_ahead_s: Annotated[float, Field(ge=0, le=0.5, description="t_ahead of the attitude channel's")]


class Guidance:
    """The target of each tick."""

    def __init__(self, config: GuidanceConfig) -> None:
        self._config = config
        self.path = Path(config.trajectory)
        self._clock = PathClock()
        self._origin: Vector3 = (0.0, 0.0, 0.0)
        self._descent_m = 0.0
        self._descent_speed = 0.0

    @property
    def path_time_s(self) -> float:
        """Path time of the target, s."""
        return self._clock.time_s

    @property
    def finished(self) -> bool:
        """Whether the path is over and the landing is due."""
        return self._clock.time_s >= self._config.land_after_s

    def start(self, state: VehicleState) -> None:
        """Begin a flight above the present position of the vehicle."""
        north, east, down = state.position.tolist()
        self._origin = (north, east, down)
        self._clock = PathClock()
        self._descent_m = self._descent_speed = 0.0

    def shift(self, jump: Vector3) -> None:
        """Move the origin, so that the path stays at the vehicle when the position estimate jumps."""
        o = self._origin
        self._origin = (o[0] + jump[0], o[1] + jump[1], o[2] + jump[2])

    def step(self, run: bool, landing: bool, dt: float) -> Target:
        """Target of this tick. `run`: path time advances; `landing`: the target descends from where it is."""
        self._clock.step(run and not landing, dt)
        speed = self._config.trajectory.landing_speed_m_s  # reached within a second, and left as fast
        change = dt * speed if landing else -dt * speed
        self._descent_speed = min(max(self._descent_speed + change, 0.0), speed)
        self._descent_m += dt * self._descent_speed
        now = self._at(0.0)
        ahead = self._at(self._config.look_ahead_s)
        attitude_ahead = self._at(self._config.attitude_look_ahead_s)
        lead = self._at(self._config.feed_forward_lead_s)
        # On a hold or landing the target no longer moves as in the laps before.
        phase = self.path.lap_phase(self._clock.time_s) if self._clock.steady else -1.0
        yaw_rad = self._config.trajectory.yaw_rad
        return Target(now, lead.acceleration, ahead, attitude_ahead, yaw_rad, phase, self.path.lap_s)

    def _at(self, lead_s: float) -> PathPoint:
        clock, descent = self._clock, self._descent_speed
        point = self.path.at(clock.time_s + clock.rate * lead_s)
        (x, y, z), (vx, vy, vz), acceleration = point if clock.steady else clock.ahead(point)
        north, east, down = self._origin
        position = (north + x, east + y, down + z + self._descent_m + descent * lead_s)
        return PathPoint(position, (vx, vy, vz + descent), acceleration)
