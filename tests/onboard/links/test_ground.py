"""The link to the ground station; pymavlink plays the station."""

import math
import time
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink
from pymavlink.dialects.v20 import development

from onboard.estimation.state import VehicleState
from onboard.flight.modes import Command, FlightMode
from onboard.links.ground import GroundLink, GroundLinkConfig
from protocol.mavlink.vehicle import BatteryReading

STEP_NS = 5_000_000
KEY = bytes(range(32))
BATTERY = BatteryReading(0, 3.87, 0.64)


class Station:
    """A ground station: sends with pymavlink, collects and decodes what it receives."""

    def __init__(self, link, key=None):
        self.link = link
        self.mav = mavlink.MAVLink(None, 255, 190)
        self.decoder = mavlink.MAVLink(None)
        self.now_ns = 10**12
        if key is not None:
            for one in (self.mav, self.decoder):
                one.signing.secret_key = key
                one.signing.sign_outgoing = True
                one.signing.timestamp = self.now_ns // 10_000
        self.state = VehicleState()
        self.state.initialised = True
        self.mode = FlightMode.READY
        self.received = []

    def send(self, message):
        frame = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256
        return self.link.receive(frame, self.now_ns)

    def command(self, number, *parameters, target=1, confirmation=0):
        values = (*parameters, *([0.0] * (7 - len(parameters))))
        return self.send(mavlink.MAVLink_command_long_message(target, 1, number, confirmation, *values))

    def listen(self, ticks=1):
        """Advance some ticks; returns the messages received in them."""
        new = []
        for _ in range(ticks):
            self.now_ns += STEP_NS
            self.state.last_imu_ns = self.state.last_pose_ns = self.now_ns
            datagrams = self.link.poll(self.now_ns, self.mode, self.state, BATTERY)
            assert len(datagrams) <= 1
            new += [self.decoder.decode(bytearray(datagram)) for datagram in datagrams]
        self.received += new
        return new

    def first(self, kind, ticks=400):
        return next(message for message in self.listen(ticks) if message.get_type() == kind)


@pytest.fixture
def station():
    return Station(GroundLink(GroundLinkConfig()))


# -- telemetry --------------------------------------------------------------------------------------------------------


def test_rates_are_as_configured_and_at_most_one_message_a_tick(station):
    station.link.values = {"feat_ver": 3.0, "feat_age": 1.5, "track_err": 0.02}
    counts = Counter(message.get_type() for message in station.listen(2000))  # ten seconds
    assert counts["ATTITUDE_QUATERNION"] == pytest.approx(100, abs=2)
    assert counts["LOCAL_POSITION_NED"] == pytest.approx(100, abs=2)
    assert counts["HEARTBEAT"] == pytest.approx(10, abs=1)
    assert counts["SYS_STATUS"] == pytest.approx(20, abs=1)
    assert counts["NAMED_VALUE_FLOAT"] == pytest.approx(60, abs=2)


def test_contents_of_the_telemetry(station):
    state = station.state
    state.position[:] = (1.0, -2.0, -1.5)
    state.velocity[:] = (0.1, 0.2, -0.3)
    state.quaternion[:] = (0.8, 0.6, 0.0, 0.0)
    state.rates[:] = (0.1, 0.2, 0.3)
    state.height_valid = True
    station.mode = FlightMode.FLYING
    attitude = station.first("ATTITUDE_QUATERNION")
    assert (attitude.q1, attitude.q2) == (pytest.approx(0.8), pytest.approx(0.6))
    assert attitude.yawspeed == pytest.approx(0.3)
    position = station.first("LOCAL_POSITION_NED")
    assert (position.x, position.y, position.z, position.vz) == tuple(map(pytest.approx, (1.0, -2.0, -1.5, -0.3)))
    assert position.time_boot_ms == pytest.approx(station.now_ns // 10**6, abs=2100)
    heartbeat = station.first("HEARTBEAT")
    assert heartbeat.type == mavlink.MAV_TYPE_QUADROTOR
    assert heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert heartbeat.custom_mode == FlightMode.FLYING
    status = station.first("SYS_STATUS")
    assert (status.voltage_battery, status.battery_remaining) == (3870, 64)


@pytest.mark.parametrize("mode", list(FlightMode), ids=lambda mode: mode.name)
def test_armed_bit_is_set_only_when_the_motors_may_turn(station, mode):
    station.mode = mode
    armed = bool(station.first("HEARTBEAT").base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    on = {"ARMED", "TAKE_OFF", "FLYING", "HOLD", "HOLD_LEVEL", "LANDING"}
    assert armed == (mode.name in on)


def test_health_bits(station):
    station.state.height_valid = True
    status = station.first("SYS_STATUS")
    assert status.onboard_control_sensors_health == status.onboard_control_sensors_present
    assert status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_GEOFENCE  # or stations report a fence breach
    station.now_ns += 10**9
    unhealthy = [
        station.decoder.decode(bytearray(datagram))
        for _ in range(600)
        for datagram in station.link.poll(station.now_ns + _ * STEP_NS, FlightMode.BOOT, station.state, BATTERY)
    ]
    health = next(m for m in unhealthy if m.get_type() == "SYS_STATUS").onboard_control_sensors_health
    assert not health & mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    assert not health & mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION
    assert not health & mavlink.MAV_SYS_STATUS_PREARM_CHECK


def test_an_unknown_battery_is_reported_as_unknown(station):
    nothing = BatteryReading(0, 0.0, -1.0)
    for tick in range(400):
        for datagram in station.link.poll(10**12 + tick * STEP_NS, FlightMode.READY, station.state, nothing):
            message = station.decoder.decode(bytearray(datagram))
            if message.get_type() == "SYS_STATUS":
                assert (message.voltage_battery, message.battery_remaining) == (0xFFFF, -1)
                return
    pytest.fail("no SYS_STATUS")


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e39])
def test_numbers_that_are_not_finite_are_not_sent(station, bad):
    station.state.position[0] = bad
    station.link.values = {"wild": bad}
    kinds = {message.get_type() for message in station.listen(400)}
    assert kinds == {"ATTITUDE_QUATERNION", "HEARTBEAT", "SYS_STATUS"}
    assert station.link.rejected["not_finite_telemetry"] > 20


