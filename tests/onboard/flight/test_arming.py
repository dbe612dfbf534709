"""With the settings for a real vehicle: only a person arms, and only if link, battery and pose are good.

And the effect of the limits: without one, a flight crashes that ends safely with it.
"""

from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from onboard.flight.modes import SPINNING, FlightMode
from onboard.links.health import BLOCK_SAMPLES, BLOCKS, NOT_JUDGED, LinkHealth, LinkHealthConfig
from onboard.preflight.certificate import CLEAR, Clearance
from protocol.messages import Pose
from tests.onboard.loop import Loop, Peer

REST = (0.0, 0.0, -9.81)


# -- the check of the stream --------------------------------------------------------------------------------------


def judged(samples=200, period_s=0.005, clock=1.0, force=REST, rates=(0.02, 0.0, -0.01), late=lambda k: 0.0, stuck=()):
    """The fault after a stream of samples; `late(k)` is the delay of sample k, s."""
    health, rng = LinkHealth(LinkHealthConfig()), np.random.default_rng(1)
    noise = np.array([0.2, 0.2, 0.2, 0.01, 0.01, 0.01])
    noise[list(stuck)] = 0.0
    for k in range(samples):
        due_s = k * period_s
        arrival_ns = round((due_s + late(k)) * 1e9)
        inertial = tuple(np.array([*force, *rates]) + rng.normal(0.0, 1.0, 6) * noise)
        health.add(round(due_s * clock * 1e9), round(late(k) * 1e9), arrival_ns, inertial)
    return health.fault


@pytest.mark.parametrize(
    ("stream", "fault"),
    [
        ({}, ""),
        ({"samples": BLOCK_SAMPLES}, ""),
        ({"samples": BLOCK_SAMPLES - 1}, NOT_JUDGED),
        ({"period_s": 0.01}, "IMU at 100 Hz"),
        ({"period_s": 0.004}, "IMU at 250 Hz"),
        ({"clock": 0.001}, "time base"),
        ({"clock": 1000.0}, "time base"),
        ({"late": lambda k: 0.004 * (k % 2)}, ""),
        ({"late": lambda k: 0.015 * (k % 10 == 0)}, "IMU jitter: 10%"),
        ({"late": lambda k: 0.05 * (k >= 120)}, "IMU gap of 55 ms"),
        ({"force": (0.0, 0.0, -1.0)}, "accelerometer gives 1"),
        ({"force": (0.0, 0.0, 9.81)}, "accelerometer z gives +9.8 m/s^2 at rest, not -9.8"),
        ({"force": (-9.8, 0.0, 0.1)}, "gravity is on accelerometer x"),
        ({"force": (3.0, 0.0, -9.3)}, ""),
        ({"rates": (0.0, 5.2, 0.0)}, "gyroscope y gives +5.2 rad/s"),
        ({"rates": (0.15, -0.15, 0.1)}, ""),
        ({"stuck": (1,)}, "accelerometer y never changes: stuck"),
        ({"stuck": (5,)}, "gyroscope z never changes: stuck"),
        ({"force": (0.09, -0.06, -9.47)}, ""),
    ],
)
def test_faults_of_a_stream(stream, fault):
    found = judged(**stream)
    assert found.startswith(fault)
    assert bool(found) == bool(fault)


def test_a_fault_ends_after_a_good_second():
    last = BLOCKS * BLOCK_SAMPLES

    def stall(k):
        return max(0.0, 0.05 - 0.005 * (k - 130)) if k >= 130 else 0.0

    assert "gap" in judged(samples=300, late=stall)
    assert judged(samples=150 + last, late=stall) == ""


# -- arming -----------------------------------------------------------------------------------------------------------


class FaultyPeer(Peer):
    """Offboard with a fault in the poses that it relays."""

    def __init__(self, fault):
        super().__init__()
        self.fault = fault

    def say(self, truth, tick, now_ns):
        return [self.fault(m) if isinstance(m, Pose) else m for m in super().say(truth, tick, now_ns)]


