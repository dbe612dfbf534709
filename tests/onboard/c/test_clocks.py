"""Clocks of the link, replay window, loss share and 64-bit arithmetic: the C core against numpy's."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.links.loss_rate import LossRate
from protocol.clock import ClockEstimate, ForwardClock
from protocol.clock_map import ClockMap
from protocol.statistics import LinkStatistics
from tests.onboard.c.parity import SETTINGS

MS, S = 1_000_000, 1_000_000_000
INT64 = st.integers(-(2**63), 2**63 - 1) | st.sampled_from([-(2**63), -1, 0, 1, 2**62, 2**63 - 1])


def clipped(number: int) -> int:
    return min(max(number, -(2**63)), 2**63 - 1)


@SETTINGS
@given(pairs=st.lists(st.tuples(INT64, INT64), min_size=20, max_size=50))
def test_whole_numbers(core: Core, pairs: list[tuple[int, int]]) -> None:
    for a, b in pairs:
        assert core.whole_sum(a, b) == clipped(a + b)
        assert core.whole_difference(a, b) == clipped(a - b)
        assert core.whole_distance(a, b) == abs(a - b)
        assert core.whole_mean(a, b) == (a + b) // 2
        assert core.whole_min(a, b) == min(a, b)
        assert core.whole_max(a, b) == max(a, b)
        if b > 0:
            assert core.whole_floor_divide(a, b) == a // b


@SETTINGS
@given(steps=st.lists(st.integers(-5 * S, 5 * S), max_size=40))
def test_a_clock_that_never_goes_back(core: Core, steps: list[int]) -> None:
    ours, theirs, now_ns = core.ForwardClock(), ForwardClock(), 10**12
    core.forward_clock_init(ours)
    for step in steps:
        now_ns += step
        assert core.forward_clock_at(ours, now_ns) == theirs.at(now_ns)
        assert ours.jumps == theirs.jumps


def same_estimate(core: Core, ours: Any, theirs: ClockEstimate) -> None:
    known = core.clock_estimate_is_known(ours)
    assert known == (theirs.offset_ns is not None)
    if known:
        assert (ours.best.offset_ns, ours.best.round_trip_ns) == (theirs.offset_ns, theirs.round_trip_ns)
    assert list(ours.open[: ours.open_count]) == list(theirs._open)
    assert ours.jumps == theirs.jumps


@pytest.mark.parametrize("seed", range(8))
def test_the_clock_of_the_peer(core: Core, seed: int) -> None:
    """Exchanges with delays, jumps of the peer's clock, replies twice, too late, never, or without a request."""
    rng, ours, theirs = np.random.default_rng(seed), core.ClockEstimate(), ClockEstimate()
    core.clock_estimate_init(ours)
    now_ns, offset_ns, origins = S, int(rng.integers(-(2**62), 2**62)), [0]
    offset_ns = max(offset_ns, -S)  # the peer's clock is not negative
    answered = 0
    for _ in range(600):
        now_ns += int(rng.integers(0, 40 * MS))
        action = rng.random()
        if action < 0.5:
            core.clock_estimate_note_request(ours, now_ns)
            theirs.note_request(now_ns)
            origins.append(now_ns)
        elif action < 0.52:
            offset_ns += int(rng.integers(-200 * MS, 10 * S))
        elif action < 0.53:
            core.clock_estimate_restart(ours)
            theirs.restart()
        elif action < 0.56:
            now_ns += int(rng.integers(0, 3 * S))
        else:
            origin_ns = origins[-int(rng.integers(1, min(len(origins), 20) + 1))] + int(rng.random() < 0.05)
            there_ns = int(rng.integers(-MS, 30 * MS))
            receive_ns = max(origin_ns + there_ns + offset_ns, 0)
            transmit_ns = receive_ns + int(rng.integers(0, 5 * MS))
            expected = theirs.receive_reply(origin_ns, receive_ns, transmit_ns, now_ns)
            assert core.clock_estimate_receive_reply(ours, origin_ns, receive_ns, transmit_ns, now_ns) == expected
            answered += expected
        same_estimate(core, ours, theirs)
    assert answered > 50
    assert theirs.jumps > 1


