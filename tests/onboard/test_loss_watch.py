import numpy as np

from onboard.loss_watch import WINDOW_NS, LossWatch
from protocol.statistics import LinkStatistics

PERIOD_NS = 10_000_000


def watch(losses: list[float | None], seed: int = 0) -> list[float]:
    """The share said at the end of each window, in which the stated share of 100 datagrams is lost; None: silence.

    As an endpoint does, what was lost is counted when something comes again.
    """
    rng, watch, statistics, pending = np.random.default_rng(seed), LossWatch(), LinkStatistics(), 0
    watch.step(statistics, 0)
    said, now_ns = [], 0
    for loss in losses:
        for _ in range(WINDOW_NS // PERIOD_NS):
            now_ns += PERIOD_NS
            if loss is None or rng.random() < loss:
                pending += 1
            else:
                statistics.received += 1
                statistics.lost += pending
                pending = 0
            share = watch.step(statistics, now_ns)
        said.append(share)
    return said


def test_steady_loss_is_seen_after_two_windows() -> None:
    said = watch([0.5] * 10)
    assert said[0] == 0.0
    assert all(0.3 < share < 0.6 for share in said[1:])


def test_a_silence_is_no_loss() -> None:
    assert max(watch([0.0] * 5 + [None] * 3 + [0.0] * 5)) == 0.0


def test_loss_that_ends_is_forgotten() -> None:
    said = watch([0.6] * 5 + [0.0] * 3)
    assert said[4] > 0.4
    assert said[5:] == [0.0, 0.0, 0.0]


def test_little_loss_stays_below_a_fifth() -> None:
    assert max(share for seed in range(20) for share in watch([0.1] * 60, seed)) < 0.2


def test_what_comes_late_after_all_is_no_negative_loss() -> None:
    watch_, statistics = LossWatch(), LinkStatistics(received=50, lost=50)
    watch_.step(statistics, 0)
    statistics.received, statistics.lost = 200, 0
    assert watch_.step(statistics, WINDOW_NS) == 0.0


def test_what_a_full_queue_drops_does_not_count() -> None:
    watch_, statistics = LossWatch(), LinkStatistics(delay_mean_ns=80e6)
    for window in range(4):
        statistics.received, statistics.lost = 70 * window, 30 * window
        assert watch_.step(statistics, window * WINDOW_NS) == 0.0
    statistics.delay_mean_ns = 20e6
    for window in range(4, 6):
        statistics.received, statistics.lost = 70 * window, 30 * window
        share = watch_.step(statistics, window * WINDOW_NS)
    assert share == 0.3