class RealFlight(Loop):
    """The simulated vehicle with the settings for a real one, with motion capture and a person at a ground station."""

    def __init__(self, fault=None, assignments=(), poses=True, pose_fault=lambda pose: pose, clearance=CLEAR):
        super().__init__("pid", "hover", FaultyPeer(pose_fault), assignments, True, clearance)
        self.fault, self.peer.relays = fault or self.fault, poses
        self.station, self.heartbeats = mavlink.MAVLink(None, 255, 190), True
        self.modes, self.texts, self.answers = [], [], []

    def type(self, command, *parameters):
        values = [*map(float, parameters), *(0.0,) * 7][:7]
        return self.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, *values))

    def send(self, message):
        self.from_ground.append(bytes(message.pack(self.station)))
        return self

    def arm(self):
        return self.type(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def take_off(self):
        return self.fly(2.1).arm().fly(0.5).type(mavlink.MAV_CMD_NAV_TAKEOFF).fly(4.0)

    def step(self):
        if self.heartbeats and self.tick % 200 == 0:
            self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        super().step()
        self.modes.append(self.mode)
        for datagram in self.to_ground:
            message = mavlink.MAVLink(None).decode(bytearray(datagram))
            if message.get_type() == "STATUSTEXT":
                self.texts.append(message.text)
            elif message.get_type() == "COMMAND_ACK":
                self.answers.append(message.result)


def changed(frame, change, kind="HIL_SENSOR"):
    """A frame of a kind with `change(message)` made to it; other frames as they are."""
    message = mavlink.MAVLink(None).decode(bytearray(frame))
    if message.get_type() != kind:
        return frame
    change(message)
    return bytes(message.pack(mavlink.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())))


def with_all(change):
    return lambda t, frames: [changed(frame, change) for frame in frames]


def milliseconds(message):
    message.time_usec //= 1000


def g_units(message):
    message.xacc, message.yacc, message.zacc = (value / 9.81 for value in (message.xacc, message.yacc, message.zacc))


def every_other(t, frames):
    return (
        frames if round(t * 200) % 2 else [frame for frame in frames if frame[7] != mavlink.MAVLINK_MSG_ID_HIL_SENSOR]
    )


class InBatches:
    """Holds frames back and releases those of five ticks at once."""

    def __init__(self):
        self.held = []

    def __call__(self, t, frames):
        self.held += frames
        if round(t * 200) % 5:
            return []
        frames, self.held = self.held, []
        return frames


def second_vehicle(behind_s):
    """A vehicle with the same system id and another clock."""

    def fault(t, frames):
        if t < 1.0:
            return frames
        return [
            *frames,
            *(changed(f, lambda m: setattr(m, "time_usec", m.time_usec - round(behind_s * 1e6))) for f in frames),
        ]

    return fault


def from_north_west_up(pose):
    """Body forward, left, up, and its pose in axes north, west, up."""
    w, x, y, z = pose.quaternion
    return replace(pose, quaternion=np.array([-x, w, -z, y], dtype=np.float32))


def in_millimetres(pose):
    return replace(pose, position_ned_m=pose.position_ned_m * np.float32(1000.0))


def from_the_ceiling(pose):
    return replace(pose, position_ned_m=pose.position_ned_m + np.array([0.0, 0.0, 2.5], dtype=np.float32))


SILENT = "vehicle.disturbances=[{{kind: sensor_fault, sensor: {}, fault: silent}}]"


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"fault": every_other}, "IMU at 100 Hz"),
        ({"fault": InBatches()}, "IMU jitter"),
        ({"fault": with_all(milliseconds)}, "time base"),
        ({"fault": with_all(g_units)}, "accelerometer gives"),
        ({"fault": second_vehicle(0.8)}, "two vehicles"),
        ({"fault": second_vehicle(0.2)}, "time base: 100%"),
        ({"assignments": (SILENT.format("battery"),)}, "no battery report"),
        ({"assignments": ("onboard.supervisor.battery_arm_v=4.3",)}, "battery at 4."),
        ({"poses": False}, "no fresh pose"),
        ({"pose_fault": from_north_west_up}, "pose and IMU are 180 deg apart"),
        ({"pose_fault": in_millimetres}, "pose is "),
        ({"pose_fault": from_the_ceiling}, "pose is -2.4"),
        ({"assignments": (SILENT.format("flow"),)}, "no optical flow"),
        ({"clearance": Clearance("no preflight_x.json: run dmrac preflight")}, "no preflight_x.json"),
        ({"assignments": (SILENT.format("imu"),)}, NOT_JUDGED),
    ],
)
def test_arming_is_refused_and_the_reason_is_an_event_and_a_text(settings, reason):
    flight = RealFlight(**settings).fly(3.2).arm().fly(0.3)
    assert not SPINNING & set(flight.modes)
    assert any(text.startswith(f"refused to arm: {reason}") for text in flight.events), flight.events
    assert any(text.startswith(f"refused to arm: {reason}"[:50]) for text in flight.texts)
    assert any(text.startswith(f"not ready to arm: {reason}") for text in flight.events)
    assert flight.answers == [mavlink.MAV_RESULT_TEMPORARILY_REJECTED]


