"""The linear plant: actuators and dead time, of the simulated vehicle and of the nominal one that onboard assumes.

Onboard drives the motors against their nominal lag tau_n, so that they answer with tau_r
(onboard/control/actuators.py). Motors with the lag tau then answer with

    A = (1 + tau_n s) / ((1 + tau_r s) (1 + tau s)),    nominal: A_n = 1 / (1 + tau_r s).

Onboard estimates the thrust scale k (onboard/control/thrust_scale.py). All gains here are what it leaves once it has
settled: 1 for weak motors; for a heavy vehicle 1 in the lift, and more than 1 in the attitude, by its mass.

The lags are means of up and down: of the motors that turn the vehicle, half speed up and half slow down.

**Battery.** Thrust goes with the square of the voltage V, current with thrust^1.5 / V (sim_vehicle/physics/motors.py).
With W the power of the motors at hover and R the battery's resistance, a thrust larger by the share t lowers V by the
share v t, v = 1.5 R W / (V^2 - R W). In the lift, with all motors at once, this acts back on the motors:

    t = A (c - 2 v t),    A / (1 + 2 v A) in place of A.

That takes a fifth of the gain of the vertical loop. A turn speeds two motors up and slows two down, and has no sag.

Not in it: saturation, drag.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from experiments.flights.scenario import FlightConfig
from protocol.conventions import GRAVITY

HOLD_TICKS: Final = 0.5
COMMAND_TICKS: Final = 1.0
"""A command acts one tick after it was computed, and is held for a tick."""


class Plant(NamedTuple):
    """From a demand to the acceleration as measured, [n] each: of the vehicle (true) and of what onboard assumes."""

    true: Any
    """Actuators with gain and all dead time: G exp(-d s)."""
    nominal: Any
    """A_n exp(-d_n s)."""
    nominal_prompt: Any
    """A_n: without dead time."""


def attitude_plant(config: FlightConfig, axis: int, s: Any) -> Plant:
    """Angular acceleration about an axis, per demand of the attitude loop."""
    vehicle, airframe = config.vehicle, config.onboard.airframe
    levers = (
        vehicle.body.arm_y_m / airframe.arm_y_m,
        vehicle.body.arm_x_m / airframe.arm_x_m,
        vehicle.motors.torque_ratio_m / airframe.yaw_torque_per_thrust_m,
    )
    inertia = airframe.inertia_kg_m2[axis] / vehicle.body.inertia_kg_m2[axis]
    return _plant(config, thrust_gain(config) * levers[axis] * inertia, config.onboard.estimator.gyro_delay_s, s)


def lift_plant(config: FlightConfig, s: Any) -> Plant:
    """Vertical acceleration, per vertical demand of the position loop."""
    return _plant(config, lift_gain(config), 0.0, s, _sag(config, s))


def thrust_gain(config: FlightConfig) -> float:
    """Thrust at a command, as a multiple of what onboard assumes with its settled k; mean of the motors."""
    gain = _nominal_gain(config)
    return gain / config.onboard.thrust_scale.settled(gain * _mass_ratio(config))


def lift_gain(config: FlightConfig) -> float:
    """rho: acceleration by the thrust at a command, as a multiple of what onboard assumes."""
    return thrust_gain(config) * _mass_ratio(config)


def _nominal_gain(config: FlightConfig) -> float:
    """Thrust at a command, as a multiple of that of the nominal motors."""
    motors = config.vehicle.motors
    return float(np.mean(motors.gain)) * motors.max_thrust_n / config.onboard.airframe.motor_thrust_max_n


def _mass_ratio(config: FlightConfig) -> float:
    """Nominal over true mass."""
    return config.onboard.airframe.mass_kg / config.vehicle.body.mass_kg


def _sag(config: FlightConfig, s: Any) -> Any:
    """2 v: the share of thrust that the sag of a full battery takes per share of thrust, at hover."""
    battery = config.vehicle.battery
    power = battery.power_w_n15 * 4.0 * (0.25 * config.vehicle.body.mass_kg * GRAVITY) ** 1.5
    settled = battery.resistance_ohm + battery.polarisation_ohm
    # V = open - settled (idle + power / V), the larger of its two solutions
    unloaded = battery.full_v - settled * battery.idle_a
    volts = 0.5 * (unloaded + max(unloaded**2 - 4.0 * settled * power, 0.0) ** 0.5)
    drop = (battery.resistance_ohm + battery.polarisation_ohm / (1.0 + battery.polarisation_s * s)) * power
    return 3.0 * drop / (volts**2 - drop)


def _plant(config: FlightConfig, gain: float, sensor_s: float, s: Any, sag: Any = 0.0) -> Plant:
    motors, airframe = config.vehicle.motors, config.onboard.airframe
    true_s = 0.5 * (motors.lag_up_s + motors.lag_down_s)
    nominal_s = 0.5 * (airframe.motor_lag_up_s + airframe.motor_lag_down_s)
    prompt = 1.0 / (1.0 + min(airframe.motor_response_s, nominal_s) * s)
    delayed = prompt * np.exp(-(sensor_s + (COMMAND_TICKS + HOLD_TICKS) * config.onboard.period_ns * 1e-9) * s)
    off_nominal = (1.0 + nominal_s * s) / (1.0 + sag + true_s * s) * np.exp(-motors.command_delay_s * s)
    return Plant(gain * off_nominal * delayed, delayed, prompt)
