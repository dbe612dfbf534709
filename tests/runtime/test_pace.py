"""The pace keeper with an artificial clock."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from runtime.pace import DurationStatistics, PaceKeeper

PERIOD = 5_000_000


class World:
    """A clock that advances only when it is read and in sleep."""

    def __init__(self, oversleep_ns: int = 0, look_ns: int = 50) -> None:
        self.now = 1_000_000_000
        self.oversleep_ns = oversleep_ns
        self.look_ns = look_ns

    def clock(self) -> int:
        self.now += self.look_ns
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += round(seconds * 1e9) + self.oversleep_ns


def keeper(world: World, spin_ns: int = 0) -> PaceKeeper:
    return PaceKeeper(PERIOD, spin_ns, world.now + PERIOD, world.clock, world.sleep)


def test_late_waking_does_not_shift_later_ticks() -> None:
    world = World(oversleep_ns=200_000)
    pace = keeper(world)
    start = world.now + PERIOD
    for tick in range(200):
        woken = pace.wait()
        world.now += 700_000  # the step
        assert 0 <= woken - (start + tick * PERIOD) < 300_000
    assert pace.missed == 0
    assert pace.ticks == 200


def test_a_stall_is_skipped_and_counted() -> None:
    world = World()
    pace = keeper(world)
    first = pace.wait()
    world.now = first + 40_000_000
    woken = [pace.wait() for _ in range(4)]
    assert pace.missed == 7
    gaps = [later - earlier for earlier, later in itertools.pairwise(woken)]
    assert all(gap > PERIOD - 1_000_000 for gap in gaps), "no burst of ticks after the stall"


def test_a_stall_in_the_sleep_is_known_to_the_tick_after_it() -> None:
    world = World()
    pace = keeper(world)
    pace.wait()
    assert pace.skipped == 0
    world.oversleep_ns = 42_000_000
    late = pace.wait()
    assert (pace.skipped, pace.missed) == (8, 8)
    world.oversleep_ns = 0
    assert 2_900_000 < pace.wait() - late < 3_100_000
    assert (pace.skipped, pace.missed) == (0, 8)


def test_spin_wakes_at_the_deadline_although_sleep_is_late() -> None:
    world = World(oversleep_ns=250_000)
    pace = keeper(world, spin_ns=300_000)
    for _ in range(20):
        pace.wait()
        assert pace.lateness_ns <= 2 * world.look_ns


def test_after_waking_early_the_keeper_waits_for_the_deadline() -> None:
    world = World(oversleep_ns=-100_000)
    pace = keeper(world)
    for _ in range(5):
        pace.wait()
        assert pace.lateness_ns >= 0


@given(st.lists(st.integers(0, 30_000_000), min_size=1, max_size=60))
def test_every_deadline_is_run_or_counted(stalls: list[int]) -> None:
    world = World()
    start = world.now + PERIOD
    pace = keeper(world)
    for stall in stalls:
        woken = pace.wait()
        assert pace.ticks + pace.missed == (woken - pace.lateness_ns - start) // PERIOD + 1
        assert 0 <= pace.lateness_ns < PERIOD
        world.now += stall


def test_quantiles_are_exact_to_a_microsecond() -> None:
    statistics = DurationStatistics()
    for microseconds in range(1, 101):
        statistics.add(microseconds * 1000 - 500)
    statistics.add(90_000_000)
    assert statistics.summary() == {"p50": 51.0, "p99": 100.0, "max": 90000.0}


def test_quantiles_without_durations_are_zero() -> None:
    assert DurationStatistics().summary() == {"p50": 0.0, "p99": 0.0, "max": 0.0}
