import numpy as np
import pytest

from onboard.sampling.sampler import SampleQueue, SamplerConfig
from protocol.endpoint import Endpoint
from protocol.messages import SampleBatch
from protocol.signals import SIGNAL_COUNT
from tests.offboard.flights import offboard_config

TICK = 5_000_000
S = 1_000_000_000
ZEROS = np.zeros((2, 3))


def fly(
    queue: SampleQueue,
    ticks: int,
    version: int = 0,
    missed: frozenset[int] = frozenset(),
    first: int = 0,
    loss: float = 0.0,
) -> list[SampleBatch]:
    """Tick t carries the number t in all its values."""
    batches: list[SampleBatch] = []
    for tick in range(first, first + ticks):
        if tick not in missed:
            queue.push(tick * TICK, np.full(SIGNAL_COUNT, float(tick)), ZEROS + tick, ZEROS - tick)
            batches += queue.poll(tick * TICK, version, loss)
    return batches


def indices(batches: list[SampleBatch]) -> list[int]:
    return [batch.first_index + i for batch in batches for i in range(len(batch.signals))]


def test_samples_leave_at_their_rate_with_the_mean_of_their_period() -> None:
    batches = fly(SampleQueue(SamplerConfig()), 401)
    assert indices(batches) == list(range(100))
    first, second = batches[:2]
    assert (first.time_ns, first.period_ns, second.time_ns) == (0, 4 * TICK, 20 * TICK)
    assert second.signals[0, 0] == 20
    assert second.delivered[0, 0, 0] == np.mean([17, 18, 19, 20])
    assert second.adaptive[1, 1, 2] == -24


def test_missed_ticks_show_as_a_gap_of_the_index() -> None:
    batches = fly(SampleQueue(SamplerConfig()), 200, missed=frozenset(range(41, 61)))
    gap = [batch.first_index for batch in batches]
    assert indices(batches)[:10] == list(range(10))
    assert set(range(50)) - set(indices(batches)) == {11, 12, 13, 14}, "the ticks 44 to 56 never were"
    assert 15 in gap, "a batch never spans a gap"


def test_one_missed_tick_moves_a_sample_not_its_number() -> None:
    batches = fly(SampleQueue(SamplerConfig(batch_samples=1)), 40, missed=frozenset({8}))
    assert indices(batches) == list(range(10))
    assert batches[2].time_ns == 9 * TICK
    assert batches[3].time_ns == 12 * TICK


def test_a_batch_is_of_one_version() -> None:
    queue = SampleQueue(SamplerConfig())
    batches = fly(queue, 30, version=1) + fly(queue, 50, version=2, first=30)
    versions = {index: batch.feature_version for batch in batches for index in indices([batch])}
    assert all(versions[index] == (1 if index < 8 else 2) for index in versions)
    assert indices(batches) == list(range(len(versions)))


@pytest.mark.parametrize("loss", [0.0, 0.9])
@pytest.mark.parametrize("budget", [1500.0, 4000.0, 6000.0])
def test_the_budget_is_never_exceeded_and_the_newest_are_kept(budget: float, loss: float) -> None:
    queue = SampleQueue(SamplerConfig(budget_bytes_s=budget))
    endpoint = Endpoint("onboard", 1, None)
    sent, batches = 0.0, []
    for tick in range(4000):
        now = tick * TICK
        queue.push(now, np.full(SIGNAL_COUNT, float(tick)), ZEROS, ZEROS)
        for batch in queue.poll(now, 0, loss):
            batches.append(batch)
            sent += len(endpoint.encode(batch, now)) + 28
            assert now - batch.time_ns < 0.5 * S, "what is sent is fresh"
    assert 0.8 * budget * 20 < sent <= budget * 20 + 2400
    got = list(dict.fromkeys(indices(batches)))
    assert got == sorted(got)
    assert queue.dropped == queue.taken - len(got) - len(queue._waiting) > 0
    assert got[-1] > 970


