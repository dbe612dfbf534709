"""Records of the simulated vehicle: the truth and the output of a step."""

from typing import Final, NamedTuple

from flight_log.schema import RecordType, vector_fields
from protocol.conventions import Array

TRUTH: Final = RecordType(
    topic="sim_vehicle/truth",
    fields=(
        *vector_fields("position", "ned", "m"),
        *vector_fields("velocity", "ned", "m/s"),
        *vector_fields("quaternion", "wxyz", ""),
        *vector_fields("rate", "pqr", "rad/s, body FRD"),
        *vector_fields("acceleration", "ned", "m/s^2, velocity gained over the step by its length"),
        *vector_fields("angular_acceleration", "xyz", "rad/s^2, body FRD, rates gained over the step by its length"),
        *vector_fields("motor_thrust", "1234", "N, PX4 order, actual, without ground effect"),
        *vector_fields("wind", "ned", "m/s, air velocity at the vehicle"),
        *vector_fields("disturbance_force", "ned", "N, mean over the step: not explained by the nominal model"),
        *vector_fields(
            "disturbance_torque", "xyz", "N m, body FRD, mean over the step: not explained by the nominal model"
        ),
        ("battery_voltage", "V"),
        ("airborne", "1 when nothing touches the floor"),
    ),
    kind="float32",
)
"""The true state at the end of a step.

Disturbance force and torque are m a - m g - R T and J alpha + omega x J omega - tau, with mass m, inertia J, thrust T
and torque tau of the *nominal* vehicle under the same commands (`nominal` of the configuration). The force is m Delta
in the notation of the paper. On the floor both contain the reaction of the floor.
"""


class VehicleOutput(NamedTuple):
    """Output of one step."""

    to_onboard: list[bytes]
    """MAVLink 2 datagrams of the sensors."""
    to_motion_capture: list[bytes]
    """MAVLink 2 datagrams (ODOMETRY) that the motion capture system sends to the offboard host."""
    truth: Array
    """[len(TRUTH.fields)], see TRUTH."""
