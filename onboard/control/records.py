"""Inputs and outputs of a controller."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from onboard.estimation.state import VehicleState
from onboard.flight.path_turn import PathTurn
from onboard.flight.trajectory import PathPoint
from protocol.conventions import Array
from protocol.geometry import Vector3


class Target(NamedTuple):
    """The target of one tick, world NED. All controllers get the same."""

    now: PathPoint
    """Target at the present."""
    feed_forward: Vector3
    """m/s^2: acceleration of the path t_ff ahead, to compensate the lag of the inner loops."""
    ahead: PathPoint
    """Target t_ahead from now, for the look-ahead of the position channel."""
    attitude_ahead: PathPoint
    """The same for the attitude channel, with a shorter t_ahead."""
    yaw_rad: float
    path: PathPoint
    """The path itself: `now` without the way back to the path after a jump of the position estimate."""
    turn: PathTurn = PathTurn()
    """How the thrust of the path turns t_ff ahead."""
    lap_phase: float = -1.0
    """Share of the lap flown, in [0, 1); negative while the path does not repeat."""
    lap_s: float = 0.0
    """Duration of a lap, s; 0 for a path without laps."""


class ChannelMeasurement:
    """What the actuators do in one channel, and what they do not explain. Computed by onboard.control.uncertainty."""

    __slots__ = ("residual", "u_hat")

    def __init__(self) -> None:
        self.u_hat: Array = np.zeros(3)
        """[3], acceleration that the actuators deliver; m/s^2 (world NED) or rad/s^2 (body FRD)."""
        self.residual: Array = np.zeros(3)
        """[3], measured acceleration minus u_hat, unfiltered; same units."""


@dataclass(slots=True)
class ControlInputs:
    """Inputs of a controller in one tick. The arrays belong to the caller and change with the next tick."""

    dt: float
    """s since the last tick; more than a period if ticks were missed."""
    state: VehicleState
    target: Target
    signals: Array
    """[SIGNAL_COUNT], protocol.signals, at the present."""
    position: ChannelMeasurement
    attitude: ChannelMeasurement
    saturated: bool
    """Whether the motors could not deliver the last command."""
    adapt: bool
    """False on the ground and while an input is too old to learn from: change no adaptive state."""
    coming: tuple[Vector3, Vector3] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    """Angular acceleration by the actuators, rad/s^2: now, and in one tick under the command that is already sent."""
    excitation: tuple[Vector3, Vector3] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    """Added to u of the position (m/s^2) and the attitude channel (rad/s^2) after the law, to measure margins."""
    level_only: bool = False
    """True without a velocity estimate: hold level, sink slowly, do not control position."""
    missed: int = 0
    """Ticks missed since the last one. The last command was held meanwhile."""
    thrust: tuple[float, float] = (0.0, 1.0)
    """Collective thrust delivered now, N, and thrust of the motors as a multiple of the nominal one."""

    @property
    def period(self) -> float:
        """s from one tick to the next if none is missed."""
        return self.dt / (1 + self.missed)


class ChannelTelemetry:
    """What one channel did in a tick, for the log; zeros where a controller has no such quantity."""

    __slots__ = (
        *("adaptive", "adaptive_now", "demand", "eps_1", "eps_2", "eps_3", "error"),
        *("residual", "room", "tracking_bound", "vectors", "weight_norm"),
    )

    def __init__(self) -> None:
        self.vectors: Array = np.zeros(18)
        """The arrays below, which are views of this one, in this order."""
        self.error: Array = self.vectors[0:6]
        """e = x_rm - x; m, m/s or rad, rad/s."""
        self.demand: Array = self.vectors[6:9]
        """u: m/s^2 or rad/s^2."""
        self.adaptive: Array = self.vectors[9:12]
        """nu_ad as commanded (evaluated ahead)."""
        self.adaptive_now: Array = self.vectors[12:15]
        """nu_ad of the present state, W'Phi(x); the same as `adaptive` for a controller that does not look ahead."""
        self.residual: Array = self.vectors[15:18]
        """Delta_hat."""
        self.room: Array = np.zeros(3)
        """Bound of |nu_ad| for each axis (onboard.control.room); zero where there is none."""
        self.weight_norm = 0.0
        self.eps_1 = 0.0
        self.eps_2 = 0.0
        self.eps_3 = 0.0
        self.tracking_bound = 0.0
        """Live bound on the tracking error, m or rad; 0 without one (onboard.control.tracking_bound)."""


@dataclass(slots=True)
class ControlOutput:
    """The command: collective thrust and body torque."""

    thrust_n: float = 0.0
    torque_nm: Vector3 = (0.0, 0.0, 0.0)
    position: ChannelTelemetry = field(default_factory=ChannelTelemetry)
    attitude: ChannelTelemetry = field(default_factory=ChannelTelemetry)
    commanded_quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    law: int = 0
    """Which law flies, onboard.control.guard.Level: 0 the controller's own, 1 the bias alone, 2 none."""
