"""The one thread that trains and writes files, so that the relay of poses does not wait for either."""

import gc
import os
import queue
import threading
import traceback
from collections.abc import Callable
from typing import Final

from offboard.training.job import TrainingResult

NICENESS: Final = 10

Work = Callable[[], TrainingResult | None]
Results = queue.SimpleQueue[TrainingResult | str]
"""What came of work: results of training, and the reports of what failed."""


class BackgroundThread:
    """Runs training jobs and writes files one after the other, with a low claim on the processor.

    Each vehicle has at most one training job here (its core sees to that), so that all are trained for in turn.
    """

    def __init__(self) -> None:
        self._work_left: queue.SimpleQueue[tuple[Work, Results]] = queue.SimpleQueue()
        threading.Thread(target=self._work, name="trainer", daemon=True).start()

    def submit(self, work: Work, results: Results) -> None:
        """Queue something to be done, and where its result goes."""
        self._work_left.put((work, results))

    def _work(self) -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        first = True
        while True:
            work, results = self._work_left.get()
            try:
                result = work()
                if result is not None:
                    results.put(result)
            except Exception:
                results.put(traceback.format_exc())
            if first:
                first = False
                gc.freeze()  # torch's own objects: later collections need not look at them
