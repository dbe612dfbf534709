"""Frames have the bytes that pymavlink writes, and decode to the same fields, for every message in use."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from protocol.mavlink.frames import (
    FixedFields,
    FrameBytes,
    FrameReader,
    FrameWriter,
    Message,
    checked_fields,
    layout_of,
)
from protocol.mavlink.signing import SigningClock

KEY = bytes(range(32))
KINDS = [
    getattr(mavlink, f"MAVLink_{name}_message")
    for name in (
        *(
            "hil_sensor",
            "hil_optical_flow",
            "optical_flow_rad",
            "optical_flow",
            "distance_sensor",
            "battery_status",
            "sys_status",
        ),
        *("heartbeat", "hil_actuator_controls", "odometry", "att_pos_mocap", "vicon_position_estimate"),
        *("attitude_quaternion", "local_position_ned", "command_long", "command_ack"),
    )
]


def random_fields(kind, data):
    """Any payload, as wire-order fields, with 0 for NaN, which equals nothing."""
    size = kind.unpacker.size
    fields = kind.unpacker.unpack(data.draw(st.binary(min_size=size, max_size=size)))
    return tuple(0.0 if value != value else value for value in fields)


def by_pymavlink(kind, fields):
    """The same message as pymavlink builds it: by name, arrays as lists."""
    values, at = {}, 0
    for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        values[name] = fields[at] if length == 0 else list(fields[at : at + length])
        at += max(length, 1)
    return kind(**values)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.msgname)
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_frames_equal_those_of_pymavlink_bit_for_bit(kind, data):
    fields = random_fields(kind, data)
    ours = FrameWriter(7, 9).write(Message(kind, fields), 0)
    assert ours == bytes(by_pymavlink(kind, fields).pack(mavlink.MAVLink(None, 7, 9)))
    read = mavlink.MAVLink(None).decode(bytearray(ours))
    assert ours == bytes(read.pack(mavlink.MAVLink(None, 7, 9)))
    assert checked_fields(ours, layout_of(kind.id)) == fields
    (frame,) = FrameReader([kind.id]).read(bytes(bytearray(ours)), 0)
    assert (frame.fields, frame.system, frame.component, frame.sequence) == (fields, 7, 9, 0)
    assert isinstance(ours, FrameBytes)
    assert ours.frame == frame, "what the frame carries is what its bytes hold"
    assert FrameReader([kind.id]).read(ours, 0) == [frame]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.msgname)
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_a_frame_with_fixed_fields_is_the_same(kind, data):
    fields = random_fields(kind, data)
    first = data.draw(st.integers(0, len(fields)))
    fixed = FixedFields(kind, fields[first:])
    for key in (None, KEY):
        at_once = FrameWriter(7, 9, key).write(Message(kind, fields), 1000)
        in_parts = FrameWriter(7, 9, key).write(Message(kind, fields[:first], fixed), 1000)
        assert in_parts == at_once
    assert FrameWriter(7, 9).write(Message(kind, fields[:first], fixed), 0).frame.fields == fields


def test_more_fixed_fields_than_the_message_has_are_refused():
    with pytest.raises(struct.error):
        FixedFields(mavlink.MAVLink_heartbeat_message, (0,) * 7)


def test_what_a_frame_carries_passes_no_check_that_its_bytes_fail() -> None:
    heartbeat = Message(mavlink.MAVLink_heartbeat_message, (0, 2, 8, 0, 3, 3))
    frame = FrameWriter(7, 9).write(heartbeat, 0)
    other = FrameReader([mavlink.MAVLINK_MSG_ID_HIL_SENSOR])
    assert other.read(frame, 0) == []
    assert other.rejected == {"message_not_allowed": 1}
    signed = FrameReader([heartbeat.kind.id], KEY)
    assert signed.read(frame, 0) == []
    assert signed.rejected.total() == 1
    assert type(FrameWriter(7, 9, KEY).write(heartbeat, 0)) is bytes
    assert type(frame + b"") is type(frame[:]) is bytes, "a part or a copy of the bytes carries nothing"


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.msgname)
def test_a_corrupted_or_cut_frame_has_no_fields(kind):
    layout = layout_of(kind.id)
    frame = FrameWriter(7, 9).write(Message(kind, layout.payload.unpack(bytes(range(layout.payload.size)))), 0)
    for place in range(1, len(frame)):
        corrupted = bytearray(frame)
        corrupted[place] ^= 0x10
        assert checked_fields(bytes(corrupted), layout) is None
        assert checked_fields(frame[:place], layout) is None if place > 1 else True


def test_signed_frames_are_pymavlinks():
    codec = mavlink.MAVLink(None, 1, 1)
    codec.signing.secret_key, codec.signing.sign_outgoing = KEY, True
    codec.signing.timestamp, codec.signing.link_id = 99, 0
    clock = SigningClock()
    clock.catch_up(99)
    kind, fields = mavlink.MAVLink_heartbeat_message, (5, 2, 8, 81, 4, 3)
    ours = FrameWriter(1, 1, KEY, clock).write(Message(kind, fields), 0)
    theirs = bytes(by_pymavlink(kind, fields).pack(codec))
    assert ours[-12:-6] in ((99).to_bytes(6, "little"), (100).to_bytes(6, "little"))
    assert ours[:-12] == theirs[:-12]
    assert len(FrameReader([kind.id], KEY, SigningClock()).read(ours, 0)) == 1
    assert FrameReader([kind.id], bytes(32), SigningClock()).read(ours, 0) == []


def test_a_field_that_does_not_fit_raises():
    with pytest.raises(struct.error):
        FrameWriter(1, 1).write(Message(mavlink.MAVLink_heartbeat_message, (0, 300, 0, 0, 0, 0)), 0)
