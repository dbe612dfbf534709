"""The onboard process without its sockets and clock: bytes and time in, bytes out. `step` reads like the block diagram.

vehicle_link -> estimator -> supervisor -> guidance -> controller -> mixer -> vehicle_link
                                                          ^  features, adaptation
               offboard_link -> feature_reception (swap) -+          sampler -> offboard_link
"""

import math
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from onboard.config import OnboardConfig
from onboard.control.actuators import ActuatorModel
from onboard.control.airframe import GRAVITY
from onboard.control.feature_reception import FeatureReception
from onboard.control.mixer import Mixer, Thrusts
from onboard.control.records import ControlInputs, ControlOutput, Target
from onboard.estimation.estimator import Estimator
from onboard.flight.arming import ArmingChecks
from onboard.flight.guidance import Guidance
from onboard.flight.modes import AIRBORNE, SPINNING, Command, FlightMode
from onboard.flight.supervisor import Supervisor, SupervisorInputs
from onboard.links.ground import GroundLink
from onboard.links.offboard import OffboardLink
from onboard.links.readings import BatteryReading
from onboard.links.vehicle import VehicleLink
from onboard.preflight.certificate import CLEAR, Clearance
from onboard.record.tick import OFFSET, TICK, write_channel
from onboard.sampling.sampler import SampleQueue
from onboard.sampling.signal_vector import SignalVector
from protocol.clock import ForwardClock
from protocol.conventions import NEVER_NS, Array
from protocol.mavlink_frames import SigningClock
from protocol.session import session_start_ns

ZERO: Final[Thrusts] = (0.0, 0.0, 0.0, 0.0)
ADAPT_HEIGHT_M: Final = 0.2
"""Below this the floor's cushion and contact would be learnt as a disturbance."""
_ARMED, _TAKE_OFF, _FLYING, _HOLD_LEVEL, _LANDING = (
    FlightMode[name] for name in ("ARMED", "TAKE_OFF", "FLYING", "HOLD_LEVEL", "LANDING")
)
"""By plain names, which are read many times a tick: before Python 3.12 a member of an enum costs as much as a call."""
POSITION_NED: Final = slice(OFFSET["position_n"], OFFSET["position_n"] + 3)
TARGET_NED: Final = slice(OFFSET["target_n"], OFFSET["target_n"] + 3)
POSITION_AT: Final = OFFSET["position_error_n"]
ATTITUDE_AT: Final = OFFSET["attitude_error_x"]
VELOCITY_AID_MAX_S: Final = 0.3
"""Velocity without an aid for so long is not learnt from."""


@dataclass(slots=True)
class OnboardOutput:
    """What one step gives out."""

    to_vehicle: list[bytes] = field(default_factory=list)
    to_offboard: list[bytes] = field(default_factory=list)
    to_ground: list[bytes] = field(default_factory=list)
    tick: Array = field(default_factory=lambda: np.zeros(len(TICK.fields)))
    """Per onboard.record.tick.TICK; rewritten by the next step."""
    events: list[tuple[int, str]] = field(default_factory=list)
    """(time_ns, text)."""
    clock_offset: Array | None = None
    """Per flight_log.schema.CLOCK_OFFSET, once a second when it is known."""


