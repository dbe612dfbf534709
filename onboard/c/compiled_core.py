"""The onboard core in C, with the interface of `onboard.core.OnboardCore`.

What speaks MAVLink, the links to vehicle and ground station and the arming checks, is that of the numpy core. All other
blocks are one call of C (core.h).
"""

import struct
from functools import partial
from typing import Any, Final

import numpy as np

from configs.loader import ConfigError
from onboard.c.compile import DEFAULT, BuildError, Variant
from onboard.c.compiled_controller import CompiledController
from onboard.c.config_table import TableError, image
from onboard.c.estimator_summary import calibration, counts, mean_scores
from onboard.c.event_text import (
    calibration_text,
    estimator_text,
    fall_text,
    link_text,
    refusal_text,
    supervisor_text,
    version_text,
)
from onboard.c.feature_arrays import put_start_features, view
from onboard.c.library import load
from onboard.config import OnboardConfig
from onboard.core import ZERO, OnboardOutput
from onboard.estimation.state import VehicleState
from onboard.flight.arming import ArmingChecks
from onboard.flight.modes import AIRBORNE, Command, FlightMode
from onboard.links.ground import GroundLink
from onboard.links.vehicle import Reading, VehicleLink
from onboard.preflight.certificate import CLEAR, Clearance
from protocol.arrival import Datagrams, at_times
from protocol.authentication import KEY_MAX_BYTES, KEY_MIN_BYTES
from protocol.clock import ForwardClock
from protocol.conventions import NEVER_NS
from protocol.mavlink.signing import SigningClock
from protocol.mavlink.vehicle import BatteryReading, FlowReading, ImuReading, RangeReading
from protocol.session import session_start_ns
from protocol.statistics import REJECTIONS

