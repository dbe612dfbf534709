"""The process of the simulated vehicle: dynamics in real time, motion capture, and the radio between the others.

Theory of operation. Flight time starts with the first motor command (onboard sends them at 200 Hz, armed or not), so
that a slow start of a process does not shift the scenario. The vehicle then steps on an absolute grid, with a fixed
phase after onboard's ticks. Motor commands act when they arrived, by the kernel's stamp. After a stall, one step
integrates the vehicle to the present: no physics is lost, only sensor datagrams arrive late. Radio datagrams leave when
they are due. No real vehicle stalls so: stalls.py says which flights are invalid.
"""

import select
import sys
import time
from typing import Any, Final

import numpy as np

from configs.addresses import Addresses
from flight_log.schema import RecordType
from flight_log.writer import FlightLogWriter
from runtime.kernel import resident_mb
from runtime.signals import StopRequest
from runtime.sockets import AddressInUseError, DatagramSocket
from runtime.status import StatusLines
from sim_vehicle.link.radio import DELIVERY, DIRECTIONS, Radio, delivery_vector
from sim_vehicle.records import TRUTH
from sim_vehicle.stalls import Stalls
from sim_vehicle.vehicle import PERIOD_NS, SimVehicle

START_PHASE_NS: Final = 1_000_000
"""From a motor command to the sensors, which are then 3 to 4 ms old at the next onboard tick."""
MOTOR_DATAGRAMS_PER_WAKE: Final = 16
RADIO_DATAGRAMS_PER_WAKE: Final = 64
LANDING_OVERTIME_NS: Final = 25_000_000_000
"""Time to land for a vehicle that is still in the air at the end of the flight."""
_AIRBORNE: Final = TRUTH.names.index("airborne")
AFTER_CRASH_NS: Final = 500_000_000
"""The process continues so long after a crash, so that the others record it."""
START_LIMIT_S: Final = 120.0

LOOP: Final = RecordType("sim_vehicle/loop", (("step_late", "us"), ("stalled_steps", "")), "float32")