def test_texts_are_sent_whole_or_in_chunks(station):
    station.link.send_text("short", mavlink.MAV_SEVERITY_WARNING)
    station.link.send_text("0123456789" * 12)
    received = station.listen(4)
    assert [m.get_type() for m in received] == ["STATUSTEXT"] * 4
    assert (received[0].text, received[0].severity, received[0].id) == ("short", mavlink.MAV_SEVERITY_WARNING, 0)
    assert "".join(m.text for m in received[1:]) == "0123456789" * 12
    assert [m.chunk_seq for m in received[1:]] == [0, 1, 2]
    assert len({m.id for m in received[1:]}) == 1


def test_waiting_texts_are_bounded(station):
    for _ in range(1000):
        station.link.send_text("ü" * 60)
    assert Counter(m.get_type() for m in station.listen(64))["STATUSTEXT"] == 32


# -- commands ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "parameters", "command"),
    [
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,), Command.ARM),
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,), Command.DISARM),
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0, 21196.0), Command.TERMINATE),
        (mavlink.MAV_CMD_NAV_TAKEOFF, (), Command.TAKE_OFF),
        (mavlink.MAV_CMD_NAV_LAND, (), Command.LAND),
        (mavlink.MAV_CMD_DO_FLIGHTTERMINATION, (1.0,), Command.TERMINATE),
    ],
)
def test_commands_and_their_acknowledgement(station, number, parameters, command):
    (one,) = station.command(number, *parameters)
    assert one.command is command
    assert [m for m in station.listen(50) if m.get_type() == "COMMAND_ACK"] == []  # not before the core has decided
    station.link.acknowledge(one, "", station.now_ns)
    (ack,) = station.listen()
    assert (ack.command, ack.result) == (number, mavlink.MAV_RESULT_ACCEPTED)
    assert (ack.target_system, ack.target_component) == (255, 190)


def test_a_refusal_is_acknowledged_and_explained(station):
    (one,) = station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    station.link.acknowledge(one, "no fresh pose", station.now_ns)
    ack, text = station.listen(2)
    assert ack.result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    assert text.text == "refused to arm: no fresh pose"


def test_a_repeated_command_is_answered_but_not_executed_again(station):
    (one,) = station.command(mavlink.MAV_CMD_NAV_LAND)
    station.link.acknowledge(one, "", station.now_ns)
    station.listen()
    assert station.command(mavlink.MAV_CMD_NAV_LAND, confirmation=1) == []
    assert station.first("COMMAND_ACK").result == mavlink.MAV_RESULT_ACCEPTED
    station.listen(1200)
    assert len(station.command(mavlink.MAV_CMD_NAV_LAND, confirmation=1)) == 1


@pytest.mark.parametrize(
    ("number", "parameters"),
    [
        (mavlink.MAV_CMD_DO_FLIGHTTERMINATION, (0.0,)),
        (mavlink.MAV_CMD_DO_FLIGHTTERMINATION, (math.nan,)),
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (math.nan,)),
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.5,)),
        (mavlink.MAV_CMD_REQUEST_MESSAGE, (148.0,)),
        (60_000, ()),
    ],
)
def test_an_unsupported_command_is_refused_at_once(station, number, parameters):
    assert station.command(number, *parameters) == []
    (ack,) = station.listen()
    assert (ack.get_type(), ack.result) == ("COMMAND_ACK", mavlink.MAV_RESULT_UNSUPPORTED)


