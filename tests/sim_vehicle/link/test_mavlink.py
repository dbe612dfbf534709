"""Frames are genuine MAVLink 2; invalid motor commands are counted and dropped."""

import hashlib
from math import inf, nan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from sim_vehicle.config import load_vehicle
from sim_vehicle.link.mavlink import VehicleCodec
from sim_vehicle.sensors.battery import BatterySample

CONFIG = load_vehicle("mambo")
KEY = bytes(range(32))


def codec(key=None):
    return VehicleCodec(CONFIG.link, CONFIG.sensors.ultrasonic, CONFIG.sensors.motion_capture, key)


def signed(frame_maker, stamp, key=KEY, link_id=0):
    sender = mavlink.MAVLink(None, 1, 1)
    sender.signing.secret_key, sender.signing.sign_outgoing = key, True
    sender.signing.timestamp, sender.signing.link_id = stamp, link_id
    return frame_maker().pack(sender)


def controls(values=(0.1, 0.2, 0.3, 0.4), mode=128):
    return mavlink.MAVLink_hil_actuator_controls_message(0, [*values, *[0.0] * 12], mode, 0)


def packed(message, component=1):
    return message.pack(mavlink.MAVLink(None, 1, component))


def test_a_command_is_read():
    fractions, armed = codec().motor_command(packed(controls()))
    assert fractions == pytest.approx((0.1, 0.2, 0.3, 0.4))
    assert armed
    assert codec().motor_command(packed(controls(mode=0)))[1] is False


@pytest.mark.parametrize(
    ("datagram", "reasons"),
    [
        (b"", "truncated"),
        (b"hello", "truncated"),
        (b"\xfd" * 400, "unknown_flags truncated"),
        (packed(controls())[:-3], "truncated"),
        (packed(controls())[:-1] + b"\x00", "checksum"),
        (packed(mavlink.MAVLink_heartbeat_message(2, 8, 0, 0, 3, 3)), "message_not_allowed"),
        (packed(controls((nan, 0, 0, 0))), "not_finite"),
        (packed(controls((0, 0, -inf, 0))), "not_finite"),
        (packed(controls((0, 1.5, 0, 0))), "out_of_range"),
        (packed(controls((0, 0, 0, -0.1))), "out_of_range"),
        (b"\xfe" + packed(controls())[1:], "not_mavlink_2"),
        (bytes(2000), "too_long"),
    ],
)
def test_bad_frames_are_counted_and_dropped(datagram, reasons):
    receiver = codec()
    assert receiver.motor_command(datagram) is None
    assert dict(receiver.rejected) == dict.fromkeys(reasons.split(), 1)


def test_a_truncated_datagram_does_not_affect_the_next_one():
    receiver, good = codec(), packed(controls())
    for cut in range(1, len(good)):
        assert receiver.motor_command(good[:cut]) is None
        assert receiver.motor_command(good) is not None


def test_the_newest_of_several_frames_counts():
    receiver = codec()
    other = packed(mavlink.MAVLink_heartbeat_message(2, 8, 0, 0, 3, 3))
    datagram = packed(controls((0.1,) * 4)) + other + packed(controls((0.7,) * 4)) + b"rest"
    assert receiver.motor_command(datagram)[0] == pytest.approx((0.7,) * 4)
    assert dict(receiver.rejected) == {"message_not_allowed": 1, "truncated": 1}


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=120))
def test_any_bytes(data):
    assert codec().motor_command(data) is None


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 200), st.integers(1, 255))
def test_a_corrupted_byte_never_passes(place, change):
    frame = bytearray(packed(controls()))
    place %= len(frame)
    frame[place] ^= change
    assert codec().motor_command(bytes(frame)) is None


def test_signed_commands():
    receiver = codec(KEY)
    assert receiver.motor_command(packed(controls())) is None
    assert receiver.motor_command(signed(controls, 100, key=bytes(32))) is None
    assert receiver.motor_command(signed(controls, 100)) is not None
    assert receiver.motor_command(signed(controls, 100)) is None
    assert receiver.motor_command(signed(controls, 99)) is None
    assert receiver.motor_command(signed(controls, 101)) is not None
    assert dict(receiver.rejected) == {"unsigned": 1, "signature": 1, "signature_replayed": 2}


def test_a_forged_frame_from_the_future_does_not_block_the_true_sender():
    receiver = codec(KEY)
    assert receiver.motor_command(signed(controls, 100)) is not None
    assert receiver.motor_command(signed(controls, 2**47, key=bytes(32))) is None
    assert receiver.motor_command(signed(controls, 101)) is not None


def test_the_vehicles_signatures_are_valid():
    frame = codec(KEY).heartbeat(True)
    assert frame[2] & 1
    assert hashlib.sha256(KEY + frame[:-6]).digest()[:6] == frame[-6:]
    receiver = mavlink.MAVLink(None)
    receiver.signing.secret_key = KEY
    assert receiver.decode(bytearray(frame)).get_type() == "HEARTBEAT"


def test_sequence_numbers_run_on(frames):
    sender = codec()
    messages = frames([sender.heartbeat(False) for _ in range(300)])
    assert [message.get_seq() for message in messages] == [k % 256 for k in range(300)]


def test_contents_of_slow_messages(frames):
    sender = codec()
    battery, beat, distance = frames(
        [
            sender.battery(BatterySample(3.7312, 4.2, 55.4, 0.916)),
            sender.heartbeat(True),
            sender.distance(1.234, 5_000_000),
        ]
    )
    assert battery.voltages == [3731] + [65535] * 9
    assert (battery.current_battery, battery.current_consumed, battery.battery_remaining) == (420, 55, 92)
    assert beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert (distance.current_distance, distance.orientation, distance.type) == (123, 25, 1)
    assert (distance.min_distance, distance.max_distance, distance.time_boot_ms) == (44, 400, 5000)
