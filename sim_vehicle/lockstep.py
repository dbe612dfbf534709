"""All cores on one virtual clock in one process: the same steps and the same bytes as in real time, repeatable.

Theory of operation. One tick is one onboard period. The vehicle advances to the tick's time with the motor command
computed two ticks ago at the latest (a command computed at tick k acts from tick k+1, as one that has to be computed
and carried does); its sensors reach onboard in the same tick; what onboard and offboard say passes through the radio
with the scenario's delivery and delay; a training round takes its modelled time before its result counts. So lockstep
is not kinder than reality. This file gets built cores and knows only their methods.

The trace hash is the SHA-256 of every datagram that any core gave out, in order: two flights with the same hash did
the same.
"""

import hashlib
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Protocol


class Vehicle(Protocol):
    """sim_vehicle.vehicle.SimVehicle, as lockstep uses it."""

    def take_in(self, datagram: bytes, now_ns: int) -> None:
        """A motor command."""

    def step(self, now_ns: int) -> Any:
        """Advances to now; answers with to_onboard, to_motion_capture, truth."""

    @property
    def crash_reason(self) -> str:
        """Empty while alive."""


@dataclass(slots=True)
class TickResult:
    """What one tick brought to light, for whoever records it."""

    now_ns: int = 0
    truth: Any = None
    onboard: Any = None
    """onboard.core.OnboardOutput."""
    offboard: Any = None
    """offboard.core.OffboardOutput, or None where there is no trainer."""
    training: list[Any] = field(default_factory=list)
    """Results of training rounds that became known in this tick."""
    from_vehicle: list[bytes] = field(default_factory=list)
    """Datagrams of the vehicle that onboard took in, in their order, all before those of offboard."""
    from_offboard: list[bytes] = field(default_factory=list)
    """Datagrams of offboard that onboard took in."""
    radio: Any = None
    """sim_vehicle.link.radio.Radio, for what became of each datagram."""


class Lockstep:
    """Vehicle, radio, onboard and, unless absent, offboard.

    Parameters
    ----------
    vehicle, radio, onboard, offboard: built cores; offboard may be None.
    period_ns: one tick.
    training_time_ns: virtual time from the start of a training round to its result.
    """

    def __init__(
        self, vehicle: Vehicle, radio: Any, onboard: Any, offboard: Any, period_ns: int, training_time_ns: int
    ) -> None:
        self._vehicle = vehicle
        self._radio = radio
        self._onboard = onboard
        self._offboard = offboard
        self._period_ns = period_ns
        self._training_time_ns = training_time_ns
        self._commands: deque[list[bytes]] = deque([[]])
        self._training: deque[tuple[int, Any]] = deque()
        self._hash = hashlib.sha256()
        self._tick = 0
        self.result = TickResult(radio=radio)

    @property
    def trace_sha256(self) -> str:
        """Hash of all datagrams so far."""
        return self._hash.hexdigest()

    @property
    def crash_reason(self) -> str:
        """Why the vehicle is lost; empty while it is alive."""
        return self._vehicle.crash_reason

    def remove_offboard(self) -> None:
        """The offboard process dies: nothing of it is left but datagrams already in the air."""
        self._offboard = None
        self._training.clear()

    def attach_offboard(self, offboard: Any) -> None:
        """A new offboard process starts."""
        self._offboard = offboard

    def step(self) -> TickResult:
        """One tick of everything."""
        now = self._tick * self._period_ns
        result = self.result
        result.now_ns = now
        result.training = []
        flown = self._vehicle.step(now)
        self._step_onboard(flown.to_onboard, now)
        self._step_offboard(flown.to_motion_capture, now)
        result.truth = flown.truth
        self._tick += 1
        return result

    def _step_onboard(self, sensors: list[bytes], now: int) -> None:
        onboard = self._onboard
        from_offboard = self._radio.due("down", now)
        self.result.from_vehicle, self.result.from_offboard = sensors, from_offboard
        for datagram in sensors:
            self._hash.update(datagram)
            onboard.take_in_vehicle(datagram, now)
        for datagram in from_offboard:
            onboard.take_in_offboard(datagram, now)
        output = onboard.step(now)
        self._commands.append(output.to_vehicle)
        for datagram in self._commands.popleft():
            self._vehicle.take_in(datagram, now)
        for datagram in output.to_vehicle:
            self._hash.update(datagram)
        for datagram in output.to_offboard:
            self._hash.update(datagram)
            self._radio.send("up", datagram, now)
        self.result.onboard = output

    def _step_offboard(self, motion_capture: list[bytes], now: int) -> None:
        offboard = self._offboard
        arrived = self._radio.due("up", now)
        self.result.offboard = None
        if offboard is None:
            return
        for datagram in motion_capture:
            offboard.receive_motion_capture(datagram, now)
        for datagram in arrived:
            offboard.receive_onboard(datagram, now)
        while self._training and self._training[0][0] <= now:
            outcome = self._training.popleft()[1]
            offboard.receive_training(outcome, now)
            self.result.training.append(outcome)
        output = offboard.step(now)
        if output.job is not None:
            self._training.append((now + self._training_time_ns, output.job.run()))
        for datagram in output.to_onboard:
            self._hash.update(datagram)
            self._radio.send("down", datagram, now)
        self.result.offboard = output
