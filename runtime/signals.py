"""How a process is asked to end, and how it never outlives the one that started it."""

import ctypes
import os
import signal
from collections.abc import Callable
from types import FrameType
from typing import Final

_PR_SET_PDEATHSIG: Final = 1


class StopRequest:
    """Counts SIGINT and SIGTERM: the first asks for a clean end, the second for an end at once."""

    def __init__(self) -> None:
        self.count = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.count += 1


def die_with_parent() -> Callable[[], None]:
    """A function for `subprocess.Popen(preexec_fn=)`: the child is killed when this thread's process is gone."""
    parent = os.getpid()
    prctl = ctypes.CDLL(None, use_errno=True).prctl  # looked up now: after fork only the call is left to do

    def in_child() -> None:
        prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
        if os.getppid() != parent:  # it died before the kernel knew
            os._exit(1)

    return in_child
