"""Signals: requests to stop, and the end of a child process when its parent ends."""

import ctypes
import os
import signal
from collections.abc import Callable
from types import FrameType
from typing import Final

_PR_SET_PDEATHSIG: Final = 1


class StopRequest:
    """Counts SIGINT and SIGTERM: the first requests a clean stop, the second an immediate one."""

    def __init__(self) -> None:
        self.count = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.count += 1


def die_with_parent() -> Callable[[], None]:
    """A function for `subprocess.Popen(preexec_fn=)`: the kernel kills the child when its parent has ended."""
    parent = os.getpid()
    prctl = ctypes.CDLL(None, use_errno=True).prctl  # looked up before the fork: the child only calls it
    return lambda: _die_with(parent, prctl)


def die_with(parent: int) -> None:
    """Let the kernel kill this process when its parent, which has this number, has ended."""
    _die_with(parent, ctypes.CDLL(None, use_errno=True).prctl)


def _die_with(parent: int, prctl: Callable[..., int]) -> None:
    prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:  # the parent ended before the call
        os._exit(1)
