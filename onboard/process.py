"""The 200 Hz loop: the core between its sockets, the clock and the log.

    wait -> receive -> tick -> send

If a tick raises, the process sends the safe motor command, logs the exception and counts it. After a limited number of
such ticks the flight ends with the motors off. The first SIGINT or SIGTERM makes the core land, from any height: the
supervisor limits how long a landing may take (onboard/flight/supervisor.py). The second ends the process at once.
"""

import contextlib
import sys
import time
import traceback
from typing import Any, Final

import numpy as np

from configs.addresses import Addresses, serial_line
from configs.realtime import RealtimeConfig
from flight_log.schema import CLOCK_OFFSET, RecordType
from flight_log.writer import FlightLogWriter
from onboard.control.actuators import CATCH_UP_MAX
from onboard.core import OnboardCore, OnboardOutput
from onboard.links.frame_stream import FrameStream
from onboard.record.datagram_log import TOPIC, DatagramLogWriter, Entry
from onboard.record.tick import TICK
from protocol.arrival import Arrival
from protocol.endpoint import DATAGRAMS_PER_STEP_MAX
from protocol.mavlink.signing import holds_key
from runtime.intake import Intake
from runtime.kernel import own_use, resident_mb
from runtime.pace import DurationStatistics, PaceKeeper
from runtime.serial_port import SerialPort
from runtime.signals import StopRequest
from runtime.sockets import AddressInUseError, DatagramSocket, Stamped
from runtime.status import StatusLines

VEHICLE_FEW: Final = 16
GROUND_FEW: Final = 4
"""Datagrams of a tick that are not screened (runtime/intake.py); of offboard DATAGRAMS_PER_STEP_MAX."""
VEHICLE_KIND_MAX: Final = 4
OFFBOARD_KIND_MAX: Final = 16
GROUND_KIND_MAX: Final = 2
"""Messages of one kind that a flooded tick uses."""
VEHICLE_SILENT_NS: Final = 500_000_000
"""A vehicle that has said nothing for so long is not waited for when the process is asked to end."""
FINAL_SAFE_COMMANDS: Final = 3
"""The last command is repeated: one datagram can be lost."""

LOOP: Final = RecordType(
    "onboard/loop",
    (
        *(("lateness", "us"), ("tick", "us"), ("missed", "")),
        ("computed", "us, of all threads since the tick before"),
        ("own", "us, of the loop's thread alone"),
        ("faults", "page faults of the loop's thread"),
    ),
    "float32",
)


class Sockets:
    """The three addresses onboard talks to."""

    def __init__(self, network: Addresses) -> None:
        ground_host = network.ground.rpartition(":")[0]
        own_host = "127.0.0.1" if ground_host in {"127.0.0.1", "localhost"} else "0.0.0.0"
        self.vehicle = open_vehicle(network.vehicle, network.onboard_vehicle)
        try:
            self.offboard = DatagramSocket("--bind-link", network.onboard_link, network.radio_onboard)
            self.ground = DatagramSocket("--ground", f"{own_host}:0", network.ground)
        except AddressInUseError:
            self.vehicle.close()
            raise

    def close(self) -> None:
        """Close the sockets."""
        for one in (self.vehicle, self.offboard, self.ground):
            one.close()


def open_vehicle(vehicle: str, local: str, option: str = "--bind-vehicle") -> DatagramSocket | SerialPort:
    """The wire to the vehicle: a socket bound to `local` (given by `option`), or the serial line of its address.

    Raises
    ------
    StartError
        If it cannot be opened.
    """
    line = serial_line(vehicle)
    if line is None:
        return DatagramSocket(option, local, vehicle)
    return SerialPort("--vehicle", line.device, line.baud, FrameStream().feed)


