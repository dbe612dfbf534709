"""Fills the vehicle's signal vector (protocol.signals) from the estimate and the actuator model."""

import numpy as np
from numpy.typing import NDArray

from onboard.records import VehicleState
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX

Array = NDArray[np.float64]

_POSITION = SIGNAL_INDEX["position_n"]
_VELOCITY = SIGNAL_INDEX["velocity_n"]
_EULER = SIGNAL_INDEX["roll"]
_RATES = SIGNAL_INDEX["rate_p"]
_BODY_VELOCITY = SIGNAL_INDEX["body_velocity_x"]
_THRUST = SIGNAL_INDEX["motor_thrust_1"]
_BATTERY = SIGNAL_INDEX["battery_voltage"]
_VIBRATION = SIGNAL_INDEX["vibration"]


class SignalVector:
    """One preallocated vector, rewritten each tick."""

    def __init__(self) -> None:
        self.values: Array = np.zeros(SIGNAL_COUNT)

    def step(self, state: VehicleState, motor_thrusts: Array, battery_v: float) -> Array:
        """The signals now. motor_thrusts: [4], N, by the actuator model."""
        v = self.values
        v[_POSITION : _POSITION + 3] = state.position
        v[_VELOCITY : _VELOCITY + 3] = state.velocity
        v[_EULER : _EULER + 3] = state.euler
        v[_RATES : _RATES + 3] = state.rates
        np.dot(state.velocity, state.rotation, out=v[_BODY_VELOCITY : _BODY_VELOCITY + 3])
        v[_THRUST : _THRUST + 4] = motor_thrusts
        v[_BATTERY] = battery_v
        v[_VIBRATION] = state.vibration
        return v
