"""The vehicle as the parameters of RotorPy's Multirotor.

RotorPy's z points up. World: x north, y west, z up. Body: x forward, y left, z up, with the origin at the centre of
mass. So a vector of the project (NED or FRD) has the signs of y and z changed. So has the vector part of a quaternion.

Mass, inertia with its products, places and directions of the rotors, thrust and torque per squared speed are the
vehicle's. The quadratic drag is RotorPy's parasitic drag, at the centre of mass. Its rotor drag k_d makes the linear
drag in hover. The time constant of the rotor's speed is the mean of the lags up and down: near hover, a lag of the
speed is a lag of the thrust with the same time constant. Inflow, translational lift and flapping are those of
RotorpyConfig. RotorPy's ground (rotorpy_physics.py) and motor noise are not used.
"""

from math import log, sqrt
from typing import Any

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.conventions import GRAVITY, Array
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.physics.dynamics import rotor_place
from sim_vehicle.physics.parameters import RotorpyConfig


def hover_speed(config: SimVehicleConfig) -> float:
    """Speed of the rotors in hover, rad/s, of the vehicle without payload."""
    return sqrt(config.body.mass_kg * GRAVITY / 4 / config.motors.thrust_slope_n_s2)


def motor_lag(P: Array) -> float:
    """Time constant of a rotor's speed, s. P: [PARAMETERS_SIZE], see layout.py."""
    return float(-0.5 * P[at.STEP] * (1.0 / log(P[at.KEEP_UP + 1]) + 1.0 / log(P[at.KEEP_DOWN + 1])))


def quad_params(P: Array, hover_rad_s: float, rotors: RotorpyConfig) -> dict[str, Any]:
    """RotorPy's parameters of a vehicle with these parameters. P: [PARAMETERS_SIZE], see layout.py."""
    slope = float(P[at.THRUST_SLOPE])
    drag = float(P[at.DRAG_LINEAR]) / (4.0 * hover_rad_s)
    xx, yy, zz, xy, xz, yz = P[at.INERTIA : at.INERTIA + 6].tolist()
    cx, cy, cz = P[at.CENTRE : at.CENTRE + 3].tolist()
    places = {}
    for i in range(4):
        x, y = rotor_place(i, P)
        places[f"r{i + 1}"] = np.array([x - cx, cy - y, P[at.ROTOR_HEIGHT] + cz])
    volts = P[at.FULL_VOLTAGE] / P[at.RATED_VOLTAGE]
    most = P[at.MAX_THRUST] * volts * volts * max(P[at.GAIN : at.GAIN + 4])
    return {
        "mass": float(P[at.MASS]),
        "Ixx": xx,
        "Iyy": yy,
        "Izz": zz,
        "Ixy": -xy,
        "Ixz": -xz,
        "Iyz": yz,
        "num_rotors": 4,
        "rotor_pos": places,
        "rotor_directions": np.array([-1.0, -1.0, 1.0, 1.0]),  # torque about up; PX4 order
        "c_Dx": float(P[at.DRAG_QUADRATIC]),
        "c_Dy": float(P[at.DRAG_QUADRATIC]),
        "c_Dz": float(P[at.DRAG_QUADRATIC]),
        "k_eta": slope,
        "k_m": slope * float(P[at.TORQUE_RATIO]),
        "k_d": drag,
        "k_z": rotors.inflow_ratio * drag,
        "k_h": rotors.lift_s_m * hover_rad_s * drag,
        "k_flap": rotors.flapping_m * drag,
        "tau_m": motor_lag(P),
        "rotor_speed_min": 0.0,
        "rotor_speed_max": sqrt(most / slope),
        "motor_noise_std": 0.0,
    }
