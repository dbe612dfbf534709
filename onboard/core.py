"""The onboard core: one tick, block by block. No socket, no clock, no file: bytes and time in, bytes out.

vehicle link -> estimator -> supervisor -> guidance -> controller -> mixer -> vehicle link
|                                    ^      |
actuator model -> u_hat, residual -----------------------+      +-> sampler -> offboard link
^
offboard link -> feature reception -> swap --------------+
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import dist
from typing import Any, Final, Self

import numpy as np

from onboard.config import OnboardConfig
from onboard.control.actuators import CATCH_UP_MAX, ActuatorModel, Shares
from onboard.control.feature_reception import FeatureReception
from onboard.control.mixer import Mixer
from onboard.control.records import ControlInputs, ControlOutput, Target
from onboard.control.thrust_scale import ThrustScale
from onboard.control.uncertainty import UncertaintyMeasurement
from onboard.estimation.estimator import Estimator
from onboard.estimation.state import VehicleState
from onboard.flight.adaptation_gate import AdaptationGate
from onboard.flight.arming import ArmingChecks
from onboard.flight.guidance import Guidance
from onboard.flight.modes import AIRBORNE, RESTING, SPINNING, Command, FlightMode
from onboard.flight.supervisor import Supervisor, SupervisorInputs
from onboard.links.ground import GroundLink
from onboard.links.offboard import DatedPose, OffboardLink, PeerRestarted
from onboard.links.vehicle import Reading, VehicleLink
from onboard.preflight.certificate import CLEAR, Clearance
from onboard.record.tick import TICK, age_s, write_tick
from onboard.sampling.sampler import SampleQueue
from onboard.sampling.signal_vector import SignalVector
from protocol.arrival import Datagrams, at_times
from protocol.clock import ForwardClock
from protocol.conventions import GRAVITY, NEVER_NS, Array
from protocol.geometry import vector
from protocol.mavlink.signing import SigningClock
from protocol.mavlink.vehicle import BatteryReading
from protocol.messages import FeatureChunk
from protocol.session import session_start_ns

ZERO: Final[Shares] = (0.0, 0.0, 0.0, 0.0)
ARMED, TAKE_OFF, FLYING, HOLD_LEVEL, LANDING, LANDED = (
    FlightMode[name] for name in ("ARMED", "TAKE_OFF", "FLYING", "HOLD_LEVEL", "LANDING", "LANDED")
)
"""Enum members as module constants: attribute access on an Enum is slow before Python 3.12."""


@dataclass(slots=True)
class OnboardOutput:
    """Everything that one tick sends and records. The core reuses one object: the next tick overwrites it."""

    to_vehicle: list[bytes] = field(default_factory=list)
    to_offboard: list[bytes] = field(default_factory=list)
    to_ground: list[bytes] = field(default_factory=list)
    tick: Array = field(default_factory=lambda: np.zeros(len(TICK.fields)))
    """Per onboard.record.tick.TICK."""
    events: list[tuple[int, str]] = field(default_factory=list)
    """(time_ns, text)."""
    clock_offset: Array | None = None
    """Per flight_log.schema.CLOCK_OFFSET, once a second when it is known."""

    def cleared(self) -> Self:
        """The same object without datagrams and events, for the next tick."""
        self.to_vehicle, self.to_offboard, self.to_ground, self.events = [], [], [], []
        return self


class OnboardCore:
    """Everything that the vehicle needs to fly and adapt.

    Parameters
    ----------
    session: number of this run, larger at each start (protocol.session).
    key: shared with offboard; None between loopback addresses only.
    vehicle_key, ground_key: of the MAVLink to vehicle and ground station; None: unsigned.
    clearance: result of the preflight check, which may forbid arming for as long as this core lives.
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
        self._airframe = config.airframe
        self._dt = self._period_s = config.period_ns * 1e-9
        self._clock = ForwardClock()
        utc_ns = session_start_ns(session)
        self._vehicle_link = VehicleLink(config.vehicle_link, vehicle_key, SigningClock(utc_at_first_use_ns=utc_ns))
        self._offboard_link = OffboardLink(config, session, key)
        self._ground_link = GroundLink(config.ground_link, ground_key, SigningClock(utc_at_first_use_ns=utc_ns))
        self.screens: Final = self._vehicle_link.screen, self._offboard_link.endpoint.screen, self._ground_link.screen
        self._estimator = Estimator(config.estimator)
        self._supervisor = Supervisor(config.supervisor)
        self._arming = ArmingChecks(config, clearance)
        self._guidance = Guidance(config.guidance)
        self._adaptation = AdaptationGate()
        self._actuators = ActuatorModel(config.airframe, self._dt)
        self._thrust_scale = ThrustScale(config.thrust_scale, config.airframe, self._dt)
        self._uncertainty = UncertaintyMeasurement(config.airframe, self._dt)
        self._signals = SignalVector(self._dt)
        self._reception = FeatureReception()
        self.controller = config.controller.build(config.airframe, config.features, config.seed)
        self._mixer = Mixer(config.airframe)
        self._samples = SampleQueue(config.samples)
        self._output = OnboardOutput()
        self._notice, self._mode = clearance.notice, FlightMode.BOOT
        self._battery = BatteryReading(NEVER_NS, 0.0, -1.0)
        self._command: Shares = ZERO
        self._saturated = self._land_requested = self._posed = False
        self._ticks, self._missed_ticks, self._tracking_error_m = 0, 0, 0.0

    def tick(
        self,
        now_ns: int,
        from_vehicle: Datagrams = (),
        from_offboard: Datagrams = (),
        from_ground: Datagrams = (),
        land: bool = False,
        missed_ticks: int = 0,
    ) -> OnboardOutput:
        """One tick: from the datagrams received to motor command, samples, status and record.

        Parameters
        ----------
        now_ns: onboard's monotonic clock.
        from_vehicle, from_offboard, from_ground: datagrams received since the last tick, oldest first. They may hold
            any bytes: a bad datagram is counted and dropped. An `Arrival` came `age_ns` before now, plain bytes now.
        land: the process is asked to end; land as soon as possible.
        missed_ticks: ticks that the loop has skipped since its start. The last command was held meanwhile.
        """
        now_ns = self._clock.at(now_ns)
        missed = min(missed_ticks - self._missed_ticks, CATCH_UP_MAX)
        self._missed_ticks, self._dt, output = missed_ticks, (1 + missed) * self._period_s, self._output.cleared()
        readings = [one for came in at_times(from_vehicle, now_ns) for one in self._vehicle_link.receive(*came)]
        poses = self._receive_offboard(from_offboard, now_ns)
        self._receive_ground(from_ground, land, now_ns)
        state = self._estimate(readings, poses, now_ns)
        self._collect_events(output)
        mode = self._supervise(state, now_ns)
        target = self._guide(state, mode)
        self._actuators.scale = self._mixer.scale = self._thrust_scale.value
        *_, delivered = passed = self._actuators.catch_up(self._command, missed)
        measured = self._uncertainty.step(state, passed)
        self._estimator.expect_turn(measured[1].u_hat, measured[1].residual, self._dt)
        coming = self._uncertainty.coming(state, delivered, self._actuators.ahead(self._command))
        signals = self._signals.step(state, delivered.thrusts_n, self._battery.voltage_v)
        adapt = self._adaptation.allows(state, mode, now_ns)
        self._thrust_scale.step(float(state.specific_force[2]), delivered.thrust_n, adapt)
        version, feature_age_s = self._swap_features(now_ns)
        control_inputs = ControlInputs(
            *(self._dt, state, target, signals, *measured, self._saturated, adapt, coming),
            level_only=mode is HOLD_LEVEL,
            missed=missed,
            thrust=(delivered.thrust_n, self._actuators.scale),
        )
        control = self._control(control_inputs, mode)
        motors = self._mix(control, mode)
        output.to_vehicle.append(self._vehicle_link.encode_motors(motors, mode in SPINNING, now_ns))
        output.to_offboard += self._sample(control_inputs, control, version, now_ns)
        self._report(output, state, mode, now_ns)
        write_tick(
            output.tick,
            control_inputs,
            control,
            mode=mode,
            saturated=self._saturated,
            path_time_s=self._guidance.path_time_s,
            feature_version=version,
            feature_age_s=feature_age_s,
            offboard_age_s=age_s(now_ns, self._offboard_link.last_received_ns),
            pose_age_s=age_s(now_ns, state.last_pose_ns),
            battery_v=self._battery.voltage_v,
            motors=motors,
            motor_thrusts_n=delivered.thrusts_n,
        )
        self._tracking_error_m = dist(state.position.tolist(), target.path.position)
        self._ticks += 1
        return output

    def safe_output(self, now_ns: int) -> OnboardOutput:
        """Motors off and nothing else: for a tick that raised, and at the end."""
        return OnboardOutput(to_vehicle=[self._vehicle_link.encode_motors(ZERO, False, now_ns)])

    # --- receive -------------------------------------------------------------------------------------------------

    def _receive_offboard(self, datagrams: Datagrams, now_ns: int) -> list[DatedPose]:
        """Poses for the estimator; chunks of feature versions go to the reception."""
        poses: list[DatedPose] = []
        for datagram, arrival_ns in at_times(datagrams, now_ns):
            for message in self._offboard_link.receive(datagram, arrival_ns):
                match message:
                    case DatedPose():
                        poses.append(message)
                    case FeatureChunk():
                        self._reception.receive(message)
                    case PeerRestarted():
                        self._reception.restart()
        return poses

    def _receive_ground(self, datagrams: Datagrams, land: bool, now_ns: int) -> None:
        """Commands of the pilot, and the process's own wish to land, for the supervisor."""
        if land:
            self._supervisor.command(Command.LAND, now_ns)
        for datagram, arrival_ns in at_times(datagrams, now_ns):
            for command in self._ground_link.receive(datagram, arrival_ns):
                refusal = self._supervisor.command(command.command, now_ns)
                self._ground_link.acknowledge(command, refusal, now_ns)

    def _collect_events(self, output: OnboardOutput) -> None:
        """Events of the blocks that received; those of vehicle link and estimator also go to the pilot's screen."""
        output.events += self._offboard_link.take_events()
        for when_ns, text in (*self._vehicle_link.take_events(), *self._estimator.take_events()):
            self._announce(when_ns, text)

    def _announce(self, when_ns: int, text: str) -> None:
        """Log an event and show it on the pilot's screen."""
        self._output.events.append((when_ns, text))
        self._ground_link.send_text(text)

    # --- the blocks ----------------------------------------------------------------------------------------------

    def _estimate(self, readings: Sequence[Reading], poses: Sequence[DatedPose], now_ns: int) -> VehicleState:
        """The vehicle's state from sensor readings and poses."""
        for reading in readings:
            if isinstance(reading, BatteryReading):
                self._battery = reading
            else:
                self._estimator.receive(reading)
        for pose, taken_ns, arrival_ns, time_sigma_s in poses:
            self._estimator.receive_pose(pose, taken_ns, arrival_ns, time_sigma_s)
            self._arming.receive_pose(pose.position_ned_m.item(2), pose.quaternion.tolist(), self._vehicle_link, now_ns)
        return self._estimator.state

    def _supervise(self, state: VehicleState, now_ns: int) -> FlightMode:
        """The flight mode from ages, limits and commands."""
        if self._notice:
            self._announce(now_ns, self._notice)
            self._notice = ""
        self._posed = self._posed or state.last_pose_ns != NEVER_NS
        if self._guidance.finished and not self._land_requested and self._mode is FLYING:
            self._land_requested = True
            self._supervisor.command(Command.LAND, now_ns)
        mode = self._supervisor.step(self._supervisor_inputs(state, now_ns))
        for when_ns, text in self._supervisor.take_events():
            self._announce(when_ns, text)
        if mode is TAKE_OFF and self._mode is not TAKE_OFF:
            self._guidance.start(state)
            self._land_requested = False
            self._adaptation.take_off(state)
        self._estimator.set_on_ground(mode not in AIRBORNE, mode in RESTING)
        self._mode = mode
        return mode

    def _supervisor_inputs(self, state: VehicleState, now_ns: int) -> SupervisorInputs:
        north, east, down = state.position.tolist()
        return SupervisorInputs(
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
            thrust_to_weight=self._actuators.delivered.thrust_n / (self._airframe.mass_kg * GRAVITY),
            initialised=state.initialised,
            preflight="" if self._mode in AIRBORNE else self._arming.refusal(now_ns, self._posed, self._vehicle_link),
            calibration=self._estimator.calibration.refusal,
            fault=not self._estimator.healthy,
            gyro_stuck=self._estimator.gyro_stuck,
        )

    def _guide(self, state: VehicleState, mode: FlightMode) -> Target:
        """The target of this tick."""
        self._guidance.follow_jump(state, self._posed)
        if mode is LANDED:
            self._guidance.rest(vector(state.position.tolist()))
        target = self._guidance.step(mode is TAKE_OFF or mode is FLYING, mode is LANDING, self._dt, mode is TAKE_OFF)
        if mode is HOLD_LEVEL:  # the vehicle drifts: a landing that follows begins where the vehicle is then
            self._guidance.place(vector(state.position.tolist()))
        return target

    def _swap_features(self, now_ns: int) -> tuple[int, float]:
        """Offer a complete feature version to the controller; returns the version in use and its age, s."""
        events, warnings = self._reception.swap(self.controller, now_ns)
        self._output.events += events
        for when_ns, warning in warnings:
            self._announce(when_ns, warning)
        return self._reception.version, self._reception.age_s(now_ns)

    def _control(self, inputs: ControlInputs, mode: FlightMode) -> ControlOutput:
        """Thrust and torque; on the ground the controller and the thrust scale are held at their start."""
        if mode not in AIRBORNE:
            self.controller.reset(inputs)
            self._thrust_scale.reset()
        return self.controller.step(inputs)

    def _mix(self, control: ControlOutput, mode: FlightMode) -> list[float]:
        """Motor commands as shares of the maximum thrust, within limits and with motor lag compensated."""
        self._saturated = False
        if mode in AIRBORNE:
            demand = control.thrust_n, control.torque_nm
            wanted = self._mixer.thrusts(*demand)
            self._saturated = self._mixer.falls_short(wanted, *demand)
            self._command = self._actuators.overdriven(wanted)
        else:
            idle = self._airframe.motor_thrust_min_share if mode is ARMED else 0.0
            self._command = (idle, idle, idle, idle)
        return list(self._command)

    def _sample(self, inputs: ControlInputs, control: ControlOutput, version: int, now_ns: int) -> list[bytes]:
        """Samples for the trainer, from flight only, as datagrams when a batch is due."""
        if inputs.adapt:
            u_hat = inputs.position.u_hat, inputs.attitude.u_hat
            nu_ad = control.position.adaptive_now, control.attitude.adaptive_now
            self._samples.push(now_ns, inputs.signals, u_hat, nu_ad)
        batches = self._samples.poll(now_ns, version, self._offboard_link.loss_share(now_ns))
        return [self._offboard_link.encode(batch, now_ns) for batch in batches]

    # --- reports -------------------------------------------------------------------------------------------------

    def _report(self, output: OnboardOutput, state: VehicleState, mode: FlightMode, now_ns: int) -> None:
        """Status, time sync and telemetry, each at its own period."""
        link = self._offboard_link
        small = link.time_sync(now_ns)
        output.clock_offset = link.clock_record(now_ns)
        output.to_ground += self._ground_link.poll(now_ns, mode, state, self._battery)
        if link.status_due(now_ns):
            self._ground_link.values.update(
                feat_ver=float(self._reception.version),
                feat_age=self._reception.age_s(now_ns),
                track_err=self._tracking_error_m,
            )
            counts = (self._ticks, self._missed_ticks)
            small.append(link.status(now_ns, mode, counts, state.last_pose_ns, self._reception.status))
            self._reception.note_status()
        for datagram in small:
            self._samples.charge(len(datagram), now_ns)
        output.to_offboard += small

    def status(self, now_ns: int) -> dict[str, Any]:
        """A few numbers for the live status line."""
        statistics = self._offboard_link.statistics
        return {
            "mode": self._mode.name,
            "not_ready": self._supervisor.not_ready,
            "tracking_error_m": self._tracking_error_m,
            "feature_version": self._reception.version,
            "feature_age_s": self._reception.age_s(now_ns),
            "link_lost": statistics.lost,
            "link_received": statistics.received,
            "rejected": statistics.rejected.total(),
        }

    @property
    def airborne(self) -> bool:
        """Whether the flight mode is one of those in the air."""
        return self._mode in AIRBORNE

    def summary(self) -> dict[str, Any]:
        """Mode, features, and the counters of links, samples and estimator, for the flight record."""
        return {
            "mode": self._mode.name,
            "ticks": self._ticks,
            "missed": self._missed_ticks,
            "features": {
                "version": self._reception.version,
                "swaps": self._reception.swaps,
                "refused": self._reception.refusals,
                "taken_back": self._reception.taken_back,
            },
            "rejected": dict(self._offboard_link.statistics.rejected),
            "vehicle_rejected": dict(self._vehicle_link.rejected),
            "samples": self._samples.counts,
            "estimator": dict(self._estimator.counts),
            "nis": self._estimator.mean_scores,
            "calibration": self._estimator.calibration.summary(),
        }
