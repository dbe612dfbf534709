"""Writes the logs of a lockstep flight: the same files, topics and times as three processes in real time."""

from pathlib import Path
from types import TracebackType
from typing import Self

from experiments.flights.carried_experience import read_experience
from experiments.flights.lockstep_flight import ONBOARD_SESSION, Deliveries, LockstepOutcome, Observer, fly_lockstep
from experiments.flights.scenario import FlightConfig
from flight_log.schema import CLOCK_OFFSET
from flight_log.writer import FlightLogWriter
from offboard.training.job import TrainingResult
from onboard.cores import NUMPY
from onboard.record.datagram_log import TOPIC, DatagramLogWriter, Entry
from onboard.record.tick import TICK
from sim_vehicle.link.radio import DELIVERY, DIRECTIONS, delivery_vector
from sim_vehicle.lockstep import OnboardOutput, TickResult, Training, train_at_once
from sim_vehicle.records import TRUTH

PROCESSES = ("sim_vehicle", "onboard", "offboard")
EXPERIENCE = "experience.npz"
"""Attachment of onboard's log: the experience that the flight started from, if any."""


class LockstepLog:
    """Observer of a lockstep flight that logs each tick. A context manager.

    Parameters
    ----------
    with_offboard: whether the flight has an offboard side; recorded for replays.
    experience: content of the file that the flight starts from; None: of the file in the configuration, if any.
    core: name of the onboard core; recorded for replays.
    """

    def __init__(
        self,
        folder: Path,
        config: FlightConfig,
        with_offboard: bool = True,
        experience: bytes | None = None,
        core: str = NUMPY,
    ) -> None:
        given = {name for name, value in config.network if value is not None}
        metadata = {"seed": str(config.seed), "scenario": config.scenario, "clock": "lockstep"}
        metadata |= {"session": str(ONBOARD_SESSION), "with_offboard": str(with_offboard), "core": core}
        metadata |= {"keyed": str(bool({"key_file", "vehicle_key_file", "ground_key_file"} & given))}
        attachments = {"config.yaml": config.to_yaml().encode()}
        experience = read_experience(config) if experience is None else experience
        if experience is not None:
            attachments[EXPERIENCE] = experience
        self._logs = {
            process: FlightLogWriter(folder / f"{process}.mcap", process, metadata, attachments, threaded=False)
            for process in PROCESSES
        }
        self._datagrams = DatagramLogWriter()
        self._deliveries_logged = dict.fromkeys(DIRECTIONS, 0)

    def __call__(self, result: TickResult) -> None:
        """Log one tick."""
        now, onboard = result.now_ns, self._logs["onboard"]
        self._logs["sim_vehicle"].write(TRUTH, now, result.truth)
        self._record_deliveries(result)
        onboard.write(TICK, now, result.onboard.tick)
        if result.onboard.clock_offset is not None:
            onboard.write(CLOCK_OFFSET, now, result.onboard.clock_offset)
        inputs = result.from_vehicle, result.from_offboard
        onboard.write_bytes(TOPIC, now, datagram_record(self._datagrams, now, *inputs, result.onboard))
        if result.offboard is not None:
            for record_type, when_ns, vector in result.offboard.records:
                self._logs["offboard"].write(record_type, when_ns, vector)

    def _record_deliveries(self, result: TickResult) -> None:
        for direction, deliveries in result.radio.deliveries.items():
            for delivery in deliveries[self._deliveries_logged[direction] :]:
                self._logs["sim_vehicle"].write(DELIVERY, result.now_ns, delivery_vector(direction, delivery))
            self._deliveries_logged[direction] = len(deliveries)

    def event(self, process: str, time_ns: int, text: str) -> None:
        """Log an event."""
        self._logs[process].event(time_ns, text)

    @property
    def faults(self) -> list[str]:
        """Why the logs are incomplete, one line each."""
        return [f"{process}: {log.failure}" for process, log in self._logs.items() if log.failure]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for log in self._logs.values():
            log.close()


def datagram_record(
    log: DatagramLogWriter, now_ns: int, from_vehicle: list[bytes], from_offboard: list[bytes], output: OnboardOutput
) -> bytes:
    """Return the record of a tick's datagrams, as the onboard process writes it."""
    log.put(Entry.FROM_VEHICLE, from_vehicle)
    log.put(Entry.FROM_OFFBOARD, from_offboard)
    log.put(Entry.TO_VEHICLE, output.to_vehicle)
    log.put(Entry.TO_OFFBOARD, output.to_offboard)
    log.put(Entry.TO_GROUND, output.to_ground)
    return log.end_tick(now_ns, missed_ticks=0)


def fly_and_log(
    config: FlightConfig,
    folder: Path,
    with_offboard: bool,
    experience: bytes | None = None,
    recorded: Deliveries | None = None,
    core: str = NUMPY,
    train: Training[TrainingResult] = train_at_once,
    observers: tuple[Observer, ...] = (),
) -> LockstepOutcome:
    """Fly in lockstep and write the logs into `folder`. Parameters and errors as of `fly_lockstep`."""
    with LockstepLog(folder, config, with_offboard, experience, core) as log:
        seen_by: tuple[Observer, ...] = (log, *observers)
        outcome = fly_lockstep(config, seen_by, with_offboard, experience, recorded, core=core, train=train)
        for when_ns, process, text in outcome.events:
            log.event(process, when_ns, text)
    outcome.log_faults = log.faults
    return outcome