def test_status_and_time_sync_count_against_the_budget() -> None:
    queue = SampleQueue(SamplerConfig(budget_bytes_s=3000.0))
    endpoint = Endpoint("onboard", 1, None)
    sent = 0.0
    for tick in range(4000):
        now = tick * TICK
        if tick % 20 == 0:  # something of 100 bytes, ten times a second, also before there are samples
            queue.charge(100, now)
            sent += 100 + 28
        if tick < 1000:
            continue
        queue.push(now, np.full(SIGNAL_COUNT, float(tick)), ZEROS, ZEROS)
        sent += sum(len(endpoint.encode(batch, now)) + 28 for batch in queue.poll(now, 0))
    assert sent - 5 * 1280 <= 3000.0 * 15 + 2400
    assert sent - 5 * 1280 > 0.8 * 3000.0 * 15, "what was not used before is not held against them"


def test_a_wide_budget_drops_nothing() -> None:
    queue = SampleQueue(SamplerConfig())
    fly(queue, 4000)
    assert queue.dropped == 0
    assert queue.taken == 1000


def test_what_was_pushed_may_be_overwritten() -> None:
    queue = SampleQueue(SamplerConfig(batch_samples=1))
    signals, delivered, adaptive = np.ones(SIGNAL_COUNT), np.ones((2, 3)), np.ones((2, 3))
    queue.push(0, signals, delivered, adaptive)
    signals[:], delivered[:], adaptive[:] = 9.0, 9.0, 9.0
    [batch] = queue.poll(0, 0)
    assert batch.signals.max() == batch.delivered.max() == batch.adaptive.max() == 1.0


def test_full_rate() -> None:
    queue = SampleQueue(SamplerConfig(rate_hz=200.0, batch_samples=8, budget_bytes_s=60_000.0))
    assert indices(fly(queue, 80)) == list(range(80))


def test_no_mean_spans_a_pause_and_no_sample_waits_through_one() -> None:
    queue = SampleQueue(SamplerConfig())
    batches = fly(queue, 12)  # samples 0, 1, 2 and a part of the fourth
    assert batches == []
    for tick in range(12, 60):
        batches += queue.poll(tick * TICK, 0)
    assert indices(batches) == [0, 1, 2]
    batches = fly(queue, 30, first=62)
    assert indices(batches)[:5] == [15, 16, 17, 18, 19]
    assert batches[0].delivered[0, 0, 0] == 62


def test_a_lossy_link_gets_every_batch_a_second_time_and_later() -> None:
    queue = SampleQueue(SamplerConfig(repeat_after_s=0.1))
    sent: dict[int, list[int]] = {}
    for tick in range(420):
        if tick < 400:
            queue.push(tick * TICK, np.full(SIGNAL_COUNT, float(tick)), ZEROS, ZEROS)
        for batch in queue.poll(tick * TICK, 0, 0.3):
            assert batch.signals[0, 0] == 4 * batch.first_index
            sent.setdefault(batch.first_index, []).append(tick * TICK)
    assert list(sent) == list(range(0, 100, 5))
    assert all(second - first == S // 10 for first, second in sent.values())
    assert queue.repeated == queue.taken == 100


@pytest.mark.parametrize(("loss", "from_loss"), [(0.19, 0.2), (0.9, 1.0), (1.0, 1.0)])
def test_a_good_link_gets_every_batch_once(loss: float, from_loss: float) -> None:
    queue = SampleQueue(SamplerConfig(repeat_from_loss=from_loss))
    assert indices(fly(queue, 400, loss=loss)) == list(range(100))
    assert queue.repeated == 0


@pytest.mark.parametrize("loss", [0.0, 0.5])
def test_repeats_take_what_the_budget_leaves_and_no_more(loss: float) -> None:
    """A new sample never waits for a repeated one."""
    queue, first_ns = SampleQueue(SamplerConfig(budget_bytes_s=10_000.0)), {}
    for tick in range(4000):
        queue.push(tick * TICK, np.full(SIGNAL_COUNT, float(tick)), ZEROS, ZEROS)
        for batch in queue.poll(tick * TICK, 0, loss):
            first_ns.setdefault(batch.first_index, tick * TICK)
    assert list(first_ns) == list(range(0, 1000, 5))
    assert all(sent_ns == (4 * (index + 4)) * TICK for index, sent_ns in first_ns.items()), "with its last sample"
    assert queue.dropped == 0
    assert (0.2 < queue.repeated / queue.taken < 0.6) == (loss > 0)


def test_the_second_time_comes_while_the_labels_still_wait() -> None:
    assert SamplerConfig().repeat_after_s + 0.1 <= offboard_config().labels.reorder_s, "0.1 s is the link's"
