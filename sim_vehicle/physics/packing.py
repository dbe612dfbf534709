"""From the typed configuration to the flat parameters of the compiled step."""

from collections.abc import Sequence
from math import exp

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.conventions import GRAVITY, Array
from protocol.geometry import Vector3
from sim_vehicle.config import SimVehicleConfig

SUBSTEP_NS = 1_000_000
"""ns, Runge-Kutta step."""
COULOMB_PER_MAH = 3.6


def pack_parameters(config: SimVehicleConfig, step_s: float = SUBSTEP_NS * 1e-9) -> Array:
    """[PARAMETERS_SIZE] for the bare vehicle, without disturbances. step_s: length of a sub-step."""
    P = np.zeros(at.PARAMETERS_SIZE)
    body, motors, floor, nominal = config.body, config.motors, config.floor, config.nominal
    set_mass(P, body.mass_kg, body.inertia_kg_m2, body.centre_of_mass_m, ())
    P[at.THRUST_FACTOR : at.THRUST_FACTOR + 8] = 1.0
    P[at.GAIN : at.GAIN + 4] = motors.gain
    P[at.STEP] = step_s
    P[at.KEEP_UP : at.KEEP_UP + 2] = exp(-0.5 * step_s / motors.lag_up_s), exp(-step_s / motors.lag_up_s)
    P[at.KEEP_DOWN : at.KEEP_DOWN + 2] = exp(-0.5 * step_s / motors.lag_down_s), exp(-step_s / motors.lag_down_s)
    assumed = nominal.motors
    P[at.NOMINAL_KEEP : at.NOMINAL_KEEP + 2] = exp(-step_s / assumed.lag_up_s), exp(-step_s / assumed.lag_down_s)
    P[at.MAX_THRUST : at.THRUST_SLOPE + 1] = (
        motors.max_thrust_n,
        motors.torque_ratio_m,
        body.arm_x_m,
        body.arm_y_m,
        body.rotor_height_m,
        motors.thrust_slope_n_s2,
    )
    P[at.ROTOR_RADIUS : at.GRAVITY + 1] = (
        body.rotor_radius_m,
        floor.ground_effect,
        config.drag.linear_n_s_m,
        config.drag.quadratic_n_s2_m2,
        GRAVITY,
    )
    _pack_battery(P, config)
    P[at.CONTACT_STIFFNESS : at.FOOT_DROP + 1] = (
        floor.stiffness_n_m,
        floor.damping_n_s_m,
        floor.grip_n_s_m,
        floor.friction,
        floor.foot_x_m,
        floor.foot_y_m,
        floor.foot_drop_m,
    )
    P[at.NOMINAL_MASS] = nominal.body.mass_kg
    P[at.NOMINAL_INERTIA : at.NOMINAL_INERTIA + 3] = nominal.body.inertia_kg_m2
    P[at.NOMINAL_MAX_THRUST : at.NOMINAL_ARM_Y + 1] = (
        assumed.max_thrust_n,
        assumed.torque_ratio_m,
        nominal.body.arm_x_m,
        nominal.body.arm_y_m,
    )
    vibration = config.sensors.imu.vibration
    P[at.SUM_SENSORS] = 1.0
    P[at.SUM_TONES] = float(vibration is not None)
    P[at.ROTOR_SPEED : at.ROTOR_SPEED + 4] = 1.0 if vibration is None else vibration.rotor_speed
    return P


def _pack_battery(P: Array, config: SimVehicleConfig) -> None:
    battery = config.battery
    P[at.RATED_VOLTAGE : at.IDLE_CURRENT + 1] = (
        battery.rated_v,
        battery.full_v,
        battery.empty_v,
        battery.capacity_mah * COULOMB_PER_MAH,
        battery.resistance_ohm,
        battery.polarisation_ohm,
        exp(-P[at.STEP] / battery.polarisation_s),
        battery.power_w_n15,
        battery.idle_a,
    )


def set_mass(
    P: Array,
    mass_kg: float,
    inertia_kg_m2: Vector3,
    centre_m: Vector3,
    payloads: Sequence[tuple[float, Vector3]],
) -> None:
    """Write mass, centre of mass, inertia about it and the inverse inertia into P, for a body with point masses on it.

    payloads: (kg, m from the reference point) each. Uses the parallel-axis theorem.
    """
    total = mass_kg + sum(m for m, _ in payloads)
    centre = (mass_kg * np.array(centre_m) + sum((m * np.array(r) for m, r in payloads), np.zeros(3))) / total
    inertia = np.diag(inertia_kg_m2) + mass_kg * _spread(np.array(centre_m) - centre)
    for m, r in payloads:
        inertia = inertia + m * _spread(np.array(r) - centre)
    P[at.MASS] = total
    P[at.CENTRE : at.CENTRE + 3] = centre
    for start, matrix in ((at.INERTIA, inertia), (at.INVERSE, np.linalg.inv(inertia))):
        P[start : start + 6] = (
            matrix[0, 0],
            matrix[1, 1],
            matrix[2, 2],
            matrix[0, 1],
            matrix[0, 2],
            matrix[1, 2],
        )


def _spread(r: Array) -> Array:
    """[3, 3] inertia of a unit mass at r."""
    spread: Array = np.dot(r, r) * np.eye(3) - np.outer(r, r)
    return spread
