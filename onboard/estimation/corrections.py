"""Gated corrections of the filter, with counts, scores, and the announcement of jumps.

A correction that moves the position by more than `jump_threshold_m` is a jump: `position_reset_count` of the state
increases, and `position_jump` and `yaw_jump` hold its size, so a controller can shift its references with it.
"""

import math
from collections import Counter, defaultdict
from typing import Final

from onboard.estimation.config import EstimatorConfig
from onboard.estimation.error_state_filter import ErrorStateFilter
from onboard.estimation.state import VehicleState
from protocol.conventions import Array
from protocol.geometry import Vector3

REFUSED_MIN: Final = 8
"""Fewer refusals in a row are outliers, however long they last."""
EVENTS_MAX: Final = 64


class Corrections:
    """Applies corrections to the filter and keeps their records."""

    def __init__(self, config: EstimatorConfig, error_state: ErrorStateFilter, state: VehicleState) -> None:
        self._filter = error_state
        self._state = state
        self._jump_threshold_m = config.jump_threshold_m
        self._recovery_ns = int(config.recovery_s * 1e9)
        self._refused: dict[str, tuple[int, int]] = {}
        self._events: list[tuple[int, str]] = []
        self.counts: Counter[str] = Counter()
        """Aids used and refused: "pose_used", "flow_refused" and so on."""
        self.scores: dict[str, float] = {}
        """Newest score of each aid: the squared innovation over its variance."""
        self.in_flight = False
        """Whether scores count in `mean_scores`."""
        self._score_sums: defaultdict[str, float] = defaultdict(float)
        self._score_counts: Counter[str] = Counter()

    @property
    def mean_scores(self) -> dict[str, float]:
        """Mean NIS of each aid in flight: accepted scores per dimension, 1 where the sigmas fit."""
        return {aid: total / self._score_counts[aid] for aid, total in self._score_sums.items()}

    def note_score(self, aid: str, score: float, gate: float, dimension: int = 1) -> None:
        """Store the score of an aid; within its gate and in flight it counts in `mean_scores`."""
        self.scores[aid] = score
        if self.in_flight and score <= gate:
            self._score_sums[aid] += score / dimension
            self._score_counts[aid] += 1

    def take_events(self) -> list[tuple[int, str]]:
        """Return and clear the events since the last call: (time_ns, text)."""
        events, self._events = self._events, []
        return events

    def correct(self, aid: str, h: Array | int, innovation: float, variance: float, gate: float, now_ns: int) -> bool:
        """A gated scalar correction. True if it was used."""
        before = self._filter.position
        score = self._filter.correct_scalar(h, innovation, variance, gate)
        self.note_score(aid, score, gate)
        if score > gate:
            self.counts[aid + "_refused"] += 1
            since_ns, count = self._refused.get(aid, (now_ns, 0))
            self._refused[aid] = (since_ns, count + 1)
            return False
        self.counts[aid + "_used"] += 1
        self._refused.pop(aid, None)
        self.announce_jump(before, aid, now_ns)
        return True

    def refused_long(self, aid: str, now_ns: int) -> bool:
        """Whether an aid has been refused so long that the state is probably wrong."""
        since_ns, count = self._refused.get(aid, (now_ns, 0))
        return now_ns - since_ns > self._recovery_ns and count >= REFUSED_MIN

    def widen(self, aid: str, start: int, size: int, sigma: float, now_ns: int) -> None:
        """Increase the uncertainty of some errors, so that the aid will be accepted."""
        self._filter.inflate(start, sigma, size)
        self._refused.pop(aid, None)
        self.counts[aid + "_recovered"] += 1
        self.report(now_ns, f"{aid} refused for long: uncertainty increased, it will be accepted")

    def announce_jump(self, before: Vector3, cause: str, now_ns: int, yaw: float = 0.0, always: bool = False) -> None:
        """Announce the correction since the position `before` if it is a jump, or `always`. `yaw`: its turn, rad."""
        after = self._filter.position
        length_m = math.dist(after, before)
        if not always and length_m < self._jump_threshold_m:
            return
        state = self._state
        state.position_reset_count += 1
        state.position_jump[:] = (after[0] - before[0], after[1] - before[1], after[2] - before[2])
        state.yaw_jump = math.remainder(yaw, 2.0 * math.pi)
        state.position[:] = after
        self.report(now_ns, f"position estimate jumped {length_m:.2f} m ({cause})")

    def report(self, now_ns: int, text: str) -> None:
        """Add an event."""
        if len(self._events) < EVENTS_MAX:
            self._events.append((now_ns, text))
