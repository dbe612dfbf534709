"""The onboard core in C, with the interface of `onboard.core.OnboardCore`.

The links, which decode MAVLink and the datagrams of offboard, and the arming checks are those of the numpy core. All
blocks between them are one call of C (core.h).
"""

from typing import Any, Final

import numpy as np

from configs.loader import ConfigError
from onboard.c.compiled_controller import CompiledController
from onboard.c.config_table import TableError, image
from onboard.c.estimator_summary import calibration, counts, mean_scores
from onboard.c.event_text import (
    calibration_text,
    estimator_text,
    fall_text,
    refusal_text,
    supervisor_text,
    version_text,
)
from onboard.c.feature_arrays import put_chunk, put_start_features, view
from onboard.c.library import DEFAULT, BuildError, Variant, load
from onboard.config import OnboardConfig
from onboard.control.feature_reception import ReceptionStatus
from onboard.core import ZERO, OnboardOutput
from onboard.estimation.state import VehicleState
from onboard.flight.arming import ArmingChecks
from onboard.flight.modes import AIRBORNE, Command, FlightMode
from onboard.links.ground import GroundLink
from onboard.links.offboard import DatedPose, OffboardLink, PeerRestarted
from onboard.links.vehicle import Reading, VehicleLink
from onboard.preflight.certificate import CLEAR, Clearance
from protocol.arrival import Datagrams, at_times
from protocol.clock import ForwardClock
from protocol.conventions import NEVER_NS
from protocol.mavlink.signing import SigningClock
from protocol.mavlink.vehicle import BatteryReading, FlowReading, ImuReading, RangeReading
from protocol.messages import FeatureChunk, SampleBatch
from protocol.session import session_start_ns

COMMANDS: Final = {command: number for number, command in enumerate(Command)}
"""Number of each command in C."""


