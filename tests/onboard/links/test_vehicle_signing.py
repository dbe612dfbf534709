"""Signed MAVLink: forged, replayed, old and far-future frames, and cases that pymavlink itself accepts."""

import pytest
from pymavlink.dialects.v20 import common as mavlink

from onboard.links.vehicle import VehicleLink, VehicleLinkConfig
from protocol.mavlink.signing import SigningClock
from tests.onboard.links.pymavlink_vehicle import KEY, OTHER_KEY, STEP_NS, Link, Vehicle


def signed_pair(**config):
    now_ns = 10**12
    vehicle = Vehicle(key=KEY)
    vehicle.mav.signing.timestamp = now_ns // 10_000 + STEP_NS // 10_000  # signed after the link began
    return vehicle, Link(KEY, now_ns, SigningClock(), **config)


def test_signed_frames_pass_and_unsigned_or_wrongly_signed_do_not():
    vehicle, link = signed_pair()
    assert len(vehicle.tick(link)) == 1
    assert Vehicle(clock_ns=vehicle.clock_ns).tick(link) == []
    assert link.rejected["unsigned"] == 1
    unknown_sender = Vehicle(key=OTHER_KEY, clock_ns=vehicle.clock_ns)
    unknown_sender.mav.signing.timestamp = vehicle.mav.signing.timestamp + 100
    assert unknown_sender.tick(link) == []
    assert link.rejected["signature"] == 1
    assert len(vehicle.tick(link)) == 1


def test_a_forged_future_frame_does_not_block_the_stream():
    """Pymavlink stores a frame's time before it verifies the signature; we must not."""
    vehicle, link = signed_pair()
    vehicle.tick(link)
    forger = Vehicle(key=OTHER_KEY, clock_ns=vehicle.clock_ns)
    forger.mav.signing.timestamp = vehicle.mav.signing.timestamp + 5_000_000
    forger.tick(link)
    assert len(vehicle.tick(link)) == 1
    naive = mavlink.MAVLink(None)
    naive.signing.secret_key = KEY
    naive.decode(bytearray(vehicle.imu()))
    with pytest.raises(mavlink.MAVError):
        naive.decode(bytearray(forger.imu()))
    with pytest.raises(mavlink.MAVError):  # the library's defect, the reason not to use it
        naive.decode(bytearray(vehicle.imu()))


def test_a_replayed_frame_is_refused():
    vehicle, link = signed_pair()
    frame = vehicle.imu(time_ns=STEP_NS)
    assert len(link.receive(frame, link.now_ns)) == 1
    assert link.receive(frame, link.now_ns) == []
    assert link.rejected["signature_replayed"] == 1


def test_a_far_future_time_is_refused_even_with_the_right_key_and_does_not_change_ours():
    vehicle, link = signed_pair()
    vehicle.tick(link)
    mine = int.from_bytes(link.encode_motors((0, 0, 0, 0), False, link.now_ns)[-12:-6], "little")
    runaway = Vehicle(key=KEY, clock_ns=vehicle.clock_ns, link_id=7)
    runaway.mav.signing.timestamp = vehicle.mav.signing.timestamp + 10**10
    assert runaway.tick(link) == []
    assert link.rejected["signature_from_the_future"] == 1
    after = int.from_bytes(link.encode_motors((0, 0, 0, 0), False, link.now_ns)[-12:-6], "little")
    assert after - mine < 10**5
    assert len(vehicle.tick(link)) == 1


def test_an_old_new_stream_is_refused_and_streams_are_bounded():
    vehicle, link = signed_pair()
    vehicle.tick(link)
    old = Vehicle(key=KEY, link_id=3)
    old.mav.signing.timestamp = vehicle.mav.signing.timestamp - 61 * 100_000
    assert old.tick(link) == []
    assert link.rejected["signature_too_old"] == 1
    for link_id in range(1, 40):
        many = Vehicle(key=KEY, clock_ns=vehicle.clock_ns, link_id=link_id)
        many.mav.signing.timestamp = vehicle.mav.signing.timestamp
        many.tick(link)
    assert link.rejected["too_many_streams"] > 0


def test_messages_that_pymavlink_accepts_without_signature_are_refused():
    """An unknown message id skips pymavlink's signature check; the allow-list stops it here."""
    _, link = signed_pair()
    frame = bytearray(Vehicle().imu())
    frame[7:10] = (0xEF, 0xBE, 0x0A)
    assert link.receive(bytes(frame), link.now_ns) == []
    assert link.rejected["message_not_allowed"] == 1


def test_the_signing_clock_may_start_at_its_first_use():
    clock = SigningClock(utc_at_first_use_ns=(1_420_070_400 + 77) * 10**9)
    link = Link(KEY, now_ns=10**12, signing_clock=clock)
    assert int.from_bytes(link.encode_motors((0, 0, 0, 0), False, 10**12)[-12:-6], "little") == 77 * 10**5
    assert int.from_bytes(link.encode_motors((0, 0, 0, 0), False, 10**12 + 10**9)[-12:-6], "little") == 78 * 10**5
    vehicle = Vehicle(key=KEY)
    vehicle.mav.signing.timestamp = 78 * 10**5
    assert len(vehicle.tick(link)) == 1


def test_a_key_must_be_32_bytes():
    with pytest.raises(ValueError, match="5 bytes"):
        VehicleLink(VehicleLinkConfig(), b"short")