def test_an_overridden_preflight_is_reported_to_log_and_pilot():
    flight = RealFlight(clearance=Clearance(notice="PREFLIGHT OVERRIDDEN")).fly(0.2)
    assert flight.events.count("PREFLIGHT OVERRIDDEN") == 1
    assert flight.texts.count("PREFLIGHT OVERRIDDEN") == 1


def test_a_good_vehicle_waits_for_its_pilot_flies_and_lands_when_the_ground_station_is_silent():
    flight = RealFlight().fly(3.0)
    assert flight.modes[-1] is FlightMode.READY
    flight.arm().fly(0.5)
    assert flight.modes[-1] is FlightMode.ARMED
    flight.type(mavlink.MAV_CMD_NAV_TAKEOFF).fly(4.0)
    assert flight.modes[-1] is FlightMode.FLYING
    assert flight.answers == [mavlink.MAV_RESULT_ACCEPTED] * 2
    flight.heartbeats = False
    flight.fly(10.0)
    assert "FLYING -> LANDING: ground station silent" in flight.events
    assert FlightMode.LANDED in flight.modes
    assert not flight.vehicle.crash_reason
    assert flight.modes[-1] in (FlightMode.LANDED, FlightMode.BOOT)
    assert "not ready to arm: no ground station" in flight.events


def pushed(message):
    message.yacc += 0.8
    message.xgyro += 0.1


def test_a_vehicle_that_moved_during_its_calibration_is_refused_and_armed_after_a_rest():
    flight = RealFlight(lambda t, frames: [changed(f, pushed) if 1.2 < t < 3.2 else f for f in frames]).fly(1.1)
    assert flight.core.status(flight.now_ns)["not_ready"] == "calibrating the IMU"
    flight.fly(1.9).arm().fly(0.1)
    moved = "the vehicle moved during the calibration of its IMU"
    assert any(text.startswith(f"{moved}: ") for text in flight.events)
    assert flight.said(f"refused to arm: {moved}")
    assert any(text.startswith(f"refused to arm: {moved}"[:50]) for text in flight.texts)
    assert flight.answers == [mavlink.MAV_RESULT_TEMPORARILY_REJECTED]
    assert not SPINNING & set(flight.modes)
    flight.fly(2.7).arm().fly(0.1)
    assert flight.modes[-1] is FlightMode.ARMED
    calibration = flight.core.summary()["calibration"]
    assert (calibration["accepted"], calibration["movements"]) == (1, 1)
    np.testing.assert_allclose(calibration["gyro_bias_rad_s"], flight.vehicle._imu.bias[3:6], atol=0.003)


def test_the_calibration_is_kept_for_the_second_flight():
    flight = RealFlight().take_off()
    flight.type(mavlink.MAV_CMD_NAV_LAND).fly(6.0)
    assert flight.modes[-1] is FlightMode.READY
    flight.arm().fly(0.1)
    assert flight.modes[-1] is FlightMode.ARMED
    assert len(flight.said("IMU calibrated")) == 1
    assert flight.core.summary()["calibration"]["accepted"] == 1


def test_flight_termination_stops_the_motors_in_the_air_until_the_end():
    flight = RealFlight().take_off()
    flight.type(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1).fly(0.1)
    assert flight.modes[-1] is FlightMode.TERMINATED
    controls = mavlink.MAVLink(None).decode(bytearray(flight.motors[0]))
    assert (controls.controls, controls.mode) == ([0.0] * 16, 0)
    flight.arm().fly(0.2)
    assert flight.modes[-1] is FlightMode.TERMINATED


# -- the effect of the limits ------------------------------------------------------------------------------------------


def farthest(flight):
    """Greatest horizontal distance from the origin, m."""
    return float(np.hypot(*np.transpose(flight.truths)[:2]).max())