def test_commands_for_others_and_our_own_echo_are_ignored(station):
    assert station.command(mavlink.MAV_CMD_NAV_LAND, target=7) == []
    assert station.link.rejected["other_target"] == 1
    assert len(station.command(mavlink.MAV_CMD_NAV_LAND, target=0)) == 1
    echo = Station(station.link)
    echo.mav.srcSystem = 1
    assert echo.command(mavlink.MAV_CMD_NAV_LAND) == []
    assert station.link.rejected["own_echo"] == 1


def test_with_a_key_only_signed_commands_count():
    link = GroundLink(GroundLinkConfig(), KEY)
    assert Station(link).command(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1.0) == []
    assert link.rejected["unsigned"] == 1
    friend = Station(link, KEY)
    assert len(friend.command(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1.0)) == 1
    assert friend.first("HEARTBEAT").get_signed()


# -- requests ---------------------------------------------------------------------------------------------------------


def test_file_transfer_is_refused_at_once(station):
    payload = bytearray(251)
    payload[0:2] = (41).to_bytes(2, "little")
    payload[2], payload[3] = 5, 4  # session, OpenFileRO
    station.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, list(payload)))
    (reply,) = station.listen()
    answer = bytes(reply.payload)
    assert int.from_bytes(answer[0:2], "little") == 42
    assert (answer[2], answer[3], answer[4], answer[5], answer[12]) == (5, 129, 1, 4, 7)
    assert (reply.target_system, reply.target_component) == (255, 190)


def test_parameter_and_mission_lists_have_an_end(station):
    station.send(mavlink.MAVLink_param_request_list_message(1, 1))
    (value,) = station.listen()
    assert (value.get_type(), value.param_count, value.param_index) == ("PARAM_VALUE", 1, 0)
    station.send(mavlink.MAVLink_mission_request_list_message(1, 1))
    (count,) = station.listen()
    assert (count.get_type(), count.count) == ("MISSION_COUNT", 0)


def test_heartbeats_count_as_received(station):
    assert station.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)) == []
    assert station.link.last_received_ns == station.now_ns


@given(st.binary(max_size=300))
@settings(max_examples=200, deadline=None)
def test_no_bytes_raise(data):
    assert GroundLink(GroundLinkConfig()).receive(data, 10**12) == []


@given(st.binary(min_size=1, max_size=255), st.sampled_from([0, 76, 110, 20, 21, 43]))
@settings(max_examples=200, deadline=None)
def test_any_payload_with_a_good_checksum(payload, message_id):
    link = GroundLink(GroundLinkConfig())
    body = bytes((len(payload), 0, 0, 0, 255, 1, message_id, 0, 0)) + payload
    checksum = mavlink.mcrf4xx(bytes((mavlink.mavlink_map[message_id].crc_extra,)), mavlink.mcrf4xx(body))
    for command in link.receive(b"\xfd" + body + checksum.to_bytes(2, "little"), 10**12):
        link.acknowledge(command, "no", 10**12)
    station = Station(link)
    station.listen(20)


def test_cost(station):
    costs = []
    for _ in range(2000):
        station.now_ns += STEP_NS
        start = time.perf_counter_ns()
        station.link.poll(station.now_ns, station.mode, station.state, BATTERY)
        costs.append(time.perf_counter_ns() - start)
    assert sorted(costs)[1000] < 20_000


def ask_for_modes(station, index):
    assert (
        station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, float(development.MAVLINK_MSG_ID_AVAILABLE_MODES), index) == []
    )
    datagrams = []
    for _ in range(40):
        station.now_ns += STEP_NS
        datagrams += station.link.poll(station.now_ns, station.mode, station.state, BATTERY)
    decoder = development.MAVLink(None)  # the common dialect does not have the message
    messages = [decoder.decode(bytearray(datagram)) for datagram in datagrams]
    [answer] = [one for one in messages if one.get_type() == "COMMAND_ACK"]
    return answer.result, [one for one in messages if one.get_type() == "AVAILABLE_MODES"]


def test_a_station_gets_the_name_of_every_mode():
    result, modes = ask_for_modes(Station(GroundLink(GroundLinkConfig())), 0.0)
    assert result == mavlink.MAV_RESULT_ACCEPTED
    assert {mode.custom_mode: mode.mode_name for mode in modes} == {int(mode): mode.name for mode in FlightMode}
    assert [mode.mode_index for mode in modes] == list(range(1, len(FlightMode) + 1))
    assert {mode.number_modes for mode in modes} == {len(FlightMode)}
    assert {mode.properties for mode in modes} == {development.MAV_MODE_PROPERTY_NOT_USER_SELECTABLE}


@pytest.mark.parametrize(
    ("index", "result", "names"), [(5.0, 0, ["FLYING"]), (12.0, 2, []), (-1.0, 2, []), (math.nan, 2, [])]
)
def test_a_station_may_ask_for_one_mode(index, result, names):
    found, modes = ask_for_modes(Station(GroundLink(GroundLinkConfig())), index)
    assert (found, [mode.mode_name for mode in modes]) == (result, names)
