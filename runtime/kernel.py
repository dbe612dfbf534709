"""Settings of the kernel and the interpreter that make a process wake on time.

The lateness of a sleep to an absolute deadline, at p99: 400 us without settings, 110 us with a timer slack of 1 ns and
without deep sleep of the processor, 18 us with a short busy wait before the deadline as well. docs/realtime.md has the
lateness of the 200 Hz loop.
"""

import ctypes
import gc
import os
import resource
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_PR_SET_TIMERSLACK: Final = 29
_MCL_CURRENT_FUTURE_ONFAULT: Final = 1 | 2 | 4
"""Locks pages when they are first touched; locking all at once would cost tens of megabytes of thread stacks."""
THREAD_SWITCH_S: Final = 0.0005
"""Time after which a waiting thread requests the interpreter; the default, 5 ms, is a whole tick."""


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True, slots=True)
class Grant:
    """The outcome of one request to the kernel."""

    name: str
    granted: bool
    detail: str
    """The value granted, or the reason for the refusal."""

    def __str__(self) -> str:
        return f"{self.name} {self.detail}" if self.granted else f"{self.name} NOT granted ({self.detail})"


def prepare_interpreter() -> None:
    """Stop garbage collection and shorten the thread switch interval. Call after all long-lived objects are built."""
    sys.setswitchinterval(THREAD_SWITCH_S)
    gc.collect()
    gc.freeze()
    gc.disable()


def request_realtime(priority: int) -> list[Grant]:
    """Request every setting that makes the process wake on time; returns which were granted.

    Parameters
    ----------
    priority: SCHED_FIFO priority of the calling thread, 1 to 99; 0 keeps the ordinary scheduler. The threads that run
        already, such as that of the log, get one less: if an ordinary process preempted such a thread while it holds
        the interpreter, the loop would wait.
    """
    grants = [_timer_slack(), _cpu_latency(), _locked_memory()]
    if priority > 0:
        grants.append(_fifo(priority))
    return grants


def resident_mb(process: int | str = "self") -> float:
    """Resident memory of a process, MB (10^6 bytes). Raises OSError if there is none of this number."""
    pages = int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def own_use() -> tuple[int, int]:
    """What the calling thread has used so far: ns of a processor, and page faults (of the process, where not Linux)."""
    used = resource.getrusage(getattr(resource, "RUSAGE_THREAD", resource.RUSAGE_SELF))
    return time.thread_time_ns(), used.ru_minflt + used.ru_majflt


def _timer_slack() -> Grant:
    failed = ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    return Grant("timer slack", not failed, "1 ns" if not failed else _reason())


_held_files: list[int] = []
"""The setting of /dev/cpu_dma_latency holds as long as the file is open."""


def _cpu_latency() -> Grant:
    try:
        descriptor = os.open("/dev/cpu_dma_latency", os.O_WRONLY)
        os.write(descriptor, (0).to_bytes(4, sys.byteorder))
    except OSError as error:
        return Grant("cpu latency", False, error.strerror or str(error))
    _held_files.append(descriptor)
    return Grant("cpu latency", True, "0 us")


def _locked_memory() -> Grant:
    failed = ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT_FUTURE_ONFAULT)
    return Grant("locked memory", not failed, "on" if not failed else f"{_reason()}; `ulimit -l unlimited` allows it")


def _fifo(priority: int) -> Grant:
    loop = threading.get_native_id()
    try:
        for thread in (int(name) for name in os.listdir("/proc/self/task")):
            own = priority if thread == loop else max(1, priority - 1)
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(own))
    except OSError as error:
        return Grant("real-time priority", False, f"{error.strerror}; `ulimit -r` of {priority} or more allows it")
    return Grant("real-time priority", True, f"FIFO {priority}")


def _reason() -> str:
    return os.strerror(ctypes.get_errno())
