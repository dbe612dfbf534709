"""One time base for the logs of one flight, whose processes may have stood on different machines.

Logs that name the same clock need nothing. Otherwise the offset of offboard's clock that onboard measured in flight
(time sync, `CLOCK_OFFSET`) maps the one to the other; without such records the wall clocks at start must do, and the
reader says so.
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
"""From a log's own times to the common ones, ns."""

MEASURER: Final = "onboard"
MEASURED: Final = "offboard"
SLACK_NS: Final = 5_000_000_000
"""A measurement belongs to a log of offboard when it falls within the log's own times, give or take this."""


def base_of(logs: Sequence[LogFile]) -> LogFile:
    """The log whose clock is the common time base: onboard's where there is one."""
    return next((log for log in logs if log.process == MEASURER), logs[0])


def clock_map(log: LogFile, logs: Sequence[LogFile]) -> tuple[ClockMap, str]:
    """How `log`'s times become common ones, and a warning ("" when the clocks are one or their offset was measured)."""
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
            f"{log.process}: its clock is not {base.process}'s and no offset is known; times stand as they are",
        )
    return (lambda own: own + shift), f"{log.process}: aligned with {base.process} by the wall clocks only"


def _same(own: Times) -> Times:
    return own


def _offsets(log: LogFile, bases: Sequence[LogFile]) -> tuple[Times, Times] | None:
    """Base times, ns, and offsets, ns, measured while `log` was written; None where there are none.

    Only those: an offboard process that came back on another machine has another clock.
    """
    span = _span(log)
    topics = [base.vectors[CLOCK_OFFSET.topic] for base in bases if CLOCK_OFFSET.topic in base.vectors]
    if log.process != MEASURED or span is None or not topics:
        return None
    times = np.concatenate([topic.times_ns for topic in topics])
    offset = np.rint(np.concatenate([topic.values[:, 0] for topic in topics])).astype(np.int64)
    inside = (times + offset >= span[0] - SLACK_NS) & (times + offset <= span[1] + SLACK_NS)
    return (times[inside], offset[inside]) if inside.any() else None


def _span(log: LogFile) -> tuple[int, int] | None:
    """First and last time in a log, in its own clock; None when it is empty."""
    topics: list[VectorTopic] = [topic for topic in log.vectors.values() if len(topic.times_ns)]
    times = [int(time_ns) for topic in topics for time_ns in (topic.times_ns.min(), topic.times_ns.max())]
    times += [time_ns for texts in log.texts.values() for time_ns, _ in texts]
    return (min(times), max(times)) if times else None


def _interpolate(at: Times, times: Times, offset: Times) -> Times:
    """Offset at the given times, linear between measurements and constant outside, ns."""
    start = times[0]
    base = offset[0]
    moved = np.interp((at - start).astype(float), (times - start).astype(float), (offset - base).astype(float))
    shift: Times = np.rint(moved).astype(np.int64) + base
    return shift


def _wall_minus_monotonic_ns(log: LogFile) -> int:
    started = datetime.fromisoformat(log.metadata["started_utc"])
    return int(started.timestamp() * 1e9) - int(log.metadata["started_monotonic_ns"])