MODES: Final = tuple(FlightMode)
"""By their numbers."""
IN_AIR: Final = tuple(mode in AIRBORNE for mode in MODES)
"""Whether each is one of those in the air."""
IMU, FLOW, RANGE, BATTERY = "@q3{0}3{0}?{0}", "@q5{0}i", "@q{0}", "@q{0}{0}"
"""Layout of the readings in C (estimation/readings.h), for struct; {0}: d or f."""
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
    ValueError
        If the key is too short or too long.
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
        self._library, self._core = _built(config, variant, session, key or b"")
        core = self._library
        self._clock = ForwardClock()
        utc_ns = session_start_ns(session)
        self._vehicle_link = VehicleLink(config.vehicle_link, vehicle_key, SigningClock(utc_at_first_use_ns=utc_ns))
        self._ground_link = GroundLink(config.ground_link, ground_key, SigningClock(utc_at_first_use_ns=utc_ns))
        self._arming = ArmingChecks(config, clearance)
        self.controller = CompiledController(core, self._core.controller)
        self._notice = clearance.notice
        self._inputs, self._result = core.CoreInputs(), core.CoreOutput()
        self._received, self._refusal = core.Received(), core.ArmingRefusal()
        self._datagrams = [view(one.bytes) for one in self._result.to_offboard]
        self._motors, self._features = view(self._result.motors), self._result.features
        self._pose = view(self._received.pose.pose.position), view(self._received.pose.pose.quaternion)
        self._imu, self._flow = _Packed(core, core.ImuReading, IMU), _Packed(core, core.FlowReading, FLOW)
        self._range = _Packed(core, core.RangeReading, RANGE)
        self._battery_packed = _Packed(core, core.BatteryReading, BATTERY)
        self._output = OnboardOutput(tick=view(self._result.tick))
        self._estimated = state = self._core.estimator.state
        names = ("position", "velocity", "quaternion", "euler", "rates")
        self._state = VehicleState(**{name: view(getattr(state, name)) for name in names})
        """What the ground link shows; the arrays are those of the C core."""
        self._battery = BatteryReading(NEVER_NS, 0.0, -1.0)
        self._reasons, self._calibration_texts = _Reasons(), dict[int, str]()
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
        if from_ground or land:  # a refusal is about the last tick: before the new readings
            self._receive_ground(from_ground, land, now_ns)
        for datagram, arrival_ns in at_times(from_vehicle, now_ns):
            for reading in self._vehicle_link.receive(datagram, arrival_ns):
                self._receive(reading)
        if from_offboard:
            self._receive_offboard(from_offboard, now_ns)
        inputs.now_ns, inputs.missed_ticks = now_ns, missed_ticks
        if not IN_AIR[core.mode]:  # in flight C does not read it
            posed = core.posed or self._estimated.last_pose_ns != NEVER_NS
            inputs.preflight = self._reasons.number(self._arming.refusal(now_ns, posed, self._vehicle_link))
        inputs.ground_ns = self._ground_link.last_received_ns
        self._library.core_tick(core, inputs, result)
        self._collect_events(output, now_ns)
        output.to_vehicle.append(self._vehicle_link.encode_motors(self._motors.tolist(), result.spinning, now_ns))
        for index in range(result.to_offboard_count):
            output.to_offboard.append(self._datagrams[index][: result.to_offboard[index].size].tobytes())
        self._report(output, now_ns)
        self._tracking_error_m = core.tracking_error_m
        return output

    def safe_output(self, now_ns: int) -> OnboardOutput:
        """Motors off and nothing else: for a tick that raised, and at the end."""
        return OnboardOutput(to_vehicle=[self._vehicle_link.encode_motors(ZERO, False, now_ns)])

    # --- receive -------------------------------------------------------------------------------------------------

    def _receive(self, reading: Reading) -> None:
        """One reading of the vehicle's sensors, or its battery."""
        library, core = self._library, self._core
        if isinstance(reading, ImuReading):
            time_ns, accelerometer, gyroscope, pressure_pa = reading
            has_pressure = pressure_pa is not None
            imu = self._imu
            imu.fill(time_ns, *accelerometer, *gyroscope, has_pressure, pressure_pa if has_pressure else 0.0)
            library.core_receive_imu(core, imu.filled)
        elif isinstance(reading, FlowReading):
            self._flow.fill(*reading)
            library.core_receive_flow(core, self._flow.filled)
        elif isinstance(reading, RangeReading):
            self._range.fill(reading.time_ns, reading.distance_m)
            library.core_receive_range(core, self._range.filled)
        else:
            self._battery = reading
            self._battery_packed.fill(*reading)
            library.core_receive_battery(core, self._battery_packed.filled)

    def _receive_offboard(self, datagrams: Datagrams, now_ns: int) -> None:
        """Poses and chunks of feature versions; the arming checks compare a pose with the IMU."""
        received = self._received
        for datagram, arrival_ns in at_times(datagrams, now_ns):
            self._library.core_receive_offboard(self._core, bytes(datagram), len(datagram), arrival_ns, received)
            if received.has_pose:
                position, quaternion = self._pose
                self._arming.receive_pose(position.item(2), quaternion.tolist(), self._vehicle_link, now_ns)

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
        """Texts of the numbers of refusals, of arming checks and of the calibration: the newest of each number."""
        bench = self._core.estimator.calibration
        self._calibration_texts[bench.refusal] = calibration_text(bench)
        return self._reasons.texts, self._calibration_texts

    def _collect_events(self, output: OnboardOutput, now_ns: int) -> None:
        """Events in the order of OnboardCore; those of vehicle link, estimator and modes go to the pilot's screen."""
        result, shown = self._result, self._vehicle_link.take_events()
        if count := result.link_event_count:
            output.events += [(one.time_ns, link_text(one)) for one in result.link_events[:count]]
        if count := result.estimator_event_count:
            shown += [(one.time_ns, estimator_text(one)) for one in result.estimator_events[:count]]
        if self._notice:
            shown.append((now_ns, self._notice))
            self._notice = ""
        if result.supervisor_event_count:
            entered, texts = result.supervisor_events[: result.supervisor_event_count], self._texts()
            shown += [(one.time_ns, supervisor_text(one, *texts)) for one in entered]
        output.events += shown
        for _, text in shown:
            self._ground_link.send_text(text)
        features = self._features
        if features.offered:
            output.events.append((now_ns, version_text(features)))
        for fall in features.falls[:count] if (count := features.fall_count) else ():
            text = fall_text(fall)
            output.events.append((now_ns, text))
            self._ground_link.send_text(text)

    def _report(self, output: OnboardOutput, now_ns: int) -> None:
        """The clock of offboard, and telemetry for the pilot."""
        core, result = self._core, self._result
        output.clock_offset = None
        if result.has_clock:
            clock = result.clock
            output.clock_offset = np.array([clock.offset_ns, clock.round_trip_ns], np.float64)
        if self._ground_link.is_due(now_ns):
            state = self._estimated
            self._state.last_imu_ns, self._state.last_pose_ns = state.last_imu_ns, state.last_pose_ns
            self._state.height_valid = state.height_valid
            output.to_ground += self._ground_link.poll(now_ns, MODES[result.mode], self._state, self._battery)
        if result.status_sent:
            self._ground_link.values.update(
                feat_ver=float(core.reception.version),
                feat_age=self._library.reception_age_s(core.reception, now_ns),
                track_err=self._tracking_error_m,
            )

    def status(self, now_ns: int) -> dict[str, Any]:
        """A few numbers for the live status line."""
        statistics, reception = self._core.offboard.endpoint.statistics, self._core.reception
        return {
            "mode": FlightMode(self._core.mode).name,
            "not_ready": self._not_ready(),
            "tracking_error_m": self._core.tracking_error_m,
            "feature_version": reception.version,
            "feature_age_s": self._library.reception_age_s(reception, now_ns),
            "link_lost": statistics.lost,
            "link_received": statistics.received,
            "rejected": self._library.link_statistics_rejected(statistics),
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
        return IN_AIR[int(self._core.mode)]

    def summary(self) -> dict[str, Any]:
        """Mode, features, and the counters of links, samples and estimator, for the flight record."""
        core, reception = self._core, self._core.reception
        rejected = core.offboard.endpoint.statistics.rejected
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
            "rejected": {reason: count for reason, count in zip(REJECTIONS, rejected, strict=True) if count},
            "vehicle_rejected": dict(self._vehicle_link.rejected),
            "samples": {name: getattr(core.samples, name) for name in ("taken", "dropped", "repeated")},
            "estimator": counts(core.estimator),
            "nis": mean_scores(core.estimator),
            "calibration": calibration(self._library, core.estimator.calibration),
        }