def alone(seconds, *assignments):
    """A flight in simulation without offboard: (crash reason, last mode, greatest distance from the origin)."""
    flight = Loop(assignments=("onboard.pose_wait_s=0.5", *assignments)).fly(seconds)
    return flight.vehicle.crash_reason, flight.mode, farthest(flight)


BLIND_IN_THE_WIND = (
    "vehicle.disturbances=[{kind: wind, velocity_ned_m_s: [0.0, 2.0, 0.0], onset_s: 3.0},"
    "{kind: sensor_fault, sensor: flow, fault: silent, onset_s: 4.0}]"
)
WEAK_ROTOR = "vehicle.disturbances=[{kind: rotor_chip, rotor: 1, thrust_factor: 0.02}]"


def test_without_the_limit_on_lost_velocity_a_blind_vehicle_never_lands():
    crash, mode, far = alone(11.0, BLIND_IN_THE_WIND)
    assert (crash, mode in (FlightMode.LANDED, FlightMode.BOOT, FlightMode.READY)) == ("", True)
    assert far < 4.0
    unlimited = ("onboard.supervisor.velocity_lost_s=1000", "onboard.supervisor.hold_max_s=1000")
    crash, mode, _ = alone(16.0, BLIND_IN_THE_WIND, *unlimited)
    assert crash or mode is FlightMode.HOLD


def test_without_the_limit_on_tilt_a_weak_rotor_turns_the_vehicle_over_at_take_off():
    crash, mode, _ = alone(6.0, WEAK_ROTOR, "onboard.supervisor.tilt_max_rad=0.45")
    assert (crash, mode) == ("", FlightMode.EMERGENCY)
    crash, _, _ = alone(6.0, WEAK_ROTOR, "onboard.supervisor.tilt_max_rad=3.1")
    assert "tilted" in crash


def carried_along(t, frames):
    """The floor that the camera sees moves by 0.4 m/s, like a cloth in the wind."""

    def shift(message):
        message.integrated_y += 0.4 * message.integration_time_us * 1e-6

    return [changed(frame, shift, "HIL_OPTICAL_FLOW") for frame in frames]


@pytest.mark.parametrize("limit_s", [0.5, 1000.0])
def test_without_the_limit_on_the_age_of_the_pose_a_vehicle_flies_on_after_a_moving_floor(limit_s):
    trusting = (
        "onboard.estimator.pose_drift_m=1000"  # otherwise the poses are refused, because the flow contradicts them
    )
    settings = (f"onboard.supervisor.pose_stale_s={limit_s}", "onboard.guidance.land_after_s=300", trusting)
    flight = RealFlight(carried_along, settings).take_off()
    assert flight.modes[-1] is FlightMode.FLYING
    flight.peer.relays = False
    flight.fly(30.0)
    if limit_s < 1.0:
        assert "FLYING -> HOLD: position lost" in flight.events
        assert "not ready to arm: no fresh pose" in flight.events
        assert not flight.vehicle.crash_reason
        assert farthest(flight) < 5.0
    else:
        assert "m from the origin" in flight.vehicle.crash_reason


DYING_BATTERY = (
    "vehicle.disturbances=[{kind: battery_sag, drop_v: 2.0, time_constant_s: 4.0, onset_s: 16.0},"
    "{kind: sensor_fault, sensor: battery, fault: silent, onset_s: 4.5}]"
)


def test_without_the_limit_on_the_age_of_the_battery_report_a_dying_battery_drops_the_vehicle():
    high = ("onboard.guidance.trajectory.altitude_m=3.0", "onboard.guidance.trajectory.takeoff_s=4")
    settings = (DYING_BATTERY, *high, "onboard.guidance.land_after_s=300")
    crash, mode, _ = alone(18.0, *settings, "onboard.supervisor.battery_silent_s=3")
    assert (crash, mode in (FlightMode.LANDED, FlightMode.BOOT, FlightMode.READY)) == ("", True)
    crash, _, _ = alone(30.0, *settings)
    assert "hit the floor" in crash


def test_without_the_limit_on_the_age_of_the_ground_station_nobody_can_end_the_flight():
    flight = RealFlight(assignments=("onboard.supervisor.ground_silent_s=0",)).take_off()
    flight.heartbeats = False
    assert flight.fly(8.0).modes[-1] is FlightMode.FLYING