class SimProcess:
    """The loop around the simulated vehicle and its radio."""

    def __init__(
        self,
        vehicle: SimVehicle,
        radio: Radio,
        network: Addresses,
        duration_s: float,
        log: FlightLogWriter,
        status: StatusLines,
        stop: StopRequest,
    ) -> None:
        self._vehicle = vehicle
        self._radio = radio
        self._duration_ns = round(duration_s * 1e9)
        self._log = log
        self._status = status
        self._stop = stop
        self._open(network)
        self._start_ns = 0
        self._next_step_ns = 0
        self._loop_record = np.zeros(len(LOOP.fields))
        self._crash_ns = 0
        self._airborne = self._flown = self._ever_armed = False
        self.steps = 0
        self.stalled_steps = 0
        self.stalls = Stalls()

    def _open(self, network: Addresses) -> None:
        sockets: list[DatagramSocket] = []
        try:
            for name, local, remote in (
                ("--bind-vehicle", network.vehicle, network.onboard_vehicle),
                ("--bind-radio-onboard", network.radio_onboard, network.onboard_link),
                ("--bind-radio-offboard", network.radio_offboard, network.offboard_link),
                ("--motion-capture", _any_port(network.motion_capture), network.motion_capture),
            ):
                sockets.append(DatagramSocket(name, local, remote))
        except AddressInUseError:
            for one in sockets:
                one.close()
            raise
        self._motors, self._onboard_side, self._offboard_side, self._poses = sockets
        self._inputs = (self._motors, self._onboard_side, self._offboard_side)

    def fly(self) -> int:
        """Run until the flight is over, the vehicle has crashed or a stop is requested; returns the exit status."""
        if not self._wait_for_onboard():
            return 0 if self._stop.count else 1
        while not self._ended():
            self._wait()
            now = time.monotonic_ns() - self._start_ns
            self._carry_radio(now)
            for datagram, arrival_ns in self._motors.receive_stamped(MOTOR_DATAGRAMS_PER_WAKE):
                self._vehicle.receive(datagram, self._flight_time(arrival_ns))
            if now >= self._next_step_ns:
                self._step(now)
        if not self._ever_armed:
            self.stalls.note_no_flight()
        return 0

    def _flight_time(self, arrival_ns: int) -> int:
        """Flight time of an arrival; 0 before the flight."""
        return max(0, arrival_ns - self._start_ns)

    def close(self) -> None:
        """Close the sockets."""
        for one in (*self._inputs, self._poses):
            one.close()

    def _wait_for_onboard(self) -> bool:
        """Wait at flight time 0 for the first motor command; False if none comes or the process is asked to stop.

        Until then nothing of the scenario runs, not even the radio.
        """
        limit_ns = time.monotonic_ns() + round(START_LIMIT_S * 1e9)
        while time.monotonic_ns() < limit_ns and self._stop.count == 0:
            select.select((self._motors,), (), (), 0.1)
            first = self._motors.receive(MOTOR_DATAGRAMS_PER_WAKE)
            if first:
                self._start_ns = time.monotonic_ns() + START_PHASE_NS
                self._vehicle.start_capture(time.time_ns())
                self._vehicle.receive(first[-1], 0)
                return True
        if self._stop.count == 0:
            print(f"no motor command came within {START_LIMIT_S:.0f} s; is onboard running?", file=sys.stderr)
        return False

    def _wait(self) -> None:
        """Sleep until a datagram arrives, or a radio datagram or the next step is due."""
        due_ns = self._next_step_ns
        for direction in DIRECTIONS:
            radio_due_ns = self._radio.next_due_ns(direction)
            if radio_due_ns is not None and radio_due_ns < due_ns:
                due_ns = radio_due_ns
        ahead_ns = due_ns + self._start_ns - time.monotonic_ns()
        select.select(self._inputs, (), (), max(0.0, ahead_ns * 1e-9))

    def _carry_radio(self, now: int) -> None:
        for datagram, arrival_ns in self._onboard_side.receive_stamped(RADIO_DATAGRAMS_PER_WAKE):
            self._radio.send("up", datagram, self._flight_time(arrival_ns))
        for datagram, arrival_ns in self._offboard_side.receive_stamped(RADIO_DATAGRAMS_PER_WAKE):
            self._radio.send("down", datagram, self._flight_time(arrival_ns))
        for datagram in self._radio.due("up", now):
            self._offboard_side.send(datagram)
        for datagram in self._radio.due("down", now):
            self._onboard_side.send(datagram)

    def _step(self, now: int) -> None:
        """One step of the vehicle on the grid. After a stall, one step covers all the missed ones."""
        late_ns = now - self._next_step_ns
        stalled = late_ns // PERIOD_NS
        self.stalled_steps += stalled
        self.stalls.note(now, late_ns)
        step_ns = self._next_step_ns + stalled * PERIOD_NS
        armed_before = self._vehicle.armed
        output = self._vehicle.step(step_ns)
        self._ever_armed |= self._vehicle.armed
        landed = self._flown and not self._airborne
        if armed_before and not self._vehicle.armed and not landed:
            self.stalls.note_stop(now)
        for datagram in output.to_onboard:
            self._motors.send(datagram)
        for datagram in output.to_motion_capture:
            self._poses.send(datagram)
        self._next_step_ns = step_ns + PERIOD_NS
        self.steps += 1
        self._record(step_ns, late_ns, output.truth)

    def _record(self, step_ns: int, late_ns: int, truth: Any) -> None:
        at_ns = step_ns + self._start_ns
        self._airborne = bool(truth[_AIRBORNE])
        self._flown |= self._airborne
        self._log.write(TRUTH, at_ns, truth)
        self._loop_record[0] = late_ns * 1e-3
        self._loop_record[1] = self.stalled_steps
        self._log.write(LOOP, at_ns, self._loop_record)
        self._record_deliveries(at_ns)
        if self._vehicle.crash_reason and self._crash_ns == 0:
            self._crash_ns = step_ns
            self.stalls.note_crash(step_ns)
            text = f"vehicle lost at {step_ns * 1e-9:.2f} s: {self._vehicle.crash_reason}"
            self._log.event(at_ns, text)
            self._status.report(text)
        if self._status.due(at_ns):
            self._status.write(self.status(step_ns))

    def _record_deliveries(self, at_ns: int) -> None:
        for direction in DIRECTIONS:
            for delivery in self._radio.take_deliveries(direction):
                self._log.write(DELIVERY, at_ns, delivery_vector(direction, delivery))

    def _ended(self) -> bool:
        if self._stop.count:
            return True
        if self._crash_ns:
            return self._next_step_ns > self._crash_ns + AFTER_CRASH_NS
        overtime_ns = LANDING_OVERTIME_NS if self._airborne else 0
        return self._next_step_ns > self._duration_ns + overtime_ns

    def status(self, now: int) -> dict[str, Any]:
        """What the live status shows of this process."""
        return {"time_s": now * 1e-9, "link": self._counts()}

    def _counts(self) -> dict[str, dict[str, int]]:
        names = ("sent", "delivered", "lost", "duplicated", "corrupted")
        return {
            direction: {name: getattr(self._radio.counts(direction), name) for name in names}
            for direction in DIRECTIONS
        }

    def summary(self) -> dict[str, Any]:
        """Summary for the flight folder. Times in the log of this process are on the machine's monotonic clock."""
        return {
            "start_ns": self._start_ns,
            "duration_s": max(0, self._next_step_ns - PERIOD_NS) * 1e-9,
            "survived": not self._vehicle.crash_reason,
            "crash_reason": self._vehicle.crash_reason,
            "link": self._counts(),
            "steps": self.steps,
            "stalled_steps": self.stalled_steps,
            "invalid_reason": self.stalls.invalid_reason,
            "rss_mb": round(resident_mb(), 1),
        }


def _any_port(peer: str) -> str:
    """A free port on the interface that leads to `peer`."""
    local = peer.startswith(("127.", "localhost:"))
    return "127.0.0.1:0" if local else "0.0.0.0:0"