class OnboardCore:
    """Everything the vehicle needs to fly and adapt.

    Parameters
    ----------
    session: number of this run, larger at each start (protocol.session).
    key: shared with offboard; None between loopback addresses only.
    vehicle_key, ground_key: of the MAVLink to vehicle and ground station; None: unsigned.
    clearance: what stands against arming as long as this core lives, such as a missing preflight check.
    """

    def __init__(
        self,
        config: OnboardConfig,
        session: int,
        key: bytes | None,
        vehicle_key: bytes | None = None,
        ground_key: bytes | None = None,
        clearance: Clearance = CLEAR,
    ) -> None:
        self._config = config
        self._notice = clearance.notice
        self._dt = config.period_ns * 1e-9
        self._clock = ForwardClock()
        utc_ns = session_start_ns(session)
        self._vehicle_link = VehicleLink(config.vehicle_link, vehicle_key, SigningClock(utc_at_first_use_ns=utc_ns))
        self._estimator = Estimator(config.estimator)
        self._supervisor = Supervisor(config.supervisor)
        self._arming = ArmingChecks(config, self._vehicle_link, clearance)
        self._ground_link = GroundLink(config.ground_link, ground_key, SigningClock(utc_at_first_use_ns=utc_ns))
        self._guidance = Guidance(config.guidance)
        self.controller = config.controller.build(config.airframe, config.seed)
        self._mixer = Mixer(config.airframe)
        self._actuators = ActuatorModel(config.airframe, self._dt)
        self._signals = SignalVector(self._dt)
        self._reception = FeatureReception(self.controller)
        self._samples = SampleQueue(config.samples)
        self._offboard_link = OffboardLink(config, session, key, self._reception, self._samples)
        self._output = OnboardOutput()
        self._events: list[tuple[int, str]] = []
        self._command: Thrusts = ZERO
        self._command_before: Thrusts = ZERO
        self._saturated = False
        self._mode = FlightMode.BOOT
        self._land_requested = False
        self._battery = BatteryReading(NEVER_NS, 0.0, -1.0)
        self._ticks = 0
        self._missed_ticks = 0
        self._resets_seen = 0
        self._posed = False
        self._posed_in_time = False
        self._delivered = np.zeros((2, 3))
        self._adaptive = np.zeros((2, 3))

    # --- taking in -----------------------------------------------------------------------------------------------

    def take_in_vehicle(self, datagram: bytes, now_ns: int) -> None:
        """One datagram of the vehicle; never raises for what is in it."""
        now_ns = self._clock.at(now_ns)
        for reading in self._vehicle_link.receive(datagram, now_ns):
            if isinstance(reading, BatteryReading):
                self._battery = reading
            else:
                self._estimator.receive(reading)

    def take_in_offboard(self, datagram: bytes, now_ns: int) -> None:
        """One datagram of offboard; never raises for what is in it."""
        now_ns = self._clock.at(now_ns)
        heard = self._offboard_link.receive(datagram, now_ns)
        if heard is not None:
            self._estimator.receive_pose(heard.pose, heard.taken_ns, now_ns, heard.time_sigma_s)
            self._arming.receive_pose(heard.pose, now_ns)

    def take_in_ground(self, datagram: bytes, now_ns: int) -> None:
        """One datagram of the ground station; never raises for what is in it."""
        now_ns = self._clock.at(now_ns)
        for command in self._ground_link.receive(datagram, now_ns):
            refusal = self._supervisor.command(command.command, now_ns)
            self._ground_link.acknowledge(command, refusal, now_ns)

    def request_land(self, now_ns: int) -> None:
        """Lands as soon as possible, as if the ground station had asked."""
        self._supervisor.command(Command.LAND, self._clock.at(now_ns))

    # --- the step ------------------------------------------------------------------------------------------------

    def step(self, now_ns: int, missed_ticks: int = 0) -> OnboardOutput:
        """One tick: from everything taken in to motor command, samples, status and record."""
        now_ns = self._clock.at(now_ns)
        self._missed_ticks = missed_ticks
        out = self._begin()
        mode = self._supervise(now_ns)
        target = self._guide(mode)
        inputs = self._sense(target, now_ns)
        self._swap_features(now_ns)
        control = self._control(mode, inputs)
        self._mix(mode, control, now_ns)
        self._sample(inputs, control, now_ns)
        self._report(now_ns)
        self._record(out.tick, mode, inputs, control, now_ns)
        self._ticks += 1
        out.events, self._events = self._events, []
        return out

    def safe_output(self, now_ns: int) -> OnboardOutput:
        """Motors off, nothing else: for when a step has failed, and at the end."""
        return OnboardOutput(to_vehicle=[self._vehicle_link.encode_motors(ZERO, False, now_ns)])

    def _begin(self) -> OnboardOutput:
        out = self._output
        out.to_vehicle, out.to_offboard, out.to_ground = [], [], []
        self._events += self._offboard_link.take_events()
        for when_ns, text in self._vehicle_link.take_events():
            self._say(when_ns, text)
        self._events += self._estimator.take_events()
        return out

    def _supervise(self, now_ns: int) -> FlightMode:
        """Ages and flags in, flight mode out; tells the estimator whether the floor is beneath."""
        if self._notice:
            self._say(now_ns, self._notice)
            self._notice = ""
        state = self._estimator.state
        self._posed = self._posed or state.last_pose_ns != NEVER_NS
        if self._guidance.finished and not self._land_requested and self._mode is _FLYING:
            self._land_requested = True
            self._supervisor.command(Command.LAND, now_ns)
        north, east, down = state.position.tolist()
        mode = self._supervisor.step(
            SupervisorInputs(
                now_ns=now_ns,
                imu_age_s=(now_ns - state.last_imu_ns) * 1e-9,
                pose_age_s=(now_ns - state.last_pose_ns) * 1e-9,
                velocity_aid_age_s=(now_ns - state.last_velocity_aid_ns) * 1e-9,
                offboard_age_s=(now_ns - self._offboard_link.last_received_ns) * 1e-9,
                ground_age_s=(now_ns - self._ground_link.last_received_ns) * 1e-9,
                battery_age_s=(now_ns - self._battery.time_ns) * 1e-9,
                battery_v=self._battery.voltage_v,
                battery_remaining=self._battery.remaining,
                tilt_rad=state.tilt_rad,
                height_m=-down,
                climb_m_s=-float(state.velocity[2]),
                distance_m=(north * north + east * east) ** 0.5,
                position_sigma_m=state.position_sigma_m,
                thrust_to_weight=self._actuators.wrench()[0] / (self._config.airframe.mass_kg * GRAVITY),
                initialised=state.initialised,
                preflight="" if self._mode in AIRBORNE else self._arming.refusal(now_ns, self._posed),
                fault=not self._estimator.healthy,
            )
        )
        for when_ns, text in self._supervisor.take_events():
            self._say(when_ns, text)
        if mode is _TAKE_OFF and self._mode is not _TAKE_OFF:
            self._guidance.start(state)
            self._land_requested = False
        self._estimator.set_on_ground(mode not in AIRBORNE)
        self._mode = mode
        return mode

    def _say(self, when_ns: int, text: str) -> None:
        """An event, on the pilot's screen too."""
        self._events.append((when_ns, text))
        self._ground_link.send_text(text)

    def _guide(self, mode: FlightMode) -> Target:
        """Target of this tick. A first pose that comes in flight moves the path along instead of the vehicle."""
        state = self._estimator.state
        if state.position_reset_count != self._resets_seen:
            self._resets_seen = state.position_reset_count
            if not self._posed_in_time:
                north, east, down = state.position_jump.tolist()
                self._guidance.shift((north, east, down))
            self._posed_in_time = self._posed
        run = mode is _TAKE_OFF or mode is _FLYING
        target = self._guidance.step(run, mode is _LANDING, self._dt)
        if mode is _HOLD_LEVEL:  # it drifts: a landing that follows is to begin where the vehicle is then
            north, east, down = (state.position - target.now.position).tolist()
            self._guidance.shift((north, east, down))
        return target

    def _sense(self, target: Target, now_ns: int) -> ControlInputs:
        """Everything the controller may use."""
        state = self._estimator.state
        self._actuators.step(self._command_before)  # a command acts one tick after it was computed
        thrust, roll, pitch, yaw = self._actuators.wrench()
        aided = (now_ns - state.last_velocity_aid_ns) * 1e-9 < VELOCITY_AID_MAX_S
        flying = self._mode in AIRBORNE and -float(state.position[2]) > ADAPT_HEIGHT_M
        return ControlInputs(
            dt=self._dt,
            state=state,
            target=target,
            signals=self._signals.step(state, self._actuators.thrusts, self._battery.voltage_v),
            delivered_thrust_n=thrust,
            delivered_torque_nm=(roll, pitch, yaw),
            saturated=self._saturated,
            adapt=flying and aided,
            level_only=self._mode is _HOLD_LEVEL,
        )

    def _swap_features(self, now_ns: int) -> None:
        """Takes over features that have arrived whole."""
        event = self._reception.step(now_ns, ready=True)
        if event:
            self._events.append((now_ns, event))

    def _control(self, mode: FlightMode, inputs: ControlInputs) -> ControlOutput:
        """The controller's command; on the ground its integrals are held at zero."""
        if mode not in AIRBORNE:
            self.controller.reset(inputs)
        return self.controller.step(inputs)

    def _mix(self, mode: FlightMode, control: ControlOutput, now_ns: int) -> None:
        """Motor thrusts within their limits, driven against the motors' lag, onto the wire."""
        self._command_before = self._command
        most = self._config.airframe.motor_thrust_max_n
        self._saturated = False
        if mode in AIRBORNE:
            demand = control.thrust_n, control.torque_nm
            wanted = self._mixer.thrusts(*demand)
            self._saturated = self._mixer.falls_short(wanted, *demand)
            self._command = self._actuators.overdriven(wanted)
        elif mode is _ARMED:
            idle = self._config.airframe.motor_thrust_min_share * most
            self._command = (idle, idle, idle, idle)
        else:
            self._command = ZERO
        fractions = [thrust / most for thrust in self._command]
        self._output.to_vehicle.append(self._vehicle_link.encode_motors(fractions, mode in SPINNING, now_ns))

    def _sample(self, inputs: ControlInputs, control: ControlOutput, now_ns: int) -> None:
        """Samples for the trainer, from flight only."""
        if inputs.adapt:
            self._delivered[0], self._delivered[1] = control.position.delivered, control.attitude.delivered
            self._adaptive[0], self._adaptive[1] = control.position.adaptive_now, control.attitude.adaptive_now
            self._samples.push(now_ns, inputs.signals, self._delivered, self._adaptive)
        self._output.to_offboard += self._offboard_link.send_samples(now_ns)

    def _report(self, now_ns: int) -> None:
        """Status, time sync and telemetry, each at its own period."""
        link, state = self._offboard_link, self._estimator.state
        self._output.to_offboard += link.send_time_sync(now_ns)
        self._output.clock_offset = link.clock_record(now_ns)
        self._output.to_ground += self._ground_link.poll(now_ns, self._mode, state, self._battery)
        if link.status_due(now_ns):
            self._show_values(now_ns)
            status = link.send_status(now_ns, self._mode, self._ticks, self._missed_ticks, state.last_pose_ns)
            self._output.to_offboard.append(status)

    def _show_values(self, now_ns: int) -> None:
        """What a ground station shows beside the flight itself, as named values."""
        self._ground_link.values.update(
            feat_ver=float(self._reception.version),
            feat_age=self._reception.age_s(now_ns),
            track_err=self._tracking_error_m(),
        )

    def _tracking_error_m(self) -> float:
        """Distance from position to target, of the tick recorded last."""
        row = self._output.tick
        error = row[POSITION_NED] - row[TARGET_NED]
        return math.sqrt(float(error @ error))

    # --- the record ----------------------------------------------------------------------------------------------

    def _record(self, row: Array, mode: FlightMode, inputs: ControlInputs, control: ControlOutput, now_ns: int) -> None:
        state, target = inputs.state, inputs.target
        most = self._config.airframe.motor_thrust_max_n
        t1, t2, t3, t4 = self._command
        row[:POSITION_AT] = (
            mode,
            inputs.adapt,
            self._saturated,
            self._guidance.path_time_s,
            self._reception.version,
            self._reception.age_s(now_ns),
            _age_s(now_ns, state.last_pose_ns),
            _age_s(now_ns, self._offboard_link.last_received_ns),
            self._battery.voltage_v,
            state.vibration,
            state.position_sigma_m,
            control.thrust_n,
            *state.position.tolist(),
            *state.velocity.tolist(),
            *state.quaternion.tolist(),
            *state.euler.tolist(),
            *state.rates.tolist(),
            *target.now.position,
            *target.now.velocity,
            *target.feed_forward,
            *control.commanded_quaternion,
            *control.torque_nm,
            *(t1 / most, t2 / most, t3 / most, t4 / most),
            *self._actuators.thrusts.tolist(),
        )
        write_channel(row, POSITION_AT, control.position)
        write_channel(row, ATTITUDE_AT, control.attitude)

    def status(self, now_ns: int) -> dict[str, Any]:
        """A few numbers for the live status line."""
        return {
            "mode": self._mode.name,
            "tracking_error_m": self._tracking_error_m(),
            "feature_version": self._reception.version,
            "feature_age_s": self._reception.age_s(now_ns),
            "link_lost": self._offboard_link.statistics.lost,
            "link_received": self._offboard_link.statistics.received,
            "rejected": self._offboard_link.statistics.rejected.total(),
        }

    @property
    def airborne(self) -> bool:
        """Whether the vehicle is meant to be off the ground."""
        return self._mode in AIRBORNE

    def summary(self) -> dict[str, Any]:
        """What the flight record keeps: features, link and vehicle link counters."""
        return {
            "mode": self._mode.name,
            "ticks": self._ticks,
            "missed": self._missed_ticks,
            "features": {
                "version": self._reception.version,
                "swaps": self._reception.swaps,
                "refused": self._reception.refusals,
            },
            "rejected": dict(self._offboard_link.statistics.rejected),
            "vehicle_rejected": dict(self._vehicle_link.rejected),
            "samples": self._samples.counts,
            "estimator": dict(self._estimator.counts),
        }


def _age_s(now_ns: int, then_ns: int) -> float:
    return -1.0 if then_ns == NEVER_NS else (now_ns - then_ns) * 1e-9
