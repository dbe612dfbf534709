"""What goes into a controller and what comes out of it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from onboard.records import VehicleState
from onboard.trajectory import PathPoint

Array = NDArray[np.float64]
Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Target:
    """What the vehicle is to follow, world NED. Every controller sees the same."""

    now: PathPoint
    """Target at the present."""
    feed_forward: Vector3
    """m/s^2: acceleration of the path t_ff ahead, which makes up for the lag of the loops below."""
    ahead: PathPoint
    """Target t_ahead from now, for features evaluated where the vehicle will be."""
    yaw_rad: float


@dataclass(slots=True)
class ControlInputs:
    """Everything a controller may use in one step. Arrays belong to the caller and change with the next step."""

    dt: float
    """s since the last step."""
    state: VehicleState
    target: Target
    signals: Array
    """[SIGNAL_COUNT], protocol.signals, at the present."""
    delivered_thrust_n: float
    """Collective thrust the motors deliver now, by the actuator model."""
    delivered_torque_nm: Vector3
    """Body torque they deliver now, by the actuator model."""
    saturated: bool
    """Whether the last command could not be met by the motors."""
    adapt: bool
    """False on the ground and whenever an input is too old to learn from: hold every adaptive state still."""
    level_only: bool = False
    """True when there is no velocity to fly by: hold level, sink slowly, leave position alone."""


@dataclass(slots=True)
class ChannelTelemetry:
    """What one channel did; all zeros for a controller without that notion."""

    error: Array = field(default_factory=lambda: np.zeros(6))
    """e = x_rm - x; m, m/s or rad, rad/s."""
    demand: Array = field(default_factory=lambda: np.zeros(3))
    """u: m/s^2 or rad/s^2."""
    delivered: Array = field(default_factory=lambda: np.zeros(3))
    """u_hat."""
    adaptive: Array = field(default_factory=lambda: np.zeros(3))
    """nu_ad as commanded (evaluated ahead)."""
    adaptive_now: Array = field(default_factory=lambda: np.zeros(3))
    """nu_ad of the present state, W'Phi(x); the same as `adaptive` for a controller that does not look ahead."""
    residual: Array = field(default_factory=lambda: np.zeros(3))
    """Delta_hat."""
    weight_norm: float = 0.0
    eps_1: float = 0.0
    eps_2: float = 0.0
    eps_3: float = 0.0
    live_bound: float = 0.0
    """Bound on norm(e), docs/control.md."""


@dataclass(slots=True)
class ControlOutput:
    """The command: collective thrust and body torque."""

    thrust_n: float = 0.0
    torque_nm: Vector3 = (0.0, 0.0, 0.0)
    position: ChannelTelemetry = field(default_factory=ChannelTelemetry)
    attitude: ChannelTelemetry = field(default_factory=ChannelTelemetry)
    commanded_quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
