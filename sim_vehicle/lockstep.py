"""All cores on one virtual clock in one process: the same steps and bytes as in real time, and repeatable.

Theory of operation. One tick is one onboard period. A motor command computed at tick k acts from tick k + 1, because a
real command takes time to compute and to send. Sensor datagrams reach onboard in the tick in which they are sampled.
Datagrams between onboard and offboard pass through the radio, with the delivery and delay of the scenario. The result
of a training round becomes known after the modelled training time. Lockstep therefore models the same delays as real
time. This file receives built cores; it knows onboard and offboard only by their methods.

The trace hash is the SHA-256 of every datagram that any core sent, in order: two flights with the same hash did the
same.
"""

import hashlib
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

from flight_log.schema import RecordType
from protocol.conventions import Array
from protocol.named_tuple import of_members
from sim_vehicle.link.radio import Radio
from sim_vehicle.vehicle import SimVehicle

ResultT = TypeVar("ResultT")
"""Result of a training round; only offboard reads it."""
ResultT_co = TypeVar("ResultT_co", covariant=True)


class OnboardOutput(Protocol):
    """onboard.core.OnboardOutput."""

    to_vehicle: list[bytes]
    to_offboard: list[bytes]
    to_ground: list[bytes]
    tick: Array
    events: list[tuple[int, str]]
    clock_offset: Array | None


class Onboard(Protocol):
    """onboard.cores.AnyCore."""

    def tick(self, now_ns: int, from_vehicle: list[bytes], from_offboard: list[bytes]) -> OnboardOutput:
        """One control period, with the datagrams that have arrived since the last one."""


class TrainingJob(Protocol[ResultT_co]):
    """offboard.training.job.TrainingJob."""

    def run(self) -> ResultT_co:
        """Train."""


Training = Callable[[TrainingJob[ResultT]], Callable[[], ResultT]]
"""Starts a round of training; what it returns gives the result, and waits for it if need be."""


def train_at_once(job: TrainingJob[ResultT]) -> Callable[[], ResultT]:
    """Train in this process, before the flight goes on."""
    result = job.run()
    return lambda: result


class OffboardOutput(Protocol[ResultT_co]):
    """offboard.records.OffboardOutput."""

    to_onboard: list[bytes]
    records: list[tuple[RecordType, int, Array]]
    events: list[tuple[int, str]]

    @property
    def job(self) -> TrainingJob[ResultT_co] | None:
        """A training round to start now."""


class Offboard(Protocol[ResultT]):
    """offboard.core.OffboardCore."""

    def receive_onboard(self, datagram: bytes, now_ns: int) -> None:
        """Receive a datagram of onboard."""

    def receive_motion_capture(self, datagram: bytes, now_ns: int) -> None:
        """Receive a datagram of the motion capture."""

    def receive_training(self, result: ResultT, now_ns: int) -> None:
        """Receive the result of a training round."""

    def step(self, now_ns: int) -> OffboardOutput[ResultT]:
        """Do everything that is due."""


class TickResult(NamedTuple):
    """What happened in one tick."""

    now_ns: int
    truth: Array
    """See sim_vehicle.records.TRUTH."""
    onboard: OnboardOutput
    """The next tick overwrites it."""
    offboard: OffboardOutput[object] | None
    """None while there is no trainer."""
    training: Sequence[object]
    """Results of training rounds that became known in this tick."""
    from_vehicle: list[bytes]
    """Datagrams of the vehicle that onboard received, in order. It received them before those of offboard."""
    from_offboard: list[bytes]
    """Datagrams of offboard that onboard received, in order."""
    radio: Radio
    """For the delivery of each datagram."""


_result: Final = of_members(TickResult)


class Lockstep(Generic[ResultT]):
    """Vehicle, radio, onboard and, unless absent, offboard.

    Parameters
    ----------
    vehicle, radio, onboard, offboard: built cores; offboard may be None.
    period_ns: one tick.
    training_time_ns: virtual time from the start of a training round to its result.
    train: how rounds of training are run. The result is the same, and known at the same virtual time.
    """

    def __init__(
        self,
        vehicle: SimVehicle,
        radio: Radio,
        onboard: Onboard,
        offboard: Offboard[ResultT] | None,
        period_ns: int,
        training_time_ns: int,
        train: Training[ResultT] = train_at_once,
    ) -> None:
        self._vehicle = vehicle
        self._radio = radio
        self._onboard = onboard
        self._offboard = offboard
        self._period_ns = period_ns
        self._training_time_ns = training_time_ns
        self._commands: deque[list[bytes]] = deque([[]])
        self._train = train
        self._training: deque[tuple[int, Callable[[], ResultT]]] = deque()
        self._hash = hashlib.sha256()
        self.now_ns = 0
        """Time of the next tick."""

    @property
    def trace_sha256(self) -> str:
        """Hash of all datagrams so far."""
        return self._hash.hexdigest()

    @property
    def crash_reason(self) -> str:
        """Why the vehicle crashed; empty until then."""
        return self._vehicle.crash_reason

    def remove_offboard(self) -> None:
        """End the offboard process. Its datagrams already in the radio still arrive."""
        self._offboard = None
        self._training.clear()

    def attach_offboard(self, offboard: Offboard[ResultT]) -> None:
        """Start a new offboard process."""
        self._offboard = offboard

    def step(self) -> TickResult:
        """Run one tick of all cores."""
        now = self.now_ns
        flown = self._vehicle.step(now)
        from_offboard = self._radio.due("down", now)
        onboard = self._step_onboard(flown.to_onboard, from_offboard, now)
        offboard, training = self._step_offboard(flown.to_motion_capture, now)
        self.now_ns += self._period_ns
        return _result((now, flown.truth, onboard, offboard, training, flown.to_onboard, from_offboard, self._radio))

    def _step_onboard(self, sensors: list[bytes], from_offboard: list[bytes], now: int) -> OnboardOutput:
        for datagram in sensors:
            self._hash.update(datagram)
        output = self._onboard.tick(now, sensors, from_offboard)
        self._commands.append(output.to_vehicle)
        for datagram in self._commands.popleft():
            self._vehicle.receive(datagram, now)
        for datagram in output.to_vehicle:
            self._hash.update(datagram)
        for datagram in output.to_offboard:
            self._hash.update(datagram)
            self._radio.send("up", datagram, now)
        return output

    def _step_offboard(
        self, motion_capture: list[bytes], now: int
    ) -> tuple[OffboardOutput[ResultT] | None, list[ResultT]]:
        offboard, results = self._offboard, []
        arrived = self._radio.due("up", now)
        if offboard is None:
            return None, []
        for datagram in motion_capture:
            offboard.receive_motion_capture(datagram, now)
        for datagram in arrived:
            offboard.receive_onboard(datagram, now)
        while self._training and self._training[0][0] <= now:
            results.append(self._training.popleft()[1]())
            offboard.receive_training(results[-1], now)
        output = offboard.step(now)
        if output.job is not None:
            self._training.append((now + self._training_time_ns, self._train(output.job)))
        for datagram in output.to_onboard:
            self._hash.update(datagram)
            self._radio.send("down", datagram, now)
        return output, results
