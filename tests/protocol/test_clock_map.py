"""Laws of the map of a sender's clock: stalls, lone wrong delays, drift."""

import itertools

import numpy as np
import pytest

from protocol.clock_map import AHEAD_NS, WINDOW_NS, ClockMap

MS = 1_000_000
STEP_NS = 5 * MS
OFFSET_NS = 77 * 10**9


class Sender:
    """Sends every 5 ms. Stamps are `drift` fast; the least delay is 1 ms. Keeps the error of each mapped time, ms."""

    def __init__(self, drift: float = 0.0) -> None:
        self.map = ClockMap()
        self.drift = drift
        self.true_ns = 10**12
        self.errors_ms: list[float] = []

    def send(self, delay_ms: float = 1.0, ahead_ms: float = 0.0) -> float:
        self.true_ns += STEP_NS
        stamp_ns = int((self.true_ns - 10**12) * (1.0 + self.drift) + ahead_ms * MS) - OFFSET_NS
        arrival_ns = self.true_ns + int(delay_ms * MS)
        self.map.add(arrival_ns - stamp_ns, arrival_ns)
        self.errors_ms.append((self.map.offset_ns + stamp_ns - self.true_ns) / MS - 1.0)
        assert self.map.to_ours(stamp_ns, arrival_ns) <= arrival_ns
        return self.errors_ms[-1]


def test_the_first_delay_starts_the_map() -> None:
    sender = Sender()
    assert not sender.map.known
    assert sender.send(4.0) == pytest.approx(3.0)
    assert sender.map.known


@pytest.mark.parametrize("stall_ms", [5, 20, 34, 50])
def test_a_stall_that_delays_datagrams_changes_nothing(stall_ms: int) -> None:
    sender = Sender()
    for _ in range(400):
        sender.send()
    for late_ms in range(stall_ms, 0, -5):
        assert sender.send(1.0 + late_ms) == 0.0
    assert sender.send() == 0.0


@pytest.mark.parametrize("stall_ms", [5, 20, 34, 50])
def test_wrong_early_arrivals_are_forgotten_within_two_seconds(stall_ms: int) -> None:
    sender = Sender()
    for _ in range(400):
        sender.send()
    worst_ms = min(sender.send(1.0 - stall_ms) for _ in range(3))
    assert worst_ms == -stall_ms, "the error is not larger than the stall"
    errors = [sender.send() for _ in range(WINDOW_NS // STEP_NS)]
    assert errors[-1] == 0.0


def test_a_longer_path_is_followed_within_two_seconds() -> None:
    sender = Sender()
    for _ in range(400):
        sender.send()
    errors = [sender.send(31.0) for _ in range(WINDOW_NS // STEP_NS)]
    assert errors[-1] == 30.0


@pytest.mark.parametrize("delay_ms", [-500.0, -30.0, 0.5, 30.0, 500.0])
def test_a_lone_early_or_late_datagram_changes_nothing(delay_ms: float) -> None:
    sender = Sender()
    for _ in range(100):
        sender.send()
    before_ns = sender.map.offset_ns
    sender.send(delay_ms)
    for _ in range(1000):
        assert sender.map.offset_ns == before_ns
        sender.send()


@pytest.mark.parametrize("drift", [100e-6, -100e-6])
def test_a_drift_of_100_ppm_costs_a_fraction_of_a_millisecond(drift: float) -> None:
    sender, rng = Sender(drift), np.random.default_rng(1)
    for _ in range(12_000):
        sender.send(1.0 + rng.exponential(1.0))
    settled = sender.errors_ms[400:]
    assert max(map(abs, settled)) < 0.35
    assert max(abs(b - a) for a, b in itertools.pairwise(settled)) < 0.2


def test_a_stamp_ahead_is_recognised() -> None:
    sender = Sender()
    assert not sender.map.is_ahead(-(10**15)), "there is no map yet"
    sender.send()
    assert sender.map.is_ahead(sender.map.offset_ns - AHEAD_NS - 1)
    assert not sender.map.is_ahead(sender.map.offset_ns - AHEAD_NS)


def test_reset_starts_again() -> None:
    sender = Sender()
    sender.send()
    sender.map.reset()
    assert not sender.map.known
    sender.send(9.0)
    assert sender.errors_ms[-1] == 8.0
