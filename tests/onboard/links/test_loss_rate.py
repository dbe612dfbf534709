import numpy as np

from onboard.links.loss_rate import SILENT_NS, WINDOW_NS, LossRate
from protocol.endpoint import Endpoint
from protocol.messages import Pose, TimeSyncReply, TimeSyncRequest
from protocol.statistics import LinkStatistics

PERIOD_NS = 10_000_000
SILENT_WINDOWS = SILENT_NS // WINDOW_NS


def watch(losses: list[float | None], seed: int = 0) -> list[float]:
    """The share at the end of each window, when the given share of 100 datagrams is lost; None: silence.

    Like an endpoint, count lost datagrams at the next arrival.
    """
    rng, rate, statistics, pending = np.random.default_rng(seed), LossRate(), LinkStatistics(), 0
    rate.step(statistics, 0)
    shares, now_ns = [], 0
    for loss in losses:
        for _ in range(WINDOW_NS // PERIOD_NS):
            now_ns += PERIOD_NS
            if loss is None or rng.random() < loss:
                pending += 1
            else:
                statistics.count_received(100, 0, now_ns)
                statistics.lost += pending
                pending = 0
            share = rate.step(statistics, now_ns)
        shares.append(share)
    return shares


def test_steady_loss_is_known_after_two_windows() -> None:
    shares = watch([0.5] * 10)
    assert shares[0] == 0.0
    assert all(0.3 < share < 0.6 for share in shares[1:])


def test_a_silence_is_not_a_loss() -> None:
    assert max(watch([0.0] * 5 + [None] * 3 + [0.0] * 5)) == 0.0


def test_the_share_falls_when_the_loss_ends() -> None:
    shares = watch([0.6] * 5 + [0.0] * 3)
    assert shares[4] > 0.4
    assert shares[5:] == [0.0, 0.0, 0.0]


def test_little_loss_stays_below_a_fifth() -> None:
    assert max(share for seed in range(20) for share in watch([0.1] * 60, seed)) < 0.2


def test_late_datagrams_give_no_negative_loss() -> None:
    rate, statistics = LossRate(), LinkStatistics(received=50, lost=50)
    rate.step(statistics, 0)
    statistics.received, statistics.lost = 200, 0
    assert rate.step(statistics, WINDOW_NS) == 0.0


def test_drops_of_a_full_queue_do_not_count() -> None:
    rate, statistics = LossRate(), LinkStatistics(delay_mean_ns=80e6)
    for window in range(4):
        statistics.received, statistics.lost = 70 * window, 30 * window
        assert rate.step(statistics, window * WINDOW_NS) == 0.0
    statistics.delay_mean_ns = 20e6
    for window in range(4, 6):
        statistics.received, statistics.lost = 70 * window, 30 * window
        share = rate.step(statistics, window * WINDOW_NS)
    assert share == 0.3


def test_after_a_long_silence_the_share_is_0() -> None:
    shares = watch([0.5] * 4 + [None] * (SILENT_WINDOWS + 2) + [0.5] * 2)
    assert min(shares[2 : 3 + SILENT_WINDOWS]) > 0.3
    assert shares[4 + SILENT_WINDOWS] == 0.0
    assert shares[-2] == 0.0, "two windows again, and in the first the silence counts as well"
    assert shares[-1] > 0.3


def shares_over_a_real_link(delay_ns: int, sessions: list[int], loss: float = 0.4, seconds: int = 5) -> list[float]:
    """Poses at 100 Hz from sessions of the peer in turn; the share at the end of each second."""
    rng, onboard, rate = np.random.default_rng(4), Endpoint("onboard", 1, None), LossRate()
    pose = Pose(0, np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32))
    shares, now_ns = [], 0
    for session in sessions:
        peer = Endpoint("offboard", session, None)
        peer.decode(onboard.encode(TimeSyncRequest(now_ns), now_ns), now_ns + delay_ns)
        reply = TimeSyncReply(now_ns, now_ns + delay_ns, now_ns + delay_ns)
        onboard.decode(peer.encode(reply, now_ns + delay_ns), now_ns + 2 * delay_ns)
        for _ in range(seconds):
            for _ in range(WINDOW_NS // PERIOD_NS):
                datagram = peer.encode(pose, now_ns)
                if rng.random() >= loss:
                    onboard.decode(datagram, now_ns + delay_ns)
                now_ns += PERIOD_NS
                share = rate.step(onboard.statistics, now_ns)
            shares.append(share)
    return shares


def test_it_works_with_a_real_endpoint_and_after_a_restart_of_the_peer() -> None:
    shares = shares_over_a_real_link(10_000_000, [5, 6])
    assert min(shares[2:]) > 0.25


def test_a_long_path_counts_as_a_queue() -> None:
    assert max(shares_over_a_real_link(60_000_000, [5])) == 0.0
