"""The flight log of a lockstep flight: the same files, topics and times as three processes would leave."""

from pathlib import Path
from types import TracebackType
from typing import Self

from experiments.scenario import FlightConfig
from flight_record.writer import FlightLogWriter
from onboard.tick_record import TICK
from sim_vehicle.lockstep import TickResult
from sim_vehicle.records import TRUTH

PROCESSES = ("sim_vehicle", "onboard", "offboard")


class LockstepLog:
    """Observer of a lockstep flight that logs each tick. A context manager."""

    def __init__(self, folder: Path, config: FlightConfig) -> None:
        metadata = {"seed": str(config.seed), "scenario": config.scenario, "clock": "lockstep"}
        attachment = {"config.yaml": config.to_yaml().encode()}
        self._logs = {
            process: FlightLogWriter(folder / f"{process}.mcap", process, metadata, attachment, threaded=False)
            for process in PROCESSES
        }

    def __call__(self, result: TickResult) -> None:
        """Logs one tick."""
        self._logs["sim_vehicle"].write(TRUTH, result.now_ns, result.truth)
        self._logs["onboard"].write(TICK, result.now_ns, result.onboard.tick)
        if result.offboard is not None:
            for record_type, when_ns, vector in result.offboard.records:
                self._logs["offboard"].write(record_type, when_ns, vector)

    def event(self, process: str, time_ns: int, text: str) -> None:
        """Logs something that happened, in words."""
        self._logs[process].event(time_ns, text)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for log in self._logs.values():
            log.close()
