"""The airframe as onboard assumes it: nominal mass, inertia and motors.

The simulated (or real) vehicle differs from these numbers; the difference is part of the disturbance Delta.
"""

from typing import Annotated

from pydantic import Field

from configs.loader import ConfigRecord

Positive = Annotated[float, Field(gt=0)]


class AirframeConfig(ConfigRecord):
    """Nominal values. They come from the vehicle's file (configs/vehicle.py), where each has its source."""

    mass_kg: Positive
    inertia_kg_m2: tuple[Positive, Positive, Positive]
    """Jxx, Jyy, Jzz about the body axes."""
    arm_x_m: Positive
    arm_y_m: Positive
    yaw_torque_per_thrust_m: Positive
    motor_thrust_max_n: Positive
    motor_thrust_min_share: Annotated[float, Field(ge=0, lt=0.5)]
    """Idle thrust while armed, as a share of the maximum."""
    motor_lag_up_s: Positive
    motor_lag_down_s: Positive
    motor_response_s: Positive
    """Time constant that the motors are driven to; a lag that is no longer is left as it is."""
