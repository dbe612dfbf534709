"""The background thread: trains and writes files, so that the relay of poses waits for neither."""

import gc
import os
import queue
import threading
import traceback
from collections.abc import Callable
from typing import Final

from offboard.training.job import TrainingResult
from runtime.files import no_space

NICENESS: Final = 10

Task = Callable[[], TrainingResult | None]
Results = queue.SimpleQueue[TrainingResult | str]
"""Results of training, and tracebacks of tasks that raised."""


class BackgroundThread:
    """Runs training jobs and file writes one after the other, at low priority, for all vehicles.

    Each vehicle has at most one training job queued (its core ensures that), so the vehicles take turns.
    """

    def __init__(self) -> None:
        self._tasks: queue.SimpleQueue[tuple[Task, Results]] = queue.SimpleQueue()
        threading.Thread(target=self._run, name="trainer", daemon=True).start()

    def submit(self, task: Task, results: Results) -> None:
        """Queue a task; what it returns (unless None), or its traceback, is put into `results`."""
        self._tasks.put((task, results))

    def _run(self) -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        first = True
        while True:
            task, results = self._tasks.get()
            try:
                result = task()
                if result is not None:
                    results.put(result)
            except OSError as error:
                results.put(f"no file can be written: {error.strerror}" if no_space(error) else traceback.format_exc())
            except Exception:
                results.put(traceback.format_exc())
            if first:
                first = False
                gc.freeze()  # later collections skip torch's own objects
