"""Rounds of training of a lockstep flight in a process of its own, so that the flight goes on while torch works.

The flight stays the same to the bit: a round gets copies of its samples, and its result counts from its modelled time
on, whenever it was really there. If it is not there by then, the flight waits.
"""

import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from experiments.flights.scenario import FlightConfig
from offboard.training.job import TrainingJob, TrainingResult
from runtime.kernel import cores
from sim_vehicle.lockstep import Training, train_at_once


class TrainingWorker:
    """One process that trains. A context manager; call it to start a round."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, context, initializer=_prepare)

    def __call__(self, job: Any) -> Callable[[], TrainingResult]:
        """Start a round; what is returned waits for its result.

        A fleet's job trains in this process, because it changes the fleet. So does one whose worker died.
        """
        if not isinstance(job, TrainingJob):
            return train_at_once(job)
        try:
            with _without_main():
                future = self._pool.submit(job.run)
        except BrokenProcessPool:
            return train_at_once(job)
        return lambda: _result(future, job)

    def __enter__(self) -> "TrainingWorker":
        return self

    def __exit__(self, *exception: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)


def _result(future: "Future[TrainingResult]", job: TrainingJob) -> TrainingResult:
    try:
        return future.result()
    except BrokenProcessPool:
        return job.run()


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


def _prepare() -> None:
    """Leave Ctrl-C to the parent, and load torch before the first round."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import offboard.training.round  # noqa: F401


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
