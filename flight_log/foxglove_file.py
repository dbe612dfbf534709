"""Writes a flight as one MCAP file for Foxglove: the vehicle in 3-D without a plug-in, and every number by name.

| topic | schema | content |
|---|---|---|
| /transforms | foxglove.FrameTransform | map -> base_link |
| /vehicle/pose, /target/pose | foxglove.PoseInFrame | vehicle and target |
| /vehicle/scene | foxglove.SceneUpdate | vehicle with its thrusts; wind, disturbance and nu_ad as arrows |
| /paths | foxglove.SceneUpdate | target and flown path |
| /odometry and others | ROS 2 | see ros_messages, without /tf |
| /onboard/tick and others | ros2msg of float64 | every record of the log, by column name |
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import foxglove
import numpy as np
from foxglove import Channel, Context, Schema
from foxglove.channels import FrameTransformChannel, PoseInFrameChannel, SceneUpdateChannel
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    FrameTransform,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Pose,
    PoseInFrame,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    Timestamp,
    Vector3,
)

from flight_log.log_file import FlightError
from flight_log.mcap_file import CDR_HEADER, ros_definition, ros_name
from flight_log.reader import Flight, Table
from flight_log.ros_frames import Array, arrow_attitude, attitude_enu, body_flu, world_enu, xyzw
from flight_log.ros_messages import TYPES, VEHICLE, WORLD, definition, ros_messages
from flight_log.scene import ARROW_COLOURS, ARROW_SCALE, ROTORS, THRUST_M_PER_N, Motion, build_scene
from flight_log.schema import RecordType

ARROW_DIAMETER_M: Final = 0.012
HEAD_SHARE: Final = 0.25
"""Length of an arrow's head, as a share of the arrow."""
BODY_COLOUR: Final = (200, 200, 200)
THRUST_COLOUR: Final = (230, 159, 0)
PATH_COLOURS: Final = {"target": (150, 150, 150), "flown": (0, 114, 178)}
LINE_M: Final = 0.008

Entry = tuple[int, Any, Any]
"""Time in ns, channel, message."""


def write_foxglove(flight: Flight, path: Path) -> None:
    """Write the file, in order of time.

    Raises
    ------
    FlightError
        If the file exists already, or the flight has no position to show.
    OSError
        If it cannot be written.
    """
    scene = build_scene(flight)
    if scene.motion is None:
        raise FlightError(f"{flight.path}: holds neither onboard/tick nor sim_vehicle/truth: nothing to show")
    if path.exists():
        raise FlightError(f"{path}: exists already")
    context = Context()
    with foxglove.open_mcap(path, context=context):
        entries = [*_motion(scene.motion, context), *_ros(flight, context), *_records(flight, context)]
        if scene.target is not None:
            entries += _target(*scene.target, context)
            entries += _paths(scene.motion, scene.target[1], context)
        for time_ns, channel, message in sorted(entries, key=lambda entry: entry[0]):
            channel.log(message, log_time=time_ns)


def _stamp(time_ns: int) -> Timestamp:
    return Timestamp(*divmod(time_ns, 1_000_000_000))


def _vector(values: list[float]) -> Vector3:
    x, y, z = values
    return Vector3(x=x, y=y, z=z)


def _quaternion(values: list[float]) -> Quaternion:
    x, y, z, w = values
    return Quaternion(x=x, y=y, z=z, w=w)


def _pose(position: list[float], quaternion: list[float]) -> Pose:
    return Pose(position=_vector(position), orientation=_quaternion(quaternion))


def _colour(rgb: tuple[int, int, int]) -> Color:
    red, green, blue = (value / 255.0 for value in rgb)
    return Color(r=red, g=green, b=blue, a=1.0)


def _motion(motion: Motion, context: Context) -> Iterator[Entry]:
    """Transform, pose and scene of the vehicle."""
    moved = FrameTransformChannel("/transforms", context=context)
    posed = PoseInFrameChannel("/vehicle/pose", context=context)
    shown = SceneUpdateChannel("/vehicle/scene", context=context)
    positions, attitudes = world_enu(motion.position), xyzw(attitude_enu(motion.quaternion))
    in_world = _arrows(motion)
    thrust = motion.thrust * THRUST_M_PER_N
    for row, time_ns in enumerate(np.maximum(motion.time_ns, 0).tolist()):
        stamp, pose = _stamp(time_ns), _pose(positions[row].tolist(), attitudes[row].tolist())
        transform = FrameTransform(
            timestamp=stamp,
            parent_frame_id=WORLD,
            child_frame_id=VEHICLE,
            translation=_vector(positions[row].tolist()),
            rotation=_quaternion(attitudes[row].tolist()),
        )
        yield time_ns, moved, transform
        yield time_ns, posed, PoseInFrame(timestamp=stamp, frame_id=WORLD, pose=pose)
        body = SceneEntity(
            timestamp=stamp,
            frame_id=VEHICLE,
            id="vehicle",
            frame_locked=True,
            lines=_frame_lines(),
            arrows=[_thrust_arrow(number, length) for number, length in enumerate(thrust[row].tolist())],
        )
        arrows = [
            _arrow(_pose(positions[row].tolist(), turned[row].tolist()), float(length[row]), ARROW_COLOURS[name])
            for name, (turned, length) in in_world.items()
            if length[row] > 0.0
        ]
        around = SceneEntity(timestamp=stamp, frame_id=WORLD, id="arrows", arrows=arrows)
        yield time_ns, shown, SceneUpdate(entities=[body, around])


