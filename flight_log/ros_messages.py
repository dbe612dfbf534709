"""The ROS 2 messages of a flight: odometry, IMU, actuators, target and transforms, in the frames of REP 103.

| topic | type | content |
|---|---|---|
| /tf | tf2_msgs/msg/TFMessage | map -> base_link (true pose if it was logged), map -> estimate, map -> target |
| /odometry | nav_msgs/msg/Odometry | onboard's estimate: pose in map, velocity and rates in base_link |
| /truth/odometry | nav_msgs/msg/Odometry | the simulator's truth, if it was logged |
| /imu | sensor_msgs/msg/Imu | estimated attitude and rates; true acceleration if it was logged |
| /actuators | actuator_msgs/msg/Actuators | commanded share of the maximum thrust of each motor, PX4 order |
| /target | geometry_msgs/msg/PoseStamped | the point that the vehicle should be at |
"""

from collections.abc import Iterator
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from flight_log.reader import TICK_TOPIC, Flight, Table
from flight_log.ros_frames import Array, attitude_enu, body_flu, world_enu, xyzw

WORLD: Final = "map"
VEHICLE: Final = "base_link"
TRUTH_TOPIC: Final = "sim_vehicle/truth"
GRAVITY_M_S2: Final = 9.80665
ACTUATORS: Final = "actuator_msgs/msg/Actuators"
_ACTUATORS_DEFINITION: Final = "std_msgs/Header header\nfloat64[] position\nfloat64[] velocity\nfloat64[] normalized\n"
"""Of the package actuator_msgs, which ROS 2 distributions have beside the standard ones."""
TYPES: Final[dict[str, str]] = {
    "/tf": "tf2_msgs/msg/TFMessage",
    "/odometry": "nav_msgs/msg/Odometry",
    "/truth/odometry": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
    "/actuators": ACTUATORS,
    "/target": "geometry_msgs/msg/PoseStamped",
}
"""Topic -> type of message."""


class RosMessage(NamedTuple):
    """One message, ready to be written."""

    topic: str
    time_ns: int
    cdr: bytes


