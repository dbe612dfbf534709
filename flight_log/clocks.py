"""Maps the times in all logs of a flight to one clock; the processes may have run on different machines.

Logs that name the same clock need no mapping. Otherwise the times are mapped with the offset of offboard's clock that
onboard measured in flight (time sync, `CLOCK_OFFSET`). Without such records the wall clocks at start are used, and the
reader reports it.
"""

from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Final

import numpy as np
from numpy.typing import NDArray

from flight_log.log_file import LogFile, VectorTopic
from flight_log.schema import CLOCK_OFFSET

Times = NDArray[np.int64]
ClockMap = Callable[[Times], Times]
"""Maps the times in a log to the common time base, ns."""

BASE_PROCESS: Final = "onboard"
MEASURED_PROCESS: Final = "offboard"
SLACK_NS: Final = 5_000_000_000
"""A measurement belongs to a log of offboard if it falls within the times of the log, with this tolerance."""


def base_of(logs: Sequence[LogFile]) -> LogFile:
    """The log whose clock is the common time base: that of onboard if there is one."""
    return next((log for log in logs if log.process == BASE_PROCESS), logs[0])


def clock_map(log: LogFile, logs: Sequence[LogFile]) -> tuple[ClockMap, str]:
    """The map of `log`'s times to the common time base, and a warning; "" if the offset of the clocks is known."""
    base = base_of(logs)
    if log.metadata.get("clock") == base.metadata.get("clock"):
        return _same, ""
    measured = _offsets(log, [each for each in logs if each.metadata.get("clock") == base.metadata.get("clock")])
    if measured is not None:
        times, offset = measured
        return (lambda own: own - _interpolate(own, times + offset, offset)), ""
    try:
        shift = _wall_minus_monotonic_ns(log) - _wall_minus_monotonic_ns(base)
    except (KeyError, ValueError):
        return (
            _same,
            f"{log.process}: its clock is not that of {base.process} and no offset is known; times are not aligned",
        )
    return (lambda own: own + shift), f"{log.process}: aligned with {base.process} by the wall clocks only"


def _same(own: Times) -> Times:
    return own


def _offsets(log: LogFile, bases: Sequence[LogFile]) -> tuple[Times, Times] | None:
    """Base times and offsets, ns, that were measured while `log` was written; None if there are none.

    Measurements of other times do not count: an offboard process restarted on another machine has another clock.
    """
    span = _span(log)
    topics = [base.vectors[CLOCK_OFFSET.topic] for base in bases if CLOCK_OFFSET.topic in base.vectors]
    if log.process != MEASURED_PROCESS or span is None or not topics:
        return None
    times = np.concatenate([topic.times_ns for topic in topics])
    offset = np.rint(np.concatenate([topic.values[:, 0] for topic in topics])).astype(np.int64)
    inside = (times + offset >= span[0] - SLACK_NS) & (times + offset <= span[1] + SLACK_NS)
    return (times[inside], offset[inside]) if inside.any() else None


def _span(log: LogFile) -> tuple[int, int] | None:
    """First and last time in a log, in its own clock; None if it is empty."""
    topics: list[VectorTopic] = [topic for topic in log.vectors.values() if len(topic.times_ns)]
    times = [int(time_ns) for topic in topics for time_ns in (topic.times_ns.min(), topic.times_ns.max())]
    times += [time_ns for texts in log.texts.values() for time_ns, _ in texts]
    return (min(times), max(times)) if times else None


def _interpolate(at: Times, times: Times, offset: Times) -> Times:
    """Offset, ns, at the given times: linear between measurements, constant outside."""
    start = times[0]
    base = offset[0]
    moved = np.interp((at - start).astype(float), (times - start).astype(float), (offset - base).astype(float))
    shift: Times = np.rint(moved).astype(np.int64) + base
    return shift


def _wall_minus_monotonic_ns(log: LogFile) -> int:
    started = datetime.fromisoformat(log.metadata["started_utc"])
    return int(started.timestamp() * 1e9) - int(log.metadata["started_monotonic_ns"])