def _built(config: OnboardConfig, variant: Variant, session: int, key: bytes) -> tuple[Any, Any]:
    """The library, and a Core for this configuration. Raises as CompiledCore does."""
    try:
        library = load(variant)
        packed = np.frombuffer(image(config), dtype=np.uint8)
    except (BuildError, TableError) as error:
        raise ConfigError(f"--core c: {error}") from None
    decoded, core, start = library.CoreConfig(), library.Core(), (library.ChannelFeatures * 2)()
    if not library.config_decode(packed, packed.size, decoded):
        raise ConfigError("--core c: the packed configuration is not of the core's layout: build it again")
    put_start_features(start, config)
    if not library.core_init(core, decoded, start, session, key, len(key)):
        raise ValueError(f"key of {len(key)} bytes, allowed {KEY_MIN_BYTES} to {KEY_MAX_BYTES}")
    return library, core


class _Packed:
    """A structure of numbers in C, `filled`, and `fill`, which writes all its members in one step."""

    def __init__(self, core: Any, structure: Any, layout: str) -> None:
        packing = struct.Struct(layout.format("d" if core.real == "double" else "f"))
        self.filled: Final = structure()
        self.fill: Final = partial(packing.pack_into, self.filled, 0)


class _Reasons:
    """Numbers for the texts of the arming checks. Texts that differ in digits only have one number."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {"": 0}
        self.texts: dict[int, str] = {0: ""}
        """The newest text of each number."""
        self._last = ("", 0)

    def number(self, text: str) -> int:
        if text == self._last[0]:
            return self._last[1]
        kind = "".join(letter for letter in text if not letter.isdigit())
        number = self._numbers.setdefault(kind, len(self._numbers))
        self.texts[number] = text
        self._last = text, number
        return number
