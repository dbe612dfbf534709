"""Sensor faults of a flying simulated vehicle, without offboard: the result of the flight, and the events.

These flights also show that simulation and onboard use the same signs: on optical flow and ultrasound alone the
estimated position is right, and with a reversed sign it is not.
"""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from onboard.core import OnboardCore
from onboard.flight.supervisor import FlightMode
from protocol.mavlink.vehicle import FlowReading
from protocol.session import session_number
from sim_vehicle.vehicle import SimVehicle
from tests.onboard.loop import Loop, armed

FAULT_S = 6.0
"""When a fault begins; the vehicle is in steady flight by then."""


class FlightTest(Loop):
    """A flight without offboard: position errors, modes and motor commands of every tick."""

    def __init__(self, scenario="hover", fault=None, assignments=(), change=None, session=1, keys=(None, None)):
        """`keys`: of onboard's end of the vehicle's link, and of the vehicle's."""
        super().__init__("pid", scenario, None, assignments)
        self.vehicle = SimVehicle(self.config.vehicle, self.config.seed, keys[1])
        self.core = OnboardCore(self.config.onboard, session, None, keys[0])
        self.fault, self.modes, self.commands = fault or self.fault, [], []
        if change is not None:
            change(self.core)

    def step(self):
        super().step()
        self.modes.append(self.mode)
        self.commands.append(armed(self.motors[0])[1])

    @property
    def errors(self):
        return np.array(self.truths)[:, :3] - self.vector("position")


def rewrite(frame, **fields):
    """A HIL_SENSOR frame with other values; other frames unchanged."""
    codec = mavlink.MAVLink(None)
    message = codec.decode(bytearray(frame))
    if message.get_type() != "HIL_SENSOR":
        return frame
    for name, value in fields.items():
        setattr(message, name, value)
    codec.srcSystem, codec.srcComponent, codec.seq = message.get_srcSystem(), message.get_srcComponent(), 0
    return bytes(message.pack(codec))


def is_imu(frame):
    return frame[7] == mavlink.MAVLINK_MSG_ID_HIL_SENSOR


def test_flow_and_ultrasound_carry_a_flight():
    flight = FlightTest("figure8_calm").fly(16.0)
    assert FlightMode.FLYING in flight.modes
    assert not flight.vehicle.crash_reason
    assert np.abs(flight.errors[1400:]).max() < 0.2


@pytest.mark.parametrize("sign", [(-1.0, 1.0), (1.0, -1.0)])
def test_with_a_reversed_sign_of_the_flow_it_is_lost(sign):
    """Ablation of the test above: both signs of the flow matter."""

    def change(core):
        receive = core._estimator.receive

        def turned(reading):
            if isinstance(reading, FlowReading):
                x = reading.rotation_x + sign[0] * (reading.flow_x - reading.rotation_x)
                y = reading.rotation_y + sign[1] * (reading.flow_y - reading.rotation_y)
                reading = reading._replace(flow_x=x, flow_y=y)
            receive(reading)

        core._estimator.receive = turned

    flight = FlightTest("figure8_calm", change=change).fly(16.0)
    assert flight.vehicle.crash_reason or np.abs(flight.errors[1400:]).max() > 0.5


@pytest.mark.parametrize("sensor", ["xacc", "zgyro"])
def test_nan_for_a_moment_is_reported_and_the_flight_goes_on(sensor):
    def fault(t, frames):
        return [rewrite(f, **{sensor: float("nan")}) if FAULT_S < t < FAULT_S + 0.03 else f for f in frames]

    flight = FlightTest(fault=fault).fly(9.0)
    assert flight.modes[-1] is FlightMode.FLYING
    assert flight.said("gave nan: sample ignored")
    assert np.abs(flight.errors[1300:]).max() < 0.3


