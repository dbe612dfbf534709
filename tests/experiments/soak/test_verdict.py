"""What a soak is judged by, on made-up records."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from experiments.flights.scenario import resolve
from experiments.soak.crew import Done
from experiments.soak.schedule import Action, Disruption
from experiments.soak.soak import SoakRun
from experiments.soak.verdict import STOPPED, SWAPPED, UNEXPLAINED, WAITED, TickGap, Verdict, gaps_of, memories
from experiments.soak.watch import Life, Waits
from flight_log.reader import Table

MS = 1_000_000
TICK_NS = 5 * MS


def waits(waited_ms: dict[int, float]) -> Waits:
    """Samples every 50 ms of a process that waited so long, by the number of the sample."""
    found = Waits(0)
    found._times_ns = [number * 50 * MS for number in range(400)]
    found._waited_ns = np.cumsum([round(waited_ms.get(number, 0.0) * MS) for number in range(400)]).tolist()
    return found


def run(done: list[Done], waited: Waits, lives: list[Life] | None = None) -> SoakRun:
    values: dict[str, Any] = dict.fromkeys(SoakRun.__dataclass_fields__)
    return SoakRun(
        **values | {"config": resolve("hover"), "begin_ns": 0, "done": done, "waits": waited, "lives": lives or []}
    )


def loop(*late_ms: tuple[int, float], computing: bool = True) -> Table:
    """Ticks of 20 s; the tick of a number comes so much too late, and the ticks in between are missed."""
    times, missed, count, now = [], [], 0, 0
    late = dict(late_ms)
    for number in range(3000):
        gap = round(late.get(number, 0.0) * MS) // TICK_NS
        count += gap
        now += (1 + gap) * TICK_NS
        times.append(now)
        missed.append(float(count))
    names = ("lateness", "tick", "missed", "computed", "own", "faults")
    took = np.array([2000.0 + 1e3 * late.get(number + 1, 0.0) for number in range(3000)])
    computed = took if computing else np.full(3000, 2000.0)
    values = np.column_stack([np.zeros(3000), took, missed, computed, computed - 500.0, np.full(3000, 3.0)])
    return Table("onboard/loop", names, dict.fromkeys(names, ""), np.array(times), values)


def missed_ticks(soak: SoakRun, ticks: Table, swaps_ns: Sequence[int] = ()) -> dict[str, int]:
    return verdict(gaps=gaps_of(soak, ticks, swaps_ns)).missed


def stop_at(begin_ms: float, end_ms: float) -> Done:
    disruption = Disruption(begin_ms * 1e-3, Action.STOP, "onboard", (end_ms - begin_ms) * 1e-3)
    return Done(disruption, round(begin_ms * MS), round(end_ms * MS))


def test_each_missed_tick_has_its_explanation() -> None:
    ticks = loop((200, 40.0), (1000, 10.0), (2000, 15.0))
    at_ms = [float(ticks.time_ns[number]) / MS for number in (200, 1000, 2000)]
    waited = waits({int(at_ms[1] // 50) + 1: 9.0})
    found = missed_ticks(run([stop_at(at_ms[0] - 42.0, at_ms[0] - 3.0)], waited), ticks)
    assert found == {STOPPED: 8, WAITED: 2, UNEXPLAINED: 3}


def test_a_tick_that_computes_long_is_the_swaps_or_nobodys() -> None:
    ticks = loop((200, 10.0))
    assert missed_ticks(run([], waits({})), ticks, [int(ticks.time_ns[199])]) == {SWAPPED: 2}
    assert missed_ticks(run([], waits({})), ticks, [int(ticks.time_ns[150])]) == {UNEXPLAINED: 2}


def test_a_gap_says_what_the_loops_own_thread_computed_and_how_often_a_page_was_missing() -> None:
    [gap] = gaps_of(run([], waits({})), loop((200, 10.0)))
    assert (gap.own_ms, gap.page_faults) == (pytest.approx(2.0 + 10.0 + 2.0 - 1.0), 6)


def test_a_stop_of_another_process_explains_nothing() -> None:
    ticks = loop((200, 40.0))
    at_ms = float(ticks.time_ns[200]) / MS
    other = Done(Disruption(0.0, Action.STOP, "offboard", 1.0), round((at_ms - 42.0) * MS), round(at_ms * MS))
    assert missed_ticks(run([other], waits({})), ticks) == {UNEXPLAINED: 8}


def test_a_tick_in_which_nothing_was_computed_had_no_processor() -> None:
    assert missed_ticks(run([], waits({})), loop((200, 20.0), computing=False)) == {WAITED: 4}
    assert missed_ticks(run([], waits({})), loop((200, 20.0))) == {UNEXPLAINED: 4}


def test_a_short_wait_does_not_explain_a_long_gap() -> None:
    ticks = loop((1000, 30.0))
    number = int(float(ticks.time_ns[1000]) / MS // 50) + 1
    assert missed_ticks(run([], waits({number: 5.0})), ticks) == {UNEXPLAINED: 6}
    assert missed_ticks(run([], waits({number: 20.0})), ticks) == {WAITED: 6}


def life(slope_mb_min: float, seconds: float, name: str = "sim") -> Life:
    times = np.arange(0.0, seconds, 2.0)
    rng = np.random.default_rng(1)
    warm = 40.0 * np.exp(-times / 10.0)
    memory = 180.0 - warm + slope_mb_min * times / 60.0 + rng.normal(0.0, 0.05, len(times))
    return Life(name, 1, times.tolist(), memory.tolist())


def test_the_slope_is_that_of_the_longest_life_without_its_start() -> None:
    [found] = memories(run([], waits({}), [life(9.0, 30.0), life(1.3, 600.0)]))
    assert (found.process, found.lives) == ("sim", 2)
    assert found.slope_mb_min == pytest.approx(1.3, abs=0.05)
    [flat] = memories(run([], waits({}), [life(0.0, 600.0)]))
    assert abs(flat.slope_mb_min) < 0.05


def test_a_short_life_has_no_slope() -> None:
    [found] = memories(run([], waits({}), [life(5.0, 100.0)]))
    assert math.isnan(found.slope_mb_min)


def verdict(**values: Any) -> Verdict:
    good: dict[str, Any] = {
        "minutes": 30.0,
        "alive": True,
        "why_lost": "",
        "ticks": 100,
        "gaps": [TickGap(1.0, 5, 30.0, 25.0, 5.0, 0, WAITED)],
        "faults": [],
        "escapes": {"onboard": 0},
        "memory": memories(run([], waits({}), [life(0.0, 600.0)])),
        "modes_s": {},
        "position_rmse_m": 0.01,
        "versions": 3,
    }
    return Verdict(**good | values)


def test_every_promise_can_fail() -> None:
    assert verdict().failures == []
    for values, words in (
        ({"alive": False, "why_lost": "hit the floor"}, "vehicle lost: hit the floor"),
        ({"gaps": [TickGap(1.0, 2, 15.0, 0.0, 14.0, 3, UNEXPLAINED)]}, "2 missed ticks without explanation"),
        ({"escapes": {"onboard": 0, "offboard": 1}}, "1 escapes in offboard"),
        ({"memory": memories(run([], waits({}), [life(1.3, 600.0)]))}, "memory of sim grows by 1.3"),
        ({"faults": ["onboard: the flight log stopped"]}, "the flight log stopped"),
    ):
        [failure] = verdict(**values).failures
        assert words in failure