class OnboardProcess:
    """The loop around a core. It makes no flight decision itself."""

    def __init__(
        self,
        core: OnboardCore,
        realtime: RealtimeConfig,
        period_ns: int,
        sockets: Sockets,
        log: FlightLogWriter,
        status: StatusLines,
        stop: StopRequest,
    ) -> None:
        self._core = core
        self._realtime = realtime
        self._sockets = sockets
        self._log = log
        self._status = status
        self._stop = stop
        self._pace = PaceKeeper(period_ns, realtime.spin_us * 1000, time.monotonic_ns() + period_ns)
        self._ticks = DurationStatistics()
        self._lateness = DurationStatistics()
        self._loop_record = np.zeros(len(LOOP.fields))
        self._datagrams = DatagramLogWriter()
        vehicle, offboard, ground = core.screens
        self._intakes = (
            Intake("vehicle", sockets.vehicle, VEHICLE_FEW, VEHICLE_KIND_MAX, vehicle, holds_key),
            Intake("offboard", sockets.offboard, DATAGRAMS_PER_STEP_MAX, OFFBOARD_KIND_MAX, offboard),
            Intake("ground", sockets.ground, GROUND_FEW, GROUND_KIND_MAX, ground, holds_key),
        )
        self._last_vehicle_ns = 0
        self._used = (time.process_time_ns(), *own_use())
        self._stopping = False
        self._land_pending = False
        self._latest_report = ""
        self.escapes = 0

    def fly(self) -> int:
        """Run until asked to end; returns the exit status: 0, or 1 if too many ticks failed."""
        now = time.monotonic_ns()
        while not self._ended(now):
            woke_ns = now = self._pace.wait()
            output: OnboardOutput | None
            escapes = self.escapes
            try:
                received = self._receive()
                now = time.monotonic_ns()  # after the reads: no arrival is later
                output = self._core.tick(now, *self._logged(received, now), missed_ticks=self._pace.missed)
                self._land_pending = False  # a request in a tick that raised is repeated
            except Exception:
                output = self._answer_escape(now)
            if output is not None:
                self._send(output, now)
            self._log.write_bytes(TOPIC, now, self._datagrams.end_tick(now, self._pace.missed, self.escapes > escapes))
            self._note_loop(now, woke_ns)
        self._leave_safe(now)
        return int(self.escapes >= self._realtime.escapes_max)

    def _receive(self) -> tuple[list[Stamped], list[Stamped], list[Stamped]]:
        """Datagrams of vehicle, offboard and ground station, with their arrival times.

        After missed ticks more have come from the vehicle: the newest must be among them, or its IMU seems silent.
        """
        vehicle, offboard, ground = self._intakes
        return vehicle.receive(min(1 + self._pace.skipped, CATCH_UP_MAX)), offboard.receive(), ground.receive()

    def _logged(
        self, received: tuple[list[Stamped], list[Stamped], list[Stamped]], now: int
    ) -> tuple[list[Arrival], list[Arrival], list[Arrival], bool]:
        """The datagrams with their ages, and whether to land; all of it logged."""
        land = self._land_pending
        if land:
            self._datagrams.land_request()
        ages = [[Arrival(datagram, now - arrival_ns) for datagram, arrival_ns in one] for one in received]
        from_vehicle, from_offboard, from_ground = ages
        self._datagrams.put(Entry.FROM_VEHICLE, from_vehicle)
        self._datagrams.put(Entry.FROM_OFFBOARD, from_offboard)
        self._datagrams.put(Entry.FROM_GROUND, from_ground)
        if from_vehicle:
            self._last_vehicle_ns = now
        return from_vehicle, from_offboard, from_ground, land

    def _send(self, output: OnboardOutput, now: int) -> None:
        """Send the datagrams of a tick, log it, and report on the status line."""
        for socket, entry, datagrams in (
            (self._sockets.vehicle, Entry.TO_VEHICLE, output.to_vehicle),
            (self._sockets.offboard, Entry.TO_OFFBOARD, output.to_offboard),
            (self._sockets.ground, Entry.TO_GROUND, output.to_ground),
        ):
            for datagram in datagrams:
                socket.send(datagram)
            self._datagrams.put(entry, datagrams)
        self._log.write(TICK, now, output.tick)
        if output.clock_offset is not None:
            self._log.write(CLOCK_OFFSET, now, output.clock_offset)
        for time_ns, text in output.events:
            self._log.event(time_ns, text)
            self._status.report(text)
        if self._status.due(now):
            self._status.write({**self._core.status(now), "missed_ticks": self._pace.missed, "escapes": self.escapes})
            for text in filter(None, (intake.report(now) for intake in self._intakes)):
                self._log.event(now, text)
                self._status.report(text)

    def _note_loop(self, now: int, woke_ns: int) -> None:
        duration_ns = time.monotonic_ns() - woke_ns
        self._ticks.add(duration_ns)
        self._lateness.add(self._pace.lateness_ns)
        record = self._loop_record
        record[0] = self._pace.lateness_ns * 1e-3
        record[1] = duration_ns * 1e-3
        record[2] = self._pace.missed
        all_ns, own_ns, faults = self._used
        self._used = (time.process_time_ns(), *own_use())
        record[3] = (self._used[0] - all_ns) * 1e-3
        record[4] = (self._used[1] - own_ns) * 1e-3
        record[5] = self._used[2] - faults
        self._log.write(LOOP, now, record)

    def _answer_escape(self, now: int) -> OnboardOutput | None:
        """Log the exception of a tick; returns the safe output, or None if that fails as well."""
        self.escapes += 1
        report = traceback.format_exc()
        if report != self._latest_report:
            self._latest_report = report
            self._log.event(now, report)
            print(report, file=sys.stderr, flush=True)
        self._status.report(f"a tick failed ({self.escapes} of {self._realtime.escapes_max}): {_last_line(report)}")
        with contextlib.suppress(Exception):
            return self._core.safe_output(now)
        return None

    def _ended(self, now: int) -> bool:
        """Whether to leave the loop; asks the core to land when first told to end."""
        if self.escapes >= self._realtime.escapes_max or self._stop.count >= 2:
            return True
        if self._stop.count == 0:
            return False
        if not self._stopping:
            self._stopping = self._land_pending = True
        silent = now - self._last_vehicle_ns > VEHICLE_SILENT_NS
        return silent or not self._core.airborne

    def _leave_safe(self, now: int) -> None:
        for _ in range(FINAL_SAFE_COMMANDS):
            with contextlib.suppress(Exception):
                for datagram in self._core.safe_output(now).to_vehicle:
                    self._sockets.vehicle.send(datagram)

    def summary(self) -> dict[str, Any]:
        """What the flight record keeps of this process."""
        return {
            **self._core.summary(),
            "ticks": self._pace.ticks,
            "missed": self._pace.missed,
            "tick_us": self._ticks.summary(),
            "lateness_us": self._lateness.summary(),
            "escapes": self.escapes,
            "dropped": {intake.name: intake.summary() for intake in self._intakes},
            "rss_mb": round(resident_mb(), 1),
        }


def _last_line(report: str) -> str:
    return report.strip().splitlines()[-1]
