"""Campaign workers for tests: every job is done at once, in this process."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from experiments.campaigns.flight_jobs import FlightJob
from experiments.campaigns.worker import FlightResult


class InlineWorkers:
    """An executor that does a job at once, in this process."""

    count = 2

    def __init__(self, fly: Callable[[FlightJob], FlightResult]) -> None:
        self.fly = fly
        self.flown: list[str] = []
        self.opened = 0

    def open(self) -> Executor:
        self.opened += 1
        workers = self

        class Inline(Executor):
            def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> "Future[Any]":
                future: Future[Any] = Future()
                try:
                    future.set_result(workers.fly(*args))
                    workers.flown.append(args[0].key)
                except Exception as error:
                    future.set_exception(error)
                return future

        return Inline()

    def close(self) -> None:
        pass

    def abandon(self) -> None:
        pass

    def require_alive(self) -> None:
        pass