class CompiledCore:
    """The same vehicle, in C.

    Parameters
    ----------
    variant: how the C core is built.
    others: as of OnboardCore.

    Raises
    ------
    ConfigError
        If there is no C compiler, or the controller is not written in C.
    """

    def __init__(
        self,
        config: OnboardConfig,
        session: int,
        key: bytes | None,
        vehicle_key: bytes | None = None,
        ground_key: bytes | None = None,
        clearance: Clearance = CLEAR,
        variant: Variant = DEFAULT,
    ) -> None:
        self._library, self._core = _built(config, variant)
        core = self._library
        self._clock = ForwardClock()
        utc_ns = session_start_ns(session)
        self._vehicle_link = VehicleLink(config.vehicle_link, vehicle_key, SigningClock(utc_at_first_use_ns=utc_ns))
        self._offboard_link = OffboardLink(config, session, key)
        self._ground_link = GroundLink(config.ground_link, ground_key, SigningClock(utc_at_first_use_ns=utc_ns))
        self._arming = ArmingChecks(config, clearance)
        self.controller = CompiledController(core, self._core.controller)
        self._notice = clearance.notice
        self._inputs, self._result = core.CoreInputs(), core.CoreOutput()
        self._imu, self._pose, self._chunk = core.ImuReading(), core.Pose(), core.FeatureChunk()
        self._refusal, self._said = core.ArmingRefusal(), core.ReceptionStatus()
        self._output = OnboardOutput(tick=view(self._result.tick))
        state = self._core.estimator.state
        names = ("position", "velocity", "quaternion", "euler", "rates")
        self._state = VehicleState(**{name: view(getattr(state, name)) for name in names})
        """What the ground link shows; the arrays are those of the C core."""
        self._battery = BatteryReading(NEVER_NS, 0.0, -1.0)
        self._reasons = _Reasons()
        self._tracking_error_m = 0.0

    def tick(
        self,
        now_ns: int,
        from_vehicle: Datagrams = (),
        from_offboard: Datagrams = (),
        from_ground: Datagrams = (),
        land: bool = False,
        missed_ticks: int = 0,
    ) -> OnboardOutput:
        """One tick (OnboardCore.tick)."""
        now_ns = self._clock.at(now_ns)
        core, output, inputs, result = self._core, self._output.cleared(), self._inputs, self._result
        for datagram, arrival_ns in at_times(from_vehicle, now_ns):
            for reading in self._vehicle_link.receive(datagram, arrival_ns):
                self._receive(reading)
        self._receive_offboard(from_offboard, now_ns)
        self._receive_ground(from_ground, land, now_ns)
        posed = core.posed or core.estimator.state.last_pose_ns != NEVER_NS
        inputs.now_ns, inputs.missed_ticks = now_ns, missed_ticks
        inputs.preflight = self._reasons.number(self._arming.refusal(now_ns, posed, self._vehicle_link))
        inputs.offboard_ns, inputs.ground_ns = self._offboard_link.last_received_ns, self._ground_link.last_received_ns
        inputs.link_loss = self._offboard_link.loss_share(now_ns)
        self._library.core_tick(core, inputs, result)
        self._collect_events(output, now_ns)
        output.to_vehicle.append(self._vehicle_link.encode_motors(result.motors, result.spinning, now_ns))
        for batch in result.batches[: result.batch_count]:
            output.to_offboard.append(self._offboard_link.encode(_batch(batch), now_ns))
        self._report(output, FlightMode(result.mode), now_ns)
        self._tracking_error_m = core.tracking_error_m
        return output

    def safe_output(self, now_ns: int) -> OnboardOutput:
        """Motors off and nothing else: for a tick that raised, and at the end."""
        return OnboardOutput(to_vehicle=[self._vehicle_link.encode_motors(ZERO, False, now_ns)])

    # --- receive -------------------------------------------------------------------------------------------------

    def _receive(self, reading: Reading) -> None:
        """One reading of the vehicle's sensors, or its battery."""
        library, core = self._library, self._core
        match reading:
            case ImuReading():
                imu = self._imu
                imu.time_ns, imu.has_pressure = reading.time_ns, reading.pressure_pa is not None
                imu.accelerometer[:], imu.gyroscope[:] = reading.accelerometer, reading.gyroscope
                imu.pressure_pa = reading.pressure_pa or 0.0
                library.core_receive_imu(core, imu)
            case FlowReading():
                library.core_receive_flow(core, library.FlowReading(*reading))
            case RangeReading():
                library.core_receive_range(core, library.RangeReading(reading.time_ns, reading.distance_m))
            case BatteryReading():
                self._battery = reading
                library.core_receive_battery(core, library.BatteryReading(*reading))

    def _receive_offboard(self, datagrams: Datagrams, now_ns: int) -> None:
        """Poses for the estimator, chunks of feature versions for the reception."""
        for datagram, arrival_ns in at_times(datagrams, now_ns):
            for message in self._offboard_link.receive(datagram, arrival_ns):
                match message:
                    case DatedPose():
                        self._receive_pose(message, now_ns)
                    case FeatureChunk():
                        self._receive_chunk(message)
                    case PeerRestarted():
                        self._library.core_restart_offboard(self._core)

    def _receive_pose(self, dated: DatedPose, now_ns: int) -> None:
        pose = self._pose
        pose.position[:], pose.quaternion[:] = dated.pose.position_ned_m.tolist(), dated.pose.quaternion.tolist()
        times = dated.taken_ns, dated.arrival_ns, dated.time_sigma_s
        self._library.core_receive_pose(self._core, pose, *times)
        self._arming.receive_pose(dated.pose, self._vehicle_link.health.force, now_ns)

    def _receive_chunk(self, chunk: FeatureChunk) -> None:
        put_chunk(self._chunk, chunk)
        self._library.core_receive_chunk(self._core, self._chunk)

    def _receive_ground(self, datagrams: Datagrams, land: bool, now_ns: int) -> None:
        """Commands of the pilot, and the process's own wish to land."""
        if land:
            self._command(Command.LAND, now_ns)
        for datagram, arrival_ns in at_times(datagrams, now_ns):
            for command in self._ground_link.receive(datagram, arrival_ns):
                self._ground_link.acknowledge(command, self._command(command.command, now_ns), now_ns)

    def _command(self, command: Command, now_ns: int) -> str:
        """Give a command; returns why it is refused, "" if it is not."""
        self._library.core_command(self._core, COMMANDS[command], now_ns, self._refusal)
        return refusal_text(self._refusal, *self._texts())

    # --- reports -------------------------------------------------------------------------------------------------

    def _texts(self) -> tuple[dict[int, str], dict[int, str]]:
        """Texts of the numbers of refusals: of arming checks, and of the calibration."""
        bench = self._core.estimator.calibration
        return self._reasons.texts, {bench.refusal: calibration_text(bench)}

    def _collect_events(self, output: OnboardOutput, now_ns: int) -> None:
        """Events in the order of OnboardCore; those of vehicle link, estimator and modes go to the pilot's screen."""
        result = self._result
        output.events += self._offboard_link.take_events()
        shown = self._vehicle_link.take_events()
        shown += [(one.time_ns, estimator_text(one)) for one in result.estimator_events[: result.estimator_event_count]]
        if self._notice:
            shown.append((now_ns, self._notice))
            self._notice = ""
        if result.supervisor_event_count:
            entered, texts = result.supervisor_events[: result.supervisor_event_count], self._texts()
            shown += [(one.time_ns, supervisor_text(one, *texts)) for one in entered]
        output.events += shown
        for _, text in shown:
            self._ground_link.send_text(text)
        if result.features.offered:
            output.events.append((now_ns, version_text(result.features)))
        for fall in result.features.falls[: result.features.fall_count]:
            text = fall_text(fall)
            output.events.append((now_ns, text))
            self._ground_link.send_text(text)

    def _report(self, output: OnboardOutput, mode: FlightMode, now_ns: int) -> None:
        """Status, time sync and telemetry, each at its own period."""
        link, core, reception = self._offboard_link, self._core, self._core.reception
        small = link.time_sync(now_ns)
        output.clock_offset = link.clock_record(now_ns)
        state = core.estimator.state
        self._state.last_imu_ns, self._state.last_pose_ns = state.last_imu_ns, state.last_pose_ns
        self._state.height_valid = state.height_valid
        output.to_ground += self._ground_link.poll(now_ns, mode, self._state, self._battery)
        if link.status_due(now_ns):
            self._ground_link.values.update(
                feat_ver=float(reception.version),
                feat_age=self._library.reception_age_s(reception, now_ns),
                track_err=self._tracking_error_m,
            )
            ticks = (core.ticks - 1, core.missed_ticks)
            small.append(link.status(now_ns, mode, ticks, state.last_pose_ns, self._reception_status()))
        for datagram in small:
            self._library.core_charge(core, len(datagram), now_ns)
        output.to_offboard += small

    def _reception_status(self) -> ReceptionStatus:
        said = self._said
        self._library.reception_status(self._core.reception, said)
        chunks = bytes(said.received_chunks[: said.received_chunks_size])
        return ReceptionStatus(said.version, said.transfer_version, chunks, said.refused_version, said.refusal)

    def status(self, now_ns: int) -> dict[str, Any]:
        """A few numbers for the live status line."""
        statistics, reception = self._offboard_link.statistics, self._core.reception
        return {
            "mode": FlightMode(self._core.mode).name,
            "not_ready": self._not_ready(),
            "tracking_error_m": self._core.tracking_error_m,
            "feature_version": reception.version,
            "feature_age_s": self._library.reception_age_s(reception, now_ns),
            "link_lost": statistics.lost,
            "link_received": statistics.received,
            "rejected": statistics.rejected.total(),
        }

    def _not_ready(self) -> str:
        """What the vehicle waits for on the ground before it can be armed; "" if nothing."""
        supervisor = self._core.supervisor
        if supervisor.mode != FlightMode.BOOT or not supervisor.has_inputs:
            return ""
        self._library.supervisor_arming_refusal(supervisor, supervisor.inputs, self._refusal)
        return refusal_text(self._refusal, *self._texts())

    @property
    def airborne(self) -> bool:
        """Whether the flight mode is one of those in the air."""
        return FlightMode(self._core.mode) in AIRBORNE

    def summary(self) -> dict[str, Any]:
        """Mode, features, and the counters of links, samples and estimator, for the flight record."""
        core, reception = self._core, self._core.reception
        return {
            "mode": FlightMode(core.mode).name,
            "ticks": core.ticks,
            "missed": core.missed_ticks,
            "features": {
                "version": reception.version,
                "swaps": reception.swaps,
                "refused": reception.refusals,
                "taken_back": reception.taken_back,
            },
            "rejected": dict(self._offboard_link.statistics.rejected),
            "vehicle_rejected": dict(self._vehicle_link.rejected),
            "samples": {name: getattr(core.samples, name) for name in ("taken", "dropped", "repeated")},
            "estimator": counts(core.estimator),
            "nis": mean_scores(core.estimator),
            "calibration": calibration(self._library, core.estimator.calibration),
        }


