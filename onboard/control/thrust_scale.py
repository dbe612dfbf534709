"""The thrust scale k: what share of the modelled thrust the motors really give, estimated in flight.

**Model.** Along the vehicle's axis the accelerometer measures -f_z = k T / m + v. T is the thrust that the nominal
motors would deliver, m the nominal mass, v noise and the forces of the air. k drifts, as a random walk: the battery
sags, a rotor is chipped. The optimal filter of this is the scalar Kalman filter. With T_0 = m g and its rate r [1/s],
the variance of k over that of v, scaled,

    k_dot = r (T / T_0)^2 (-f_z m / T - k),    r_dot = 1 / tau^2 - (r T / T_0)^2.

Only the ratio of the two noises matters. It is given as tau, the time constant that the filter has in the end at hover;
how uncertain k is at first is given as the time constant at the start. In between, r falls from one to the other.

**What it can tell apart.** Only k = (gain of the motors) x (nominal mass / true mass): f_z depends on thrust / mass.
That ratio is what the position loop needs. The attitude loop needs the gain of the motors over inertia, which k equals
where the mass is nominal or grows like the inertia. A mean force of the air along the axis counts as thrust: 0.4 m/s^2
of it are 4 %. A chipped rotor is a lower mean thrust, which k follows, and a torque, which is left to the laws. So is
all that is faster than k: k is one number, and its error is part of Delta. Battery sag is slower than k; k follows.
Where noise drives the motors hard, a lag up that differs from the lag down biases the mean of the modelled thrust, and
k by some percent. Least k: with 0.47, full thrust is the weight of the nominal vehicle.

**Why it is slow.** The laws of the cascade compensate within some 0.1 s what the model does not explain. k takes over
the part that stays, as a gain: the loop gain becomes the nominal one again, which no additive nu_ad can do. With a tau
ten times longer the two do not work against each other, and gusts leave k alone.

Sources: the hover thrust estimator of PX4 (a scalar Kalman filter of the hover thrust); E. J. J. Smeur, Q. P. Chu,
G. C. H. E. de Croon, "Adaptive incremental nonlinear dynamic inversion for attitude control of micro air vehicles",
Journal of Guidance, Control, and Dynamics 39(3), 2016 (control effectiveness, estimated in flight).
"""

from math import isfinite
from typing import Annotated, Self

from pydantic import Field, model_validator

from configs.loader import ConfigRecord
from onboard.control.airframe import AirframeConfig
from protocol.conventions import GRAVITY


class ThrustScaleConfig(ConfigRecord):
    """The estimate of k, its speed and its limits."""

    enabled: Annotated[bool, Field(description="whether k is estimated and used; if not, it is 1")] = True
    time_constant_s: Annotated[float, Field(ge=0.2, le=60, description="s, of the estimate at hover")] = 1.5
    start_time_constant_s: Annotated[
        float, Field(ge=0.05, le=60, description="s, the same when it begins; at most time_constant_s")
    ] = 0.3
    least: Annotated[float, Field(ge=0.2, le=1, description="least k, as a multiple of the nominal thrust")] = 0.5
    greatest: Annotated[float, Field(ge=1, le=2, description="greatest k")] = 1.3
    thrust_min_share: Annotated[
        float, Field(ge=0.05, le=0.95, description="thrust below which nothing is learnt, as a share of the weight")
    ] = 0.4

    @model_validator(mode="after")
    def _fast_at_first(self) -> Self:
        if self.start_time_constant_s > self.time_constant_s:
            raise ValueError(
                f"start_time_constant_s {self.start_time_constant_s:g}: allowed is at most time_constant_s, "
                f"{self.time_constant_s:g}"
            )
        return self

    def settled(self, thrust_gain: float) -> float:
        """k where the estimate ends. thrust_gain: true specific thrust as a multiple of the nominal one."""
        return min(max(thrust_gain, self.least), self.greatest) if self.enabled else 1.0


class ThrustScale:
    """The estimate at the present."""

    def __init__(self, config: ThrustScaleConfig, airframe: AirframeConfig, period_s: float) -> None:
        self._config, self._mass_kg, self._dt = config, airframe.mass_kg, period_s
        self._fastest = 1.0 / config.start_time_constant_s
        self._thrust_n = 0.0
        self.value = 1.0
        """k: true specific thrust as a multiple of the nominal one."""
        self.reset()

    def reset(self) -> None:
        """Start over, as at the beginning of a flight."""
        self.value = 1.0
        self._rate = self._fastest

    def step(self, specific_force_z: float, delivered_n: float, adapt: bool) -> None:
        """Learn from one tick.

        Parameters
        ----------
        specific_force_z: m/s^2, body FRD: negative in hover.
        delivered_n: N, collective thrust now, by the actuator model with the present k.
        adapt: whether what is measured may be learnt from.
        """
        now = delivered_n / self.value
        thrust, self._thrust_n = 0.5 * (self._thrust_n + now), now
        config, dt = self._config, self._dt
        load = thrust / (self._mass_kg * GRAVITY)
        if not (config.enabled and adapt and load >= config.thrust_min_share and isfinite(specific_force_z)):
            return
        innovation = -specific_force_z / GRAVITY - self.value * load
        value = self.value + self._rate * dt * load * innovation
        self.value = min(max(value, config.least), config.greatest)
        rate = self._rate + dt * (config.time_constant_s**-2 - (self._rate * load) ** 2)
        self._rate = min(
            max(rate, 0.0), self._fastest
        )  # whatever the load: an Euler step is stable for small ones only