def _arrows(motion: Motion) -> dict[str, tuple[Array, Array]]:
    """Name -> attitudes [n, 4] and lengths [n], m, of the arrows at the vehicle, in the world's frame."""
    vectors = {name: world_enu(ARROW_SCALE[name] * values) for name, values in motion.arrows.items()}
    return {name: (xyzw(arrow_attitude(one)), np.linalg.norm(one, axis=1)) for name, one in vectors.items()}


def _arrow(pose: Pose, length_m: float, colour: tuple[int, int, int]) -> ArrowPrimitive:
    return ArrowPrimitive(
        pose=pose,
        shaft_length=(1.0 - HEAD_SHARE) * length_m,
        shaft_diameter=ARROW_DIAMETER_M,
        head_length=HEAD_SHARE * length_m,
        head_diameter=2.0 * ARROW_DIAMETER_M,
        color=_colour(colour),
    )


def _thrust_arrow(number: int, length_m: float) -> ArrowPrimitive:
    """An arrow upwards at a rotor."""
    position = body_flu(np.array([ROTORS[number]]))[0].tolist()
    up = xyzw(arrow_attitude(np.array([[0.0, 0.0, 1.0]])))[0].tolist()
    return _arrow(_pose(position, up), length_m, THRUST_COLOUR)


def _frame_lines() -> list[LinePrimitive]:
    """The arms of the vehicle."""
    ends = body_flu(np.array(ROTORS)).tolist()
    return [_line([ends[first], ends[second]], BODY_COLOUR) for first, second in ((0, 1), (2, 3))]


def _line(points: list[list[float]], colour: tuple[int, int, int]) -> LinePrimitive:
    return LinePrimitive(
        type=LinePrimitiveLineType.LineStrip,
        pose=_pose([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
        thickness=LINE_M,
        points=[Point3(x=x, y=y, z=z) for x, y, z in points],
        color=_colour(colour),
    )


def _target(times: Any, positions: Array, context: Context) -> Iterator[Entry]:
    channel, level = PoseInFrameChannel("/target/pose", context=context), [0.0, 0.0, 0.0, 1.0]
    for time_ns, position in zip(np.maximum(times, 0).tolist(), world_enu(positions).tolist(), strict=True):
        yield time_ns, channel, PoseInFrame(timestamp=_stamp(time_ns), frame_id=WORLD, pose=_pose(position, level))


def _paths(motion: Motion, target: Array, context: Context) -> Iterator[Entry]:
    """Both paths, from the first moment on."""
    channel, first = SceneUpdateChannel("/paths", context=context), max(int(motion.time_ns[0]), 0)
    entities = [
        SceneEntity(
            timestamp=_stamp(first),
            frame_id=WORLD,
            id=name,
            lines=[_line(world_enu(points).tolist(), PATH_COLOURS[name])],
        )
        for name, points in (("target", target), ("flown", motion.position))
    ]
    yield first, channel, SceneUpdate(entities=entities)


def _ros(flight: Flight, context: Context) -> Iterator[Entry]:
    """The ROS 2 messages; the transforms are in the Foxglove schema already."""
    channels = {
        topic: _cdr_channel(topic, kind, definition(kind), context) for topic, kind in TYPES.items() if topic != "/tf"
    }
    for message in ros_messages(flight):
        if message.topic in channels:
            yield message.time_ns, channels[message.topic], message.cdr


def _records(flight: Flight, context: Context) -> Iterator[Entry]:
    """Every record of the log, by the names of its columns."""
    for table in flight:
        record = RecordType(table.topic, tuple(table.units.items()))
        channel = _cdr_channel(f"/{table.topic}", ros_name(table.topic), ros_definition(record), context)
        for time_ns, values in zip(np.maximum(table.time_ns, 0).tolist(), _rows(table), strict=True):
            yield time_ns, channel, values


def _rows(table: Table) -> Iterator[bytes]:
    for row in np.ascontiguousarray(table.values, dtype="<f8"):
        yield CDR_HEADER + row.tobytes()


def _cdr_channel(topic: str, name: str, text: str, context: Context) -> Channel:
    schema = Schema(name=name, encoding="ros2msg", data=text.encode())
    return Channel(topic, message_encoding="cdr", schema=schema, context=context)


def write_layout(path: Path) -> None:
    """Write the layout that Foxglove imports (flight_log.foxglove_layout) as JSON. Raises OSError."""
    from flight_log.foxglove_layout import layout

    path.write_text(json.dumps(json.loads(layout().to_json()), indent=1) + "\n", encoding="utf-8")