@SETTINGS
@given(
    values=st.lists(
        st.tuples(*(st.integers(0, 2**63 - 1) | st.sampled_from([0, 1, S, 2**63 - 1]) for _ in range(3))),
        min_size=1,
        max_size=20,
    )
)
def test_any_times_in_a_reply(core: Core, values: list[tuple[int, int, int]]) -> None:
    """What a peer may write: all 63 bits, transmitted not before received."""
    ours, theirs = core.ClockEstimate(), ClockEstimate()
    core.clock_estimate_init(ours)
    for origin_ns, *pair in values:
        for now_ns in (origin_ns, min(origin_ns + 30 * MS, 2**63 - 1)):
            core.clock_estimate_note_request(ours, origin_ns)
            theirs.note_request(origin_ns)
            receive_ns, transmit_ns = sorted(pair)
            for at_ns in (transmit_ns, min(receive_ns + 5 * MS, 2**63 - 1)):
                reply = origin_ns, receive_ns, at_ns, now_ns
                assert core.clock_estimate_receive_reply(ours, *reply) == theirs.receive_reply(*reply)
                same_estimate(core, ours, theirs)


@pytest.mark.parametrize("seed", range(6))
def test_the_map_of_a_senders_clock(core: Core, seed: int) -> None:
    """Delays with queues, stalls, wrong early arrivals, pauses and arrivals out of order."""
    rng, ours, theirs = np.random.default_rng(seed), core.ClockMap(), ClockMap()
    core.clock_map_init(ours)
    arrival_ns, offset_ns = int(rng.integers(0, 10**12)), int(rng.integers(-(10**15), 10**15))
    for step in range(1500):
        arrival_ns += int(rng.choice([5 * MS, 5 * MS, 5 * MS, 0, -3 * MS, 300 * MS, 3 * S], p=_share()))
        delay_ns = (
            offset_ns + int(rng.exponential(2 * MS)) + int(rng.choice([0, -40 * MS, 80 * MS], p=[0.9, 0.02, 0.08]))
        )
        assert core.clock_map_is_ahead(ours, delay_ns) == theirs.is_ahead(delay_ns)
        core.clock_map_add(ours, delay_ns, arrival_ns)
        theirs.add(delay_ns, arrival_ns)
        assert (ours.known, ours.offset_ns) == (theirs.known, theirs.offset_ns)
        stamp_ns = arrival_ns - delay_ns
        assert core.clock_map_to_ours(ours, stamp_ns, arrival_ns) == theirs.to_ours(stamp_ns, arrival_ns)
        if step % 500 == 499:
            core.clock_map_init(ours)
            theirs.reset()


def _share() -> list[float]:
    return [0.3, 0.3, 0.3, 0.04, 0.04, 0.015, 0.005]


@pytest.mark.parametrize("delay_ms", [5, 49, 51, 80])
@pytest.mark.parametrize("seed", range(3))
def test_the_share_of_lost_datagrams(core: Core, delay_ms: int, seed: int) -> None:
    """With silences, late datagrams that reduce the count, and queues."""
    rng, ours, theirs = np.random.default_rng(seed), core.LossRate(), LossRate()
    core.loss_rate_init(ours)
    statistics, counts = core.LinkStatistics(), LinkStatistics()
    core.link_statistics_init(statistics)
    now_ns, shares = 0, set()
    for step in range(3000):
        now_ns += 10 * MS
        if (step // 700) % 2 == 0 and rng.random() < 0.6:
            delay_ns = int(rng.normal(delay_ms, 2.0) * MS)
            core.link_statistics_count_received(statistics, 100, delay_ns, now_ns)
            counts.count_received(100, delay_ns, now_ns)
            counts.lost = statistics.lost = max(0, counts.lost + int(rng.integers(-2, 4)))
        share = theirs.step(counts, now_ns)
        assert core.loss_rate_step(ours, statistics, now_ns) == share
        assert statistics.delay_mean_ns == counts.delay_mean_ns
        shares.add(share)
    assert len(shares) > (5 if delay_ms < 50 else 0)