@pytest.mark.parametrize("kind", ["nan", "frozen", "silent"])
def test_an_imu_that_stays_bad_stops_the_motors_within_a_tenth_of_a_second(kind):
    stored = []

    def fault(t, frames):
        if t < FAULT_S:
            stored[:] = [f for f in frames if is_imu(f)]
            return frames
        if kind == "silent":
            return [f for f in frames if not is_imu(f)]
        if kind == "nan":
            return [rewrite(f, ygyro=float("nan")) for f in frames]
        stuck = mavlink.MAVLink(None).decode(bytearray(stored[0]))
        same = {name: getattr(stuck, name) for name in ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")}
        return [rewrite(f, **same) for f in frames]

    flight = FlightTest(fault=fault).fly(7.0)
    first = flight.modes.index(FlightMode.EMERGENCY) / 200
    assert FAULT_S + 0.05 <= first < FAULT_S + 0.12
    assert set(map(tuple, flight.commands[flight.modes.index(FlightMode.EMERGENCY) + 1 :])) == {(0.0,) * 4}
    assert flight.said("EMERGENCY: IMU silent")
    assert kind != "frozen" or flight.said("IMU frozen")


FROZEN_FLOW = (
    f"vehicle.disturbances=[{{kind: sensor_fault, sensor: flow, fault: frozen, onset_s: {FAULT_S}}},"
    f"{{kind: wind, velocity_ned_m_s: [0.0, 2.0, 0.0], onset_s: {FAULT_S}}}]"
)


@pytest.mark.parametrize("detected", [True, False])
def test_with_a_frozen_flow_the_vehicle_descends_and_undetected_it_is_blown_away(detected):
    limit = f"onboard.vehicle_link.frozen_flows={8 if detected else 0}"
    flight = FlightTest(assignments=(FROZEN_FLOW, limit)).fly(14.0)
    far = float(np.linalg.norm(flight.truths[-1][:2]))
    assert bool(flight.said("optical flow frozen")) == detected
    if detected:
        assert not flight.vehicle.crash_reason
        assert flight.said("HOLD_LEVEL: no velocity aid")
        assert FlightMode.LANDED in flight.modes
        assert far < 4.0
    else:
        assert flight.vehicle.crash_reason or far > 4.0


def test_without_the_limit_on_the_age_of_the_imu_the_motors_turn_on_when_it_is_silent():
    def fault(t, frames):
        return [f for f in frames if t < FAULT_S or not is_imu(f)]

    flight = FlightTest(fault=fault, assignments=("onboard.supervisor.imu_silent_s=1000",)).fly(9.0)
    assert FlightMode.EMERGENCY not in flight.modes
    assert max(flight.commands[-1]) > 0.1
    assert flight.vehicle.crash_reason or np.abs(flight.errors[-1]).max() > 0.5


def test_a_restarted_vehicle_clock_is_reported_and_the_flight_goes_on():
    def fault(t, frames):
        return [rewrite(f, time_usec=round((t - FAULT_S) * 1e6) + 5000) if t > FAULT_S else f for f in frames]

    flight = FlightTest(fault=fault).fly(9.0)
    assert flight.said("vehicle restarted")
    assert flight.modes[-1] is FlightMode.FLYING
    assert np.abs(flight.errors[1300:]).max() < 0.3


@pytest.mark.parametrize("ahead_s", [0.06, 0.2, 0.51])
def test_the_flight_goes_on_after_one_stamp_ahead(ahead_s):
    def fault(t, frames):
        ahead = FAULT_S < t < FAULT_S + 0.006
        return [rewrite(f, time_usec=round((t + ahead_s) * 1e6)) if ahead else f for f in frames]

    flight = FlightTest(fault=fault).fly(9.0)
    assert flight.core._vehicle_link.rejected["time_ahead"] == 1
    assert flight.modes[-1] is FlightMode.FLYING
    assert np.abs(flight.errors[1300:]).max() < 0.3


@pytest.mark.parametrize("jump_s", [0.06, 0.2, 0.51, -0.2])
def test_the_flight_goes_on_when_the_clock_of_the_vehicle_jumps(jump_s):
    jump = f"vehicle.disturbances=[{{kind: clock_jump, jump_s: {jump_s}, onset_s: {FAULT_S}}}]"
    flight = FlightTest(assignments=(jump,)).fly(9.0)
    assert flight.said("vehicle's clock jumped")
    assert not flight.said("IMU silent")
    assert flight.modes[-1] is FlightMode.FLYING
    assert np.abs(flight.errors[1300:]).max() < 0.3


def test_the_flight_goes_on_when_time_goes_backwards_for_some_samples():
    def fault(t, frames):
        late = 0.02 if FAULT_S < t < FAULT_S + 0.02 else 0.0
        return [rewrite(f, time_usec=round((t - late) * 1e6)) if late else f for f in frames]

    flight = FlightTest(fault=fault).fly(8.0)
    assert (
        flight.core._vehicle_link.rejected["time_backwards"] + flight.core._vehicle_link.rejected["time_repeated"] >= 3
    )
    assert flight.modes[-1] is FlightMode.FLYING


def test_a_second_vehicle_on_the_port_changes_only_the_events():
    other = mavlink.MAVLink(None, 77, 1)

    def fault(t, frames):
        if t < 1.0:
            return frames
        values = (5.0, -5.0, 3.0, 2.0, -2.0, 1.0, 0.0, 0.0, 0.0, 900.0, 0.0, 0.0, 20.0)
        return [*frames, bytes(mavlink.MAVLink_hil_sensor_message(round(t * 1e6), *values, 0x1FFF).pack(other))]

    disturbed, alone = FlightTest(fault=fault).fly(8.0), FlightTest().fly(8.0)
    np.testing.assert_array_equal(np.array(disturbed.truths), np.array(alone.truths))
    assert disturbed.said("second vehicle (system id 77)")


@pytest.mark.parametrize("utc_ns", [0, 1_763_800_000 * 10**9])
def test_a_signed_link_flies_whatever_clock_the_vehicle_has(utc_ns):
    """The simulated vehicle has no wall clock; it adopts the time of our signatures, as MAVLink specifies."""
    flight = FlightTest(keys=(b"k" * 32, b"k" * 32), session=session_number(utc_ns, 1)).fly(8.0)
    assert flight.modes[-1] is FlightMode.FLYING
    rejected = flight.core._vehicle_link.rejected
    assert set(rejected) <= {"signature_too_old"}
    assert rejected.total() < 10


def test_a_vehicle_with_another_key_is_not_flown():
    flight = FlightTest(keys=(b"k" * 32, b"l" * 32)).fly(6.0)
    assert set(flight.modes) == {FlightMode.BOOT}
    assert flight.core._vehicle_link.rejected["signature"] > 1000


def test_the_flight_goes_on_with_wrong_ultrasonic_readings():
    """Every third echo is wrong by up to two metres."""
    rng = np.random.default_rng(5)

    def fault(t, frames):
        out = []
        for frame in frames:
            if frame[7] == mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR and rng.random() < 0.3:
                codec = mavlink.MAVLink(None, 1, 1)
                message = codec.decode(bytearray(frame))
                message.current_distance = int(rng.integers(44, 300))
                frame = bytes(message.pack(codec))
            out.append(frame)
        return out

    flight = FlightTest(fault=fault).fly(12.0)
    assert flight.modes[-1] is FlightMode.FLYING
    assert np.abs(flight.errors[1200:, 2]).max() < 0.15
