"""Rounds of training of a lockstep flight in a process of its own, so that the flight goes on while torch works.

The flight stays the same to the bit: a round gets copies of its samples, and its result counts from its modelled time
on, whenever it was really there. If it is not there by then, the flight waits.
"""

import contextlib
import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

from experiments.flights.scenario import FlightConfig
from offboard.training.job import TrainingJob, TrainingResult
from runtime.kernel import cores
from sim_vehicle.lockstep import Training, train_at_once

if TYPE_CHECKING:
    from multiprocessing.connection import Connection


class TrainingWorker:
    """One process that trains. A context manager; call it to start a round.

    Not a ProcessPoolExecutor: until Python 3.11.5 that waits for ever if its process dies while a job is being sent.
    """

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, self._theirs = context.Pipe()
        self.process: Final = context.Process(target=_train, args=(self._theirs,), daemon=True)
        """Started with the first round."""
        self._under_way: _Round | None = None

    def __call__(self, job: Any) -> Callable[[], TrainingResult]:
        """Start a round; what is returned waits for its result.

        A fleet's job trains in this process, because it changes the fleet. So does one whose worker died.
        """
        if not isinstance(job, TrainingJob):
            return train_at_once(job)
        if self.process.pid is None:
            self._start()
        self._receive()  # two large messages that meet would block each other
        one = _Round(job)
        try:
            self._pipe.send(job)
        except OSError:
            return train_at_once(job)
        self._under_way = one
        return lambda: self._result(one)

    def __enter__(self) -> "TrainingWorker":
        return self

    def __exit__(self, *exception: object) -> None:
        self._pipe.close()  # the process ends when it next looks
        self._theirs.close()
        if self.process.pid is not None:
            self.process.join()

    def _start(self) -> None:
        with _without_main():
            self.process.start()
        self._theirs.close()  # so that the end of the process ends the pipe

    def _result(self, one: "_Round") -> TrainingResult:
        if one is self._under_way:
            self._receive()
        if one.result is None:  # the process has ended
            return one.job.run()
        if isinstance(one.result, Exception):
            raise one.result
        return one.result

    def _receive(self) -> None:
        """Wait for the result of the round under way, if there is one."""
        one, self._under_way = self._under_way, None
        if one is not None:
            with contextlib.suppress(EOFError, OSError):
                one.result = self._pipe.recv()


@dataclass
class _Round:
    """A round that was sent to the process."""

    job: TrainingJob
    result: TrainingResult | Exception | None = None
    """None: not received, now or, if the process has ended, ever."""


@contextmanager
def _without_main() -> Iterator[None]:
    """A process that is started meanwhile does not run the program's main file again.

    A spawned process runs it otherwise, to find what it defines. A round of training needs nothing of it, and the file
    of a user who flies from Python may have no `if __name__ == "__main__":`.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _train(pipe: "Connection[Any, Any]") -> None:
    """The worker's process: run the jobs that come. Ctrl-C is left to the parent; torch is loaded before the first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import offboard.training.round  # noqa: F401

    with contextlib.suppress(EOFError, OSError):  # the parent has ended
        while True:
            job = pipe.recv()
            try:
                result = job.run()
            except Exception as fault:
                result = fault
            pipe.send(result)


@contextmanager
def training_for(config: FlightConfig | None) -> Iterator[Training[TrainingResult]]:
    """How a flight should train: in a worker where it learns and this machine has a second core, else at once.

    config: None for a flight without offboard.
    """
    learns = config is not None and config.offboard.experience.mode == "learn"
    if learns and cores() > 1:
        with TrainingWorker() as worker:
            yield worker
    else:
        yield train_at_once
