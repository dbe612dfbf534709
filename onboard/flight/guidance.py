"""Guidance: the target of each tick from the flight mode, continuous over take-off, path, hold and landing.

The path begins when the vehicle has reached the height of take-off.

When the position estimate jumps, the path stays at its place in the world frame of the new poses. The target moves with
the vehicle and returns to the path at a limited speed. The target of a landing sinks, and presses the vehicle
onto the floor, until touch-down. Then it is where the vehicle stands.
"""

from math import hypot, sqrt
from typing import Annotated, Final

from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.records import Target
from onboard.estimation.state import VehicleState
from onboard.flight.path_turn import STEP_S, path_turn
from onboard.flight.trajectory import Path, PathClock, PathPoint, TrajectoryConfig
from protocol.geometry import ZERO, Vector3, subtract, vector

RETURN_M_S2: Final = 2.0
"""Acceleration of the target on its way back to the path."""


class GuidanceConfig(ConfigRecord):
    """Trajectory and look-ahead times."""

    trajectory: TrajectoryConfig
    land_after_s: Annotated[float, Field(gt=0, description="path time at which the landing begins")]
    feed_forward_lead_s: Annotated[
        float, Field(ge=-0.2, le=0.5, description="t_ff: lag of the inner loops; below 0 where they lead")
    ]
    look_ahead_s: Annotated[float, Field(ge=0, le=0.5, description="t_ahead of the position channel's features")]
    attitude_look_ahead_s: Annotated[float, Field(ge=0, le=0.5, description="t_ahead of the attitude channel's")]
    return_speed_m_s: float = Field(default=0.5, gt=0, le=2, description="m/s, back to the path after a jump")


class Guidance:
    """The target of each tick."""

    def __init__(self, config: GuidanceConfig) -> None:
        self._config = config
        self.path = Path(config.trajectory)
        self._clock = PathClock()
        self._origin: Vector3 = (0.0, 0.0, 0.0)
        self._descent_m = 0.0
        self._descent_speed = 0.0
        self._offset: Vector3 = ZERO
        self._return_speed = 0.0
        self._resets_seen = 0
        self._posed = False

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
        self._offset = ZERO

    def follow_jump(self, state: VehicleState, posed: bool) -> None:
        """Move the target with a jump of the position estimate, if there was one.

        A first pose (`posed`: a pose has been used) defines the frame: the path moves with it. After any other jump
        the path stays, and the target returns to it.
        """
        if state.position_reset_count == self._resets_seen:
            return
        self._resets_seen = state.position_reset_count
        jump = vector(state.position_jump.tolist())
        if posed and not self._posed:
            self.shift(jump)
        else:
            self._offset = vector(off + step for off, step in zip(self._offset, jump, strict=True))
            self._return_speed = 0.0
        self._posed = posed

    def shift(self, jump: Vector3) -> None:
        """Move the path."""
        o = self._origin
        self._origin = (o[0] + jump[0], o[1] + jump[1], o[2] + jump[2])

    def place(self, position: Vector3) -> None:
        """Move the path so that its present point is at `position`."""
        self._offset = ZERO
        self.shift(subtract(position, self._at(0.0, ZERO, 0.0).position))

    def rest(self, position: Vector3) -> None:
        """End a landing: the target stays at `position`."""
        self._descent_speed = 0.0
        self.place(position)

    def step(self, run: bool, landing: bool, dt: float, climbing: bool = False) -> Target:
        """Target of this tick.

        run: path time advances. landing: the target descends from where it is. climbing: the vehicle has not reached
        its height; the path does not begin before, or it would be flown along the floor.
        """
        waits = climbing and self._clock.time_s >= self.path.start_s - self._clock.stop_s
        self._clock.step(run and not landing and not waits, dt)
        speed = self._config.trajectory.landing_speed_m_s  # reached within a second, and left as fast
        change = dt * speed if landing else -dt * speed
        self._descent_speed = min(max(self._descent_speed + change, 0.0), speed)
        self._descent_m += dt * self._descent_speed
        rate = self._return(dt)
        config, offset = self._config, self._offset
        path = self._at(0.0, ZERO, 0.0)
        now = self._at(0.0, offset, rate) if any(offset) else path
        ahead = self._at(config.look_ahead_s, offset, rate)
        attitude_ahead = self._at(config.attitude_look_ahead_s, offset, rate)
        before, lead, after = (
            self._at(config.feed_forward_lead_s + step_s, ZERO, 0.0).acceleration for step_s in (-STEP_S, 0.0, STEP_S)
        )
        # On a hold or landing the target no longer moves as in the laps before.
        phase = self.path.lap_phase(self._clock.time_s) if self._clock.steady else -1.0
        yaw_rad = config.trajectory.yaw_rad
        turn = path_turn(before, lead, after)
        return Target(now, lead, ahead, attitude_ahead, yaw_rad, path, turn, phase, self.path.lap_s)

    def _return(self, dt: float) -> float:
        """Reduce the offset along a straight line; returns its relative rate, 1/s: d offset / dt = -rate offset."""
        far = hypot(*self._offset)
        if far == 0.0:
            return 0.0
        speed = min(self._return_speed + RETURN_M_S2 * dt, self._config.return_speed_m_s, sqrt(2.0 * RETURN_M_S2 * far))
        left = max(0.0, 1.0 - speed * dt / far)
        self._return_speed = speed if left else 0.0
        self._offset = vector(off * left for off in self._offset)
        return speed / (far * left) if left else 0.0

    def _at(self, lead_s: float, offset: Vector3, rate: float) -> PathPoint:
        """The path's point `lead_s` from now, and beside it the `offset`, which decreases at the relative `rate`."""
        clock, descent = self._clock, self._descent_speed
        point = self.path.at(clock.time_s + clock.rate * lead_s)
        (x, y, z), (vx, vy, vz), acceleration = point if clock.steady else clock.ahead(point)
        north, east, down = self._origin
        position = (north + x, east + y, down + z + self._descent_m + descent * lead_s)
        velocity = (vx, vy, vz + descent)
        if any(offset):
            share = max(0.0, 1.0 - rate * lead_s)
            position = vector(p + share * off for p, off in zip(position, offset, strict=True))
            if share:
                velocity = vector(v - rate * off for v, off in zip(velocity, offset, strict=True))
        return PathPoint(position, velocity, acceleration)
