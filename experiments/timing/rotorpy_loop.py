"""Times RotorPy's own simulation loop, as a yardstick for lockstep: its quadrotor, controller and sensors, no link.

RotorPy: Folk, Paulos, Kumar 2023, https://arxiv.org/abs/2306.04485.
"""

import time
from importlib.util import find_spec
from typing import Final

import numpy as np

RATE_HZ: Final = 200
"""Of the loop, as onboard's."""
RADIUS_M: Final = 1.0


def is_installed() -> bool:
    """Whether RotorPy can be imported (extra `rotorpy`)."""
    return find_spec("rotorpy") is not None


def rotorpy_speed(seconds: float) -> float:
    """Return the flight time per computing time of a circle with the geometric controller, at RATE_HZ.

    Raises
    ------
    ImportError
        If RotorPy is not installed.
    """
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.environments import Environment
    from rotorpy.trajectories.circular_traj import ThreeDCircularTraj
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor

    environment = Environment(
        vehicle=Multirotor(quad_params),
        controller=SE3Control(quad_params),
        trajectory=ThreeDCircularTraj(radius=np.array([RADIUS_M, RADIUS_M, 0.0])),
        sim_rate=RATE_HZ,
    )
    start = time.perf_counter()
    result = environment.run(t_final=seconds)
    return float(result["time"][-1]) / (time.perf_counter() - start)
