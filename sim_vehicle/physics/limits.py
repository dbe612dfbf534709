"""When a flight of the simulated vehicle is lost."""

from math import radians
from typing import Final

import numpy as np

from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.records import Array

HARD_TOUCH_M_S: Final = 1.0
"""Sinking faster than this at a touch-down."""
TOUCH_TILT_RAD: Final = radians(35.0)
"""Tilted further than this at a touch-down."""
LOST_TILT_RAD: Final = radians(80.0)
"""Tilted further than this anywhere."""


def flight_limits(config: SimVehicleConfig) -> Array:
    """[4] as advance.verdict reads them."""
    return np.array([HARD_TOUCH_M_S, TOUCH_TILT_RAD, LOST_TILT_RAD, config.box_m])