@cache
def typestore() -> Any:
    """The definitions of the message types: those of ROS 2 Jazzy, and of actuator_msgs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(_ACTUATORS_DEFINITION, ACTUATORS))
    return store


def definition(kind: str) -> str:
    """The whole text of a message type, with the types that it contains, as an MCAP schema has it."""
    text: str = typestore().generate_msgdef(kind, ros_version=2)[0]
    return text


def ros_messages(flight: Flight) -> Iterator[RosMessage]:
    """All messages of a flight, topic by topic. Topics whose records the flight did not log are left out."""
    tick, truth = flight.get(TICK_TOPIC), flight.get(TRUTH_TOPIC)
    if tick is not None:
        yield from _odometry("/odometry", tick, "rates", "estimate")
        yield from _imu(tick, truth)
        yield from _actuators(tick)
        yield from _target(tick)
        yield from _transforms(tick, "estimate")
    if truth is not None:
        yield from _odometry("/truth/odometry", truth, "rate", VEHICLE)
    flown = truth if truth is not None else tick
    if flown is not None:
        yield from _transforms(flown, VEHICLE)


def _type(name: str) -> Any:
    return typestore().types[name]


def _header(time_ns: int, frame: str) -> Any:
    stamp = _type("builtin_interfaces/msg/Time")(*divmod(max(time_ns, 0), 1_000_000_000))
    return _type("std_msgs/msg/Header")(stamp, frame)


def _message(topic: str, time_ns: int, message: Any) -> RosMessage:
    return RosMessage(topic, max(time_ns, 0), bytes(typestore().serialize_cdr(message, TYPES[topic])))


def _rows(table: Table) -> Iterator[tuple[int, int]]:
    """(row, time in ns)."""
    return enumerate(table.time_ns.tolist())


def _pose_of(table: Table) -> tuple[Array, Array]:
    """Positions [n, 3] in ENU and attitudes [n, 4] xyzw of base_link."""
    position = world_enu(table.vector(*(f"position_{axis}" for axis in "ned")))
    return position, xyzw(attitude_enu(table.vector(*(f"quaternion_{axis}" for axis in "wxyz"))))


def _odometry(topic: str, table: Table, rates: str, child: str) -> Iterator[RosMessage]:
    vector, point, quaternion = (_type(f"geometry_msgs/msg/{name}") for name in ("Vector3", "Point", "Quaternion"))
    pose, with_pose = _type("geometry_msgs/msg/Pose"), _type("geometry_msgs/msg/PoseWithCovariance")
    twist, with_twist = _type("geometry_msgs/msg/Twist"), _type("geometry_msgs/msg/TwistWithCovariance")
    odometry, unknown = _type("nav_msgs/msg/Odometry"), np.zeros(36)
    position, attitude = _pose_of(table)
    turned = attitude_enu(table.vector(*(f"quaternion_{axis}" for axis in "wxyz")))
    velocity = turned.apply(world_enu(table.vector(*(f"velocity_{axis}" for axis in "ned"))), inverse=True)
    rate = body_flu(table.vector(*(f"{rates}_{axis}" for axis in "pqr")))
    for row, time_ns in _rows(table):
        at = with_pose(pose(point(*position[row].tolist()), quaternion(*attitude[row].tolist())), unknown)
        moving = with_twist(twist(vector(*velocity[row].tolist()), vector(*rate[row].tolist())), unknown)
        yield _message(topic, time_ns, odometry(_header(time_ns, WORLD), child, at, moving))


def _imu(tick: Table, truth: Table | None) -> Iterator[RosMessage]:
    """REP 145: a first covariance of -1 says that there is no value."""
    vector, quaternion = _type("geometry_msgs/msg/Vector3"), _type("geometry_msgs/msg/Quaternion")
    imu, given, absent = _type("sensor_msgs/msg/Imu"), np.zeros(9), np.array([-1.0, *[0.0] * 8])
    _, attitude = _pose_of(tick)
    rate = body_flu(tick.vector(*(f"rates_{axis}" for axis in "pqr")))
    force = np.zeros((len(tick), 3)) if truth is None else specific_force(tick, truth)
    for row, time_ns in _rows(tick):
        of_acceleration = absent if truth is None else given
        fields = (quaternion(*attitude[row].tolist()), given, vector(*rate[row].tolist()), given)
        acceleration = vector(*force[row].tolist())
        yield _message("/imu", time_ns, imu(_header(time_ns, VEHICLE), *fields, acceleration, of_acceleration))


def specific_force(tick: Table, truth: Table) -> Array:
    """[n, 3] m/s^2, body FLU, at the times of the ticks: true acceleration without gravity."""
    origin = int(tick.time_ns[0])
    at, times = tick.seconds(origin), truth.seconds(origin)
    acceleration = np.column_stack([np.interp(at, times, truth[f"acceleration_{axis}"]) for axis in "ned"])
    nearest = np.clip(np.searchsorted(times, at), 0, len(times) - 1)
    attitude = attitude_enu(truth.vector(*(f"quaternion_{axis}" for axis in "wxyz"))[nearest])
    force: Array = attitude.apply(world_enu(acceleration - [0.0, 0.0, GRAVITY_M_S2]), inverse=True)
    return force


def _actuators(tick: Table) -> Iterator[RosMessage]:
    actuators, nothing = _type(ACTUATORS), np.zeros(0)
    motors = tick.vector(*(f"motor_{number}" for number in "1234"))
    for row, time_ns in _rows(tick):
        yield _message("/actuators", time_ns, actuators(_header(time_ns, VEHICLE), nothing, nothing, motors[row]))


def _target(tick: Table) -> Iterator[RosMessage]:
    stamped, pose = _type("geometry_msgs/msg/PoseStamped"), _type("geometry_msgs/msg/Pose")
    point, level = _type("geometry_msgs/msg/Point"), _type("geometry_msgs/msg/Quaternion")(0.0, 0.0, 0.0, 1.0)
    target = world_enu(tick.vector(*(f"target_{axis}" for axis in "ned")))
    for row, time_ns in _rows(tick):
        yield _message("/target", time_ns, stamped(_header(time_ns, WORLD), pose(point(*target[row].tolist()), level)))


def _transforms(table: Table, child: str) -> Iterator[RosMessage]:
    stamped, transform = _type("geometry_msgs/msg/TransformStamped"), _type("geometry_msgs/msg/Transform")
    vector, quaternion = _type("geometry_msgs/msg/Vector3"), _type("geometry_msgs/msg/Quaternion")
    message = _type("tf2_msgs/msg/TFMessage")
    position, attitude = _pose_of(table)
    for row, time_ns in _rows(table):
        moved = transform(vector(*position[row].tolist()), quaternion(*attitude[row].tolist()))
        yield _message("/tf", time_ns, message([stamped(_header(time_ns, WORLD), child, moved)]))
