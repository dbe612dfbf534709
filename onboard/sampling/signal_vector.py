"""Fills the signal vector (protocol.signals) from state estimate and actuator model."""

from math import exp
from typing import Final

import numpy as np

from onboard.estimation.state import VehicleState
from protocol.conventions import Array
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX

_POSITION = SIGNAL_INDEX["position_n"]
_VELOCITY = SIGNAL_INDEX["velocity_n"]
_EULER = SIGNAL_INDEX["roll"]
_RATES = SIGNAL_INDEX["rate_p"]
_BODY_VELOCITY = SIGNAL_INDEX["body_velocity_x"]
_THRUST = SIGNAL_INDEX["motor_thrust_1"]
_BATTERY = SIGNAL_INDEX["battery_voltage"]
_VIBRATION = SIGNAL_INDEX["vibration"]
THRUST_FILTER_S: Final = 0.15
"""Filter of the motor thrusts as signals. They tell the network which motor is weak. The filter keeps fast changes
out, so that nu_ad does not feed back into the features (docs/learning.md)."""


class SignalVector:
    """One preallocated vector, rewritten in each tick."""

    def __init__(self, period_s: float) -> None:
        self.values: Array = np.zeros(SIGNAL_COUNT)
        self._thrusts = self.values[_THRUST : _THRUST + 4]
        self._share = 1.0 - exp(-period_s / THRUST_FILTER_S)

    def step(self, state: VehicleState, motor_thrusts: Array, battery_v: float) -> Array:
        """The signals at the present. motor_thrusts: [4], N, by the actuator model."""
        v = self.values
        v[_POSITION : _POSITION + 3] = state.position
        v[_VELOCITY : _VELOCITY + 3] = state.velocity
        v[_EULER : _EULER + 3] = state.euler
        v[_RATES : _RATES + 3] = state.rates
        np.dot(state.velocity, state.rotation, out=v[_BODY_VELOCITY : _BODY_VELOCITY + 3])
        self._thrusts += self._share * (motor_thrusts - self._thrusts)
        v[_BATTERY] = battery_v
        v[_VIBRATION] = state.vibration
        return v
