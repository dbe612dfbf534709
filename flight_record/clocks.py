"""One time base for the logs of one flight, whose processes may have stood on different machines.

Logs that name the same clock need nothing. Otherwise the offset that onboard and offboard measured in flight
(`<process>/clock_offset`, peer's clock minus own, from time sync) maps one clock to the other; without such records
the wall clocks at start must do, and the reader says so.
"""

from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Final

import numpy as np
from numpy.typing import NDArray

from flight_record.log_file import LogFile, VectorTopic
from flight_record.schema import RecordType

Times = NDArray[np.int64]
ClockMap = Callable[[Times], Times]
"""From a log's own times to the common ones, ns."""

PEERS: Final = {"onboard": "offboard", "offboard": "onboard"}
"""Whose clock a process' `clock_offset` records speak of."""


def clock_offset_record(process: str) -> RecordType:
    """The record type in which a process logs the measured offset of its peer's clock, now and then."""
    return RecordType(f"{process}/clock_offset", (("peer_minus_own_ns", "ns"),))


def base_of(logs: Sequence[LogFile]) -> LogFile:
    """The log whose clock is the common time base: onboard's where there is one."""
    return next((log for log in logs if log.process == "onboard"), logs[0])


def clock_map(log: LogFile, base: LogFile) -> tuple[ClockMap, str]:
    """How `log`'s times become `base`'s, and a warning ("" when the clocks are one or their offset was measured)."""
    if log.metadata.get("clock") == base.metadata.get("clock"):
        return _same, ""
    measured_by_base = _offsets(base, log.process)
    if measured_by_base is not None:
        times, offset = measured_by_base.times_ns, measured_by_base.values[:, 0]
        return (lambda own: own - _interpolate(own, times + offset.astype(np.int64), offset)), ""
    measured = _offsets(log, base.process)
    if measured is not None:
        times, offset = measured.times_ns, measured.values[:, 0]
        return (lambda own: own + _interpolate(own, times, offset)), ""
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


def _offsets(log: LogFile, peer: str) -> VectorTopic | None:
    topic = log.vectors.get(f"{log.process}/clock_offset")
    return topic if topic is not None and PEERS.get(log.process) == peer and len(topic.times_ns) else None


def _interpolate(at: Times, times: Times, offset: NDArray[np.float64]) -> Times:
    """Offset at the given times, linear between measurements and constant outside, ns."""
    start = times[0]
    base = offset[0]
    moved = np.interp((at - start).astype(float), (times - start).astype(float), offset - base)
    shift: Times = np.rint(moved).astype(np.int64) + np.int64(base)
    return shift


def _wall_minus_monotonic_ns(log: LogFile) -> int:
    started = datetime.fromisoformat(log.metadata["started_utc"])
    return int(started.timestamp() * 1e9) - int(log.metadata["started_monotonic_ns"])
