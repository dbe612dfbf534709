"""The link to the vehicle: genuine MAVLink bytes, and the reaction to each kind of bad input."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from protocol.mavlink.vehicle import ARMED, BatteryReading, FlowReading, ImuReading, RangeReading
from tests.onboard.links.pymavlink_vehicle import KEY, STEP_NS, Link, Vehicle


@pytest.fixture
def link():
    return Link()


# -- genuine bytes ----------------------------------------------------------------------------------------------------


def test_imu_is_decoded_with_units(link):
    (reading,) = Vehicle().tick(link)
    assert isinstance(reading, ImuReading)
    np.testing.assert_allclose(reading.accelerometer, (0.1001, -0.2, -9.8), rtol=1e-6)
    np.testing.assert_allclose(reading.gyroscope, (0.01, 0.02, 0.03), rtol=1e-6)
    assert reading.pressure_pa == pytest.approx(101325.0, abs=0.01)


def test_slow_sensors_are_decoded_with_units(link):
    vehicle = Vehicle()
    vehicle.tick(link)
    us = vehicle.clock_ns // 1000
    flow = mavlink.MAVLink_hil_optical_flow_message(us, 0, 16_000, 0.01, -0.02, 0.003, 0.004, 0.5, 2000, 180, 0, -1.0)
    (reading,) = link.receive(vehicle.pack(flow), link.now_ns)
    assert isinstance(reading, FlowReading)
    assert reading.integration_s == pytest.approx(0.016)
    np.testing.assert_allclose(reading[2:6], (0.01, -0.02, 0.003, 0.004), rtol=1e-6)
    assert reading.quality == 180
    rad = mavlink.MAVLink_optical_flow_rad_message(us, 0, 16_000, 0.01, -0.02, 0.003, 0.004, 0.5, 2000, 180, 0, -1.0)
    assert link.receive(vehicle.pack(rad), link.now_ns) == [reading]
    distance = mavlink.MAVLink_distance_sensor_message(us // 1000, 44, 400, 123, 1, 0, 25, 4)
    (reading,) = link.receive(vehicle.pack(distance), link.now_ns)
    assert isinstance(reading, RangeReading)
    assert reading.distance_m == pytest.approx(1.23)
    assert 0 <= link.now_ns - reading.time_ns < 2_000_000
    battery = mavlink.MAVLink_battery_status_message(0, 0, 1, 2500, [3999] + [0xFFFF] * 9, 400, 10, -1, 77)
    (reading,) = link.receive(vehicle.pack(battery), link.now_ns)
    assert isinstance(reading, BatteryReading)
    assert (reading.voltage_v, reading.remaining) == (pytest.approx(3.999), pytest.approx(0.77))
    system = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 3800, -1, -1, 0, 0, 0, 0, 0, 0)
    (reading,) = link.receive(vehicle.pack(system), link.now_ns)
    assert (reading.voltage_v, reading.remaining) == (pytest.approx(3.8), -1.0)
    heartbeat = mavlink.MAVLink_heartbeat_message(2, 8, 0, 0, 4, 3)
    assert link.receive(vehicle.pack(heartbeat), link.now_ns) == []
    assert link.last_heartbeat_ns == link.now_ns
    assert not link.rejected


def velocity_flow(vehicle, v_x=0.6, v_y=-0.3, distance=1.5, quality=200):
    return mavlink.MAVLink_optical_flow_message(vehicle.clock_ns // 1000, 3, 7, -9, v_x, v_y, quality, distance)


def test_a_flow_in_metres_per_second_becomes_the_angles_that_the_estimator_wants(link):
    """OPTICAL_FLOW (100): v_x = d (flow_y - rotation_y) / dt, v_y = -d (flow_x - rotation_x) / dt."""
    vehicle = Vehicle()
    vehicle.tick(link)  # its gyroscope: (0.01, 0.02, 0.03)
    (reading,) = link.receive(vehicle.pack(velocity_flow(vehicle)), link.now_ns)
    assert isinstance(reading, FlowReading)
    scale = 1.5 / reading.integration_s
    assert scale * (reading.flow_y - reading.rotation_y) == pytest.approx(0.6)
    assert -scale * (reading.flow_x - reading.rotation_x) == pytest.approx(-0.3)
    np.testing.assert_allclose(reading[4:6], np.multiply((0.01, 0.02), reading.integration_s), rtol=1e-6)
    assert reading.quality == 200
    assert 0 <= link.now_ns - reading.time_ns < 2_000_000
    assert link.last_flow_ns == link.now_ns


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"distance": -1.0}, "flow_distance"),  # unknown
        ({"distance": 0.0}, "flow_distance"),
        ({"distance": math.nan}, "flow_distance"),
        ({"distance": math.inf}, "flow_distance"),
        ({"distance": 13.0}, "flow_distance"),
        ({"v_x": math.nan}, "flow"),
        ({"v_y": math.inf}, "flow"),
        ({"v_x": 40.0}, "flow"),  # 27 rad/s
        ({"v_x": 1e30, "distance": 1e-30}, "flow"),
    ],
)
def test_a_bad_flow_in_metres_per_second_is_counted_and_dropped(link, values, reason):
    vehicle = Vehicle()
    vehicle.tick(link)
    assert link.receive(vehicle.pack(velocity_flow(vehicle, **values)), link.now_ns) == []
    assert link.rejected[reason] == 1
    assert len(link.receive(vehicle.pack(velocity_flow(vehicle)), link.now_ns)) == 1


def test_a_frozen_flow_in_metres_per_second_is_dropped_although_the_vehicle_turns(link):
    vehicle = Vehicle()
    for _ in range(9):
        vehicle.tick(link)
        link.receive(vehicle.pack(velocity_flow(vehicle)), link.now_ns)
    assert link.rejected["flow_frozen"] == 1


@pytest.mark.parametrize("armed", [True, False])
@pytest.mark.parametrize("key", [None, KEY])
def test_motor_command_has_the_bytes_that_pymavlink_writes(armed, key):
    link, vehicle = Link(key), Vehicle(key=key)
    for count in range(3):
        now_ns = 10**12 + count * STEP_NS
        controls = [0.25, 0.5, 0.75, 1.0] + [0.0] * 12 if armed else [0.0] * 16
        message = mavlink.MAVLink_hil_actuator_controls_message(now_ns // 1000, controls, ARMED if armed else 0, 0)
        vehicle.mav.signing.timestamp = now_ns // 10_000
        assert link.encode_motors((0.25, 0.5, 0.75, 1.0), armed, now_ns) == vehicle.pack(message)


def test_motors_are_off_unless_armed_and_when_a_number_is_not_finite(link):
    decoder = mavlink.MAVLink(None)
    for fractions, armed in (
        ((0.5, 0.5, 0.5, 0.5), False),
        ((0.5, math.nan, 0.5, 0.5), True),
        ((0.5, 0.5, math.inf, 0.5), True),
        ((math.inf, -math.inf, 0.5, 0.5), True),
    ):
        message = decoder.decode(bytearray(link.encode_motors(np.array(fractions), armed, link.now_ns)))
        assert (message.controls, message.mode) == ([0.0] * 16, 0)
    assert link.rejected["motor_command"] == 3


def test_motor_fractions_are_clipped(link):
    message = mavlink.MAVLink(None).decode(bytearray(link.encode_motors((-1.0, 0.5, 2.0, 1e300), True, 0)))
    assert message.controls[:4] == [0.0, 0.5, 1.0, 1.0]
    assert message.mode == ARMED


# -- datagrams --------------------------------------------------------------------------------------------------------


def test_a_truncated_datagram_does_not_affect_the_next_one(link):
    vehicle = Vehicle()
    vehicle.tick(link)
    for cut in range(len(vehicle.imu())):
        vehicle.clock_ns += STEP_NS
        link.now_ns += STEP_NS
        assert link.receive(vehicle.imu()[:cut], link.now_ns) == []
        assert len(vehicle.tick(link)) == 1


def test_several_frames_in_one_datagram(link):
    vehicle = Vehicle()
    frames = []
    for _ in range(3):
        vehicle.clock_ns += STEP_NS
        frames.append(vehicle.imu())
    assert len(link.receive(b"".join(frames), link.now_ns)) == 3
    bad = bytearray(frames[1])
    bad[20] ^= 1
    vehicle = Vehicle(clock_ns=vehicle.clock_ns + STEP_NS)
    assert len(link.receive(frames[0] + bytes(bad) + vehicle.imu(), link.now_ns)) == 1
    assert link.rejected["checksum"] == 1
    assert link.rejected["time_backwards"] == 1
    many = vehicle.pack(mavlink.MAVLink_heartbeat_message(2, 8, 0, 0, 4, 3)) * 40
    assert link.receive(many, link.now_ns) == []
    assert link.rejected["too_many_frames"] == 1


def test_every_wrong_bit_is_detected(link):
    vehicle = Vehicle()
    vehicle.tick(link)
    vehicle.clock_ns += STEP_NS
    good = vehicle.imu()
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        assert link.receive(bytes(bad), link.now_ns + STEP_NS) == []
    assert link.rejected.total() >= 8 * len(good)
    assert len(link.receive(good, link.now_ns + STEP_NS)) == 1


@given(st.binary(max_size=400))
@settings(max_examples=300, deadline=None)
def test_no_bytes_raise(data):
    assert Link().receive(data, 10**12) == []


@given(st.binary(min_size=1, max_size=65), st.sampled_from([107, 114, 106, 132, 147, 1, 0]))
@settings(max_examples=300, deadline=None)
def test_any_payload_with_a_good_checksum(payload, message_id):
    """Valid frames with any payload: readings are finite, and nothing raises."""
    link = Link()
    seed = mavlink.mavlink_map[message_id].crc_extra
    body = bytes((len(payload), 0, 0, 0, 1, 1, message_id, 0, 0)) + payload
    checksum = mavlink.mcrf4xx(bytes((seed,)), mavlink.mcrf4xx(body))
    for reading in link.receive(b"\xfd" + body + checksum.to_bytes(2, "little"), link.now_ns):
        for value in reading:
            assert all(math.isfinite(x) and abs(x) < 1e30 for x in (value if isinstance(value, tuple) else (value,)))


def test_mavlink_1_and_messages_not_on_the_list_are_refused(link):
    vehicle = Vehicle()
    old = mavlink.MAVLink_heartbeat_message(2, 8, 0, 0, 4, 3).pack(vehicle.mav, force_mavlink1=True)
    assert link.receive(bytes(old), link.now_ns) == []
    assert link.rejected["not_mavlink_2"] == 1
    command = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    assert link.receive(vehicle.pack(command), link.now_ns) == []
    assert link.rejected["message_not_allowed"] == 1


def test_unknown_flags_are_refused(link):
    frame = bytearray(Vehicle().imu())
    frame[2] = 0x02
    assert link.receive(bytes(frame), link.now_ns) == []
    assert link.rejected["unknown_flags"] == 1


# -- sensor faults ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e6])
@pytest.mark.parametrize("sensor", ["acc", "gyro"])
def test_impossible_numbers_are_refused_and_reported(link, bad, sensor):
    vehicle = Vehicle()
    vehicle.tick(link)
    assert vehicle.tick(link, **{sensor: (bad, 0.0, -9.8)}) == []
    assert link.rejected[{"acc": "accelerometer", "gyro": "gyroscope"}[sensor]] == 1
    assert "sample ignored" in link.texts()
    assert len(vehicle.tick(link)) == 1


@pytest.mark.parametrize("bad", [math.nan, math.inf, 0.0, 5000.0])
def test_bad_pressure_is_dropped_alone(link, bad):
    (reading,) = Vehicle().tick(link, pressure_hpa=bad)
    assert reading.pressure_pa is None
    assert link.rejected["pressure"] == 1
    assert "pressure gave" in link.texts()


def test_missing_fields_and_second_imus_are_refused(link):
    vehicle = Vehicle()
    assert vehicle.tick(link, fields=0b111) == []
    assert vehicle.tick(link, sensor=1) == []
    assert link.rejected["imu_fields"] == 2
    (reading,) = vehicle.tick(link, fields=0b111111)
    assert reading.pressure_pa is None


def test_a_frozen_imu_goes_silent_and_comes_back(link):
    vehicle = Vehicle()
    vehicle.tick(link)
    stuck = []
    for _ in range(20):
        vehicle.count = 0
        stuck += vehicle.tick(link)
    assert len(stuck) == 7  # may still be chance
    assert link.rejected["imu_frozen"] == 13
    assert "IMU frozen" in link.texts()
    assert len(vehicle.tick(link)) == 1


def test_frozen_detection_can_be_switched_off():
    link, vehicle = Link(frozen_samples=0), Vehicle()
    assert sum(len(vehicle.tick(link)) + (vehicle.__setattr__("count", 0) or 0) for _ in range(20)) == 20


def test_a_frozen_range_is_refused():
    link, vehicle = Link(frozen_ranges=5), Vehicle()
    vehicle.tick(link)
    for count in range(10):
        message = mavlink.MAVLink_distance_sensor_message(count, 44, 400, 100, 1, 0, 25, 4)
        assert len(link.receive(vehicle.pack(message), link.now_ns)) == (count < 5)
    assert link.rejected["range_frozen"] == 5
    assert "ultrasonic frozen" in link.texts()


def test_a_range_at_the_sensors_least_distance_is_not_frozen():
    link, vehicle = Link(frozen_ranges=5), Vehicle()
    vehicle.tick(link)
    for count in range(10):
        message = mavlink.MAVLink_distance_sensor_message(count, 44, 400, 44, 1, 0, 25, 4)
        assert len(link.receive(vehicle.pack(message), link.now_ns)) == 1
    assert "frozen" not in link.texts()


def flow_frame(x, gyro=0.01, duration_us=16_000):
    return mavlink.MAVLink_hil_optical_flow_message(1, 0, duration_us, x, 0.0, gyro, 0.0, 0.0, 0, 200, 0, -1.0)


def test_a_frozen_flow_is_refused_and_one_that_sees_nothing_is_not(link):
    vehicle = Vehicle()
    vehicle.tick(link)
    taken = [len(link.receive(vehicle.pack(flow_frame(0.1)), link.now_ns)) for _ in range(12)]
    assert taken == [1] * 8 + [0] * 4
    assert link.rejected["flow_frozen"] == 4
    assert "optical flow frozen" in link.texts()
    blind = [len(link.receive(vehicle.pack(flow_frame(0.0, gyro=0.0)), link.now_ns)) for _ in range(12)]
    assert blind == [1] * 12


def test_a_frozen_pressure_is_dropped_alone():
    link, vehicle = Link(frozen_pressures=3), Vehicle()
    given = [vehicle.tick(link)[0].pressure_pa is not None for _ in range(6)]
    assert given == [True] * 3 + [False] * 3
    assert link.rejected["pressure_frozen"] == 3
    assert "pressure frozen" in link.texts()


@pytest.mark.parametrize(
    ("centimetres", "orientation", "reason"),
    [(0, 25, "range"), (5000, 25, "range"), (100, 0, "range_orientation")],
)
def test_invalid_ranges_are_refused(link, centimetres, orientation, reason):
    message = mavlink.MAVLink_distance_sensor_message(5, 44, 400, centimetres, 1, 0, orientation, 4)
    assert link.receive(Vehicle().pack(message), link.now_ns) == []
    assert link.rejected[reason] == 1


def test_invalid_flows_and_batteries_are_refused(link):
    vehicle = Vehicle()
    vehicle.tick(link)
    for duration, x in ((0, 0.1), (900_000, 0.1), (16_000, math.nan), (16_000, 5.0)):
        assert link.receive(vehicle.pack(flow_frame(x, duration_us=duration)), link.now_ns) == []
    assert (link.rejected["flow_time"], link.rejected["flow"]) == (2, 2)
    assert "flow gave nan: sample ignored" in link.texts()
    for millivolts, percent in (([0xFFFF] * 10, 50), ([65_000] * 10, 50), ([4000] + [0xFFFF] * 9, 101)):
        battery = mavlink.MAVLink_battery_status_message(0, 0, 1, 0, millivolts, 0, 0, -1, percent)
        assert link.receive(vehicle.pack(battery), link.now_ns) == []
    assert link.rejected["battery"] == 3