def _built(config: OnboardConfig, variant: Variant) -> tuple[Any, Any]:
    """The library, and a Core for this configuration. Raises ConfigError as CompiledCore does."""
    try:
        library = load(variant)
        packed = np.frombuffer(image(config), dtype=np.uint8)
    except (BuildError, TableError) as error:
        raise ConfigError(f"--core c: {error}") from None
    decoded, core, start = library.CoreConfig(), library.Core(), (library.ChannelFeatures * 2)()
    if not library.config_decode(packed, packed.size, decoded):
        raise ConfigError("--core c: the packed configuration is not of the core's layout: build it again")
    put_start_features(start, config)
    library.core_init(core, decoded, start)
    return library, core


def _batch(batch: Any) -> SampleBatch:
    """A SampleBatch of C."""
    n = batch.count
    signals, delivered, adaptive = (
        view(member)[: n * (len(member) // 8)].reshape(n, *shape)
        for member, shape in ((batch.signals, (-1,)), (batch.delivered, (2, 3)), (batch.adaptive, (2, 3)))
    )
    head = batch.first_index, batch.time_ns, batch.period_ns, batch.feature_version
    return SampleBatch(*head, signals, delivered, adaptive)


class _Reasons:
    """Numbers for the texts of the arming checks. Texts that differ in digits only have one number."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {"": 0}
        self.texts: dict[int, str] = {}
        """The newest text of each number."""

    def number(self, text: str) -> int:
        kind = "".join(letter for letter in text if not letter.isdigit())
        number = self._numbers.setdefault(kind, len(self._numbers))
        self.texts[number] = text
        return number
