"""For disturbances of one's own: where the quantities of the simulated vehicle are, and the built-in disturbances.

`state`, `P` and `effect` are the arrays that `Disturbance.act` gets; the constants are indices into them
(sim_vehicle.physics.layout has their units, and the others).
"""

from sim_vehicle.disturbances.fan_jet import FanJet
from sim_vehicle.disturbances.gusts import Gusts
from sim_vehicle.disturbances.payload import Payload
from sim_vehicle.disturbances.rotor_chip import RotorChip
from sim_vehicle.disturbances.wind import Wind
from sim_vehicle.physics.layout import (
    AIR,
    AIR_SPEED,
    FORCE,
    LOAD,
    MEAN_AIR,
    POSITION,
    QUATERNION,
    RATES,
    THRUST,
    TORQUE,
    TURBULENCE,
    VELOCITY,
    VOLTAGE_DROP,
    WIND,
)

__all__ = [
    "AIR",
    "AIR_SPEED",
    "FORCE",
    "LOAD",
    "MEAN_AIR",
    "POSITION",
    "QUATERNION",
    "RATES",
    "THRUST",
    "TORQUE",
    "TURBULENCE",
    "VELOCITY",
    "VOLTAGE_DROP",
    "WIND",
    "FanJet",
    "Gusts",
    "Payload",
    "RotorChip",
    "Wind",
]
