"""Where flights are flown: processes of this machine, or a Dask cluster. Both are `concurrent.futures` executors."""

import multiprocessing
import os
import signal
from concurrent.futures import Executor, ProcessPoolExecutor
from typing import Any, Final, Protocol

from configs.loader import ConfigError
from experiments.campaigns.worker import one_thread_each
from runtime.errors import PlainError
from runtime.signals import die_with

TRIES: Final = 2
"""Number of times that a flight is tried if its worker dies."""
FLIGHTS_PER_PROCESS: Final = 200
"""After so many flights a worker process is replaced, so that memory stays flat even if a library leaks."""


class WorkersLostError(PlainError):
    """The workers are gone, and with them the flights in the air; what was reported is stored."""


class Workers(Protocol):
    """Workers that fly."""

    count: int

    def open(self) -> Executor:
        """Return a new executor; called again if one breaks."""

    def close(self) -> None:
        """End all executors."""

    def abandon(self) -> None:
        """Give up the flights in the air: their rows will not be received."""

    def require_alive(self) -> None:
        """Raise WorkersLostError if no flight will ever come back."""


class LocalPool:
    """Spawned processes of this machine, one thread each.

    recycle: whether processes are replaced after FLIGHTS_PER_PROCESS flights. CPython 3.11's pool waits for ever when
    that happens while it has idle processes, so a caller that waits for a few flights at a time must not ask for it.
    """

    def __init__(self, count: int, recycle: bool = True) -> None:
        self.count = count
        self._flights_each = FLIGHTS_PER_PROCESS if recycle else None
        self._executor: ProcessPoolExecutor | None = None

    def open(self) -> Executor:
        """Return a new pool."""
        one_thread_each()
        context = multiprocessing.get_context("spawn")
        self._executor = ProcessPoolExecutor(
            self.count, context, _begin_worker, (os.getpid(),), max_tasks_per_child=self._flights_each
        )
        return self._executor

    def close(self) -> None:
        """Drop waiting flights and wait for those in the air."""
        if self._executor is not None:
            self._executor.shutdown(wait=True, cancel_futures=True)

    def require_alive(self) -> None:
        """Do nothing: a dead process breaks its executor, which fails its flights."""

    def abandon(self) -> None:
        """Kill the processes."""
        if self._executor is not None:
            for process in multiprocessing.active_children():
                process.kill()


def _begin_worker(parent: int) -> None:
    """Leave Ctrl-C to the parent, which ends the pool in order; end with it, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with(parent)


class DaskWorkers:
    """Workers of a Dask cluster, at the address of its scheduler."""

    def __init__(self, address: str) -> None:
        """Raise ConfigError if `distributed` is not installed or no scheduler answers."""
        try:
            from distributed import Client
        except ImportError:
            raise ConfigError("--scheduler needs the extra `cluster`: pip install 'async-dmrac[cluster]'") from None
        try:
            self._client: Any = Client(address, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise ConfigError(f"--scheduler {address}: no scheduler answers: {error}") from None
        self.count = max(sum(self._client.nthreads().values()), 1)

    def open(self) -> Executor:
        """Return the cluster as an executor; with pure=False the same job twice is two flights."""
        executor: Executor = self._client.get_executor(pure=False, retries=TRIES - 1)
        return executor

    def close(self) -> None:
        """Disconnect from the cluster."""
        self._client.close()

    def require_alive(self) -> None:
        """Raise WorkersLostError if the scheduler is gone; the client gives up some seconds after it has lost it."""
        if self._client.status in ("closing", "closed"):
            raise WorkersLostError("the scheduler of the cluster is gone; all rows are stored, continue with --resume")

    def abandon(self) -> None:
        """Disconnect from the cluster, which drops the flights that nobody waits for."""
        self._client.close()
