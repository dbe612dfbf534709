import hashlib
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from configs.loader import ConfigError, fill
from configs.parts import part_names, read_part
from protocol.endpoint import Endpoint
from protocol.messages import TimeSyncRequest
from sim_vehicle.link.radio import (
    DELIVERY,
    DIRECTIONS,
    IN_FLIGHT_MAX,
    Direction,
    DirectionConfig,
    Radio,
    RadioConfig,
    RecordedDeliveries,
    delivery_from_vector,
    delivery_vector,
)
from sim_vehicle.process import SimProcess

MS = 1_000_000
S = 1_000_000_000
PROFILES = part_names("radio")
Arrivals = list[tuple[int, bytes]]


def shipped(profile: str) -> RadioConfig:
    return fill(RadioConfig, read_part("radio", profile), profile)


def radio_of(seed: int = 0, direction: Direction = "down", **settings: Any) -> Radio:
    config = fill(RadioConfig, {direction: settings}, "test")
    return Radio(config, np.random.default_rng(seed))


def carry(
    radio: Radio, count: int, period_ns: int = 10 * MS, size: int = 100, direction: Direction = "down"
) -> Arrivals:
    """Send numbered datagrams periodically, in steps of 1 ms. Returns the arrivals: (time, datagram)."""
    arrivals: Arrivals = []
    now = sent = 0
    while sent < count or radio.next_due_ns(direction) is not None:
        while sent < count and sent * period_ns <= now:
            radio.send(direction, sent.to_bytes(4, "little") + bytes(size - 4), now)
            sent += 1
        arrivals += [(now, datagram) for datagram in radio.due(direction, now)]
        now += MS
    return arrivals


def numbers(arrivals: Arrivals) -> list[int]:
    return [int.from_bytes(datagram[:4], "little") for _, datagram in arrivals]


def test_a_perfect_radio_changes_nothing() -> None:
    arrivals = carry(radio_of(), 100)
    assert numbers(arrivals) == list(range(100))
    assert [time for time, _ in arrivals] == [i * 10 * MS for i in range(100)]


@pytest.mark.parametrize("profile", PROFILES)
def test_every_profile_loads_and_counts_add_up(profile: str) -> None:
    radio = Radio(shipped(profile), np.random.default_rng(1))
    for direction in DIRECTIONS:
        arrivals = carry(radio, 300, direction=direction)
        counts = radio.counts(direction)
        assert counts.sent == 300 == counts.delivered + counts.lost
        assert len(arrivals) == counts.delivered + counts.duplicated
        assert sum(counts.outcomes.values()) == 300


@pytest.mark.parametrize(
    ("profile", "loss", "burst"),
    [("good", 0.002 / 0.502, 2.0), ("medium", 0.01 / 0.21, 5.0), ("bad", 0.05 / 0.2, 1 / 0.15)],
)
def test_gilbert_elliott_has_the_stated_loss_and_bursts(profile: str, loss: float, burst: float) -> None:
    config = shipped(profile)
    radio = Radio(config, np.random.default_rng(2))
    for index in range(40_000):
        radio.send("up", b"x" * 50, index * 10 * MS)
        radio.due("up", index * 10 * MS)
    lost = np.array([delivery.outcome == "burst" for delivery in radio.deliveries["up"]])
    starts = np.count_nonzero(lost[1:] & ~lost[:-1])
    assert lost.mean() == pytest.approx(loss, rel=0.15)
    assert lost.sum() / starts == pytest.approx(burst, rel=0.15)


def test_independent_loss() -> None:
    radio = radio_of(loss=0.3)
    carry(radio, 5000, MS)
    assert radio.counts("down").lost == pytest.approx(1500, abs=130)


def test_delay_jitter_and_tail() -> None:
    radio = radio_of(delay_s=0.008, jitter_s=0.005, tail_probability=0.01)
    carry(radio, 4000, 300 * MS)  # far apart, so that none delays another
    delays_s = np.array([delivery.delay_ns for delivery in radio.deliveries["down"]]) * 1e-9
    assert delays_s.min() == pytest.approx(0.008, abs=1e-4)
    assert np.median(delays_s) == pytest.approx(0.008 + 0.005 * np.log(2), rel=0.05)
    assert 0.005 < (delays_s > 0.047).mean() < 0.02
    assert delays_s.max() < 0.2


def test_jitter_keeps_the_order_and_reordering_breaks_it() -> None:
    assert numbers(carry(radio_of(jitter_s=0.05), 500, MS)) == list(range(500))
    order = numbers(carry(radio_of(reordering=0.1), 500, 5 * MS))
    assert sorted(order) == list(range(500))
    overtaken = sum(b < a for a, b in pairwise(order))
    assert 20 < overtaken < 80


def test_the_rate_and_the_queue_are_limited() -> None:
    radio = radio_of(rate_bit_s=80_000.0, queue_bytes=2000)  # 10 kB/s: a datagram of 100 bytes takes 10 ms
    arrivals = carry(radio, 500, 5 * MS)
    counts = radio.counts("down")
    assert counts.outcomes["queue"] == counts.lost == pytest.approx(240, abs=10)
    assert np.diff([time for time, _ in arrivals]).min() >= 9 * MS
    assert arrivals[-1][0] - 499 * 5 * MS <= 200 * MS


def test_blackouts_count_from_the_start_of_the_flight() -> None:
    windows = [{"start_s": 0.1, "end_s": 0.2}, {"start_s": 0.4}]
    config = fill(RadioConfig, {"down": {"blackouts": windows}}, "test")
    radio = Radio(config, np.random.default_rng(0), start_ns=0)
    assert numbers(carry(radio, 60)) == [*range(10), *range(20, 40)]
    late = radio_of(blackouts=windows)
    late.send("down", b"x", 1000 * S)
    assert late.due("down", 1000 * S), "without start_ns the first datagram starts the flight"


def test_duplication() -> None:
    radio = radio_of(duplication=0.2)
    order = numbers(carry(radio, 1000))
    assert radio.counts("down").duplicated == len(order) - 1000 == pytest.approx(200, abs=50)
    assert radio.counts("down").delivered == 1000


def test_corruption_flips_one_bit_and_every_endpoint_rejects_it() -> None:
    radio = radio_of(corruption=0.1, direction="up")
    onboard, offboard = Endpoint("onboard", 1, b"k" * 32), Endpoint("offboard", 1, b"k" * 32)
    for index in range(500):
        radio.send("up", onboard.encode(TimeSyncRequest(index), index * 10 * MS), index * 10 * MS)
        for datagram in radio.due("up", index * 10 * MS):
            offboard.decode(datagram, index * 10 * MS)
    corrupted = radio.counts("up").corrupted
    assert 25 < corrupted < 80
    assert offboard.statistics.rejected.total() == corrupted
    assert offboard.statistics.received == 500 - corrupted
    assert offboard.statistics.lost == corrupted


def trace(radio: Radio) -> str:
    arrivals = [carry(radio, 1000, direction=direction) for direction in DIRECTIONS]
    return hashlib.sha256(repr(arrivals).encode()).hexdigest()


@pytest.mark.parametrize("profile", ["bad", "bluetooth"])
def test_the_same_seed_gives_the_same_deliveries(profile: str) -> None:
    config = shipped(profile)
    one, same, other = (trace(Radio(config, np.random.default_rng(seed))) for seed in (5, 5, 6))
    assert one == same != other


def test_the_directions_have_their_own_draws() -> None:
    config = shipped("bad")
    alone, both = Radio(config, np.random.default_rng(5)), Radio(config, np.random.default_rng(5))
    down = carry(alone, 500)
    carry(both, 300, direction="up")
    assert carry(both, 500) == down
    assert [f.outcome for f in both.deliveries["up"][:300]] != [f.outcome for f in both.deliveries["down"][:300]]


def test_more_loss_loses_the_same_datagrams_and_more() -> None:
    few, many = (radio_of(loss=loss, jitter_s=0.01, duplication=0.1) for loss in (0.1, 0.3))
    arrived = [set(numbers(carry(radio, 500))) for radio in (few, many)]
    assert arrived[1] < arrived[0]


def test_recorded_deliveries_fly_again() -> None:
    config = shipped("bad")
    first = Radio(config, np.random.default_rng(7))
    arrivals = {direction: carry(first, 800, direction=direction) for direction in DIRECTIONS}
    again = Radio(RadioConfig(), np.random.default_rng(99), recorded=first.deliveries)
    assert {direction: carry(again, 800, direction=direction) for direction in DIRECTIONS} == arrivals
    assert again.deliveries == first.deliveries
    assert again.counts("up") == first.counts("up")
    again.send("up", b"one more", 100 * S)
    assert again.due("up", 100 * S) == [b"one more"], "after the recording the configuration decides"


def test_a_flight_that_sends_more_or_less_gets_the_same_silences() -> None:
    window = {"blackouts": [{"start_s": 1.0, "end_s": 2.0}], "delay_s": 0.01}
    first = radio_of(**window)
    carry(first, 400, 10 * MS)
    for period_ns, count in ((3 * MS, 1300), (10 * MS + 7, 400), (50 * MS, 80)):
        again = Radio(RadioConfig(), np.random.default_rng(1), recorded=first.deliveries)
        carry(again, count, period_ns)
        for delivery in again.deliveries["down"]:
            clear_of_the_edges = min(abs(delivery.sent_ns - edge) for edge in (S, 2 * S)) > RecordedDeliveries.SLACK_NS
            if clear_of_the_edges:
                assert (delivery.outcome == "blackout") == (S < delivery.sent_ns < 2 * S), delivery
        recording = again.recording("down")
        assert recording.used + recording.repeated == sum(
            delivery.sent_ns <= 3990 * MS + RecordedDeliveries.SLACK_NS for delivery in again.deliveries["down"]
        )
        assert recording.used + recording.skipped <= 400
    assert recording.skipped > 300
    assert again.deliveries["down"][0].delay_ns == 10 * MS


def test_a_recorded_bit_flips_in_a_shorter_datagram_too() -> None:
    first = radio_of(corruption=1.0)
    first.send("down", bytes(1000), 0)
    again = Radio(RadioConfig(), np.random.default_rng(1), recorded=first.deliveries)
    again.send("down", bytes(10), 0)
    assert again.due("down", 0) != [bytes(10)]


def test_a_delivery_survives_the_flight_log() -> None:
    radio = Radio(shipped("bad"), np.random.default_rng(7))
    for direction in DIRECTIONS:
        carry(radio, 300, direction=direction)
        for delivery in radio.deliveries[direction]:
            vector = delivery_vector(direction, delivery)
            assert vector.shape == (len(DELIVERY.fields),)
            assert delivery_from_vector(vector) == (direction, delivery)


def test_the_datagrams_on_their_way_are_limited() -> None:
    radio = radio_of(delay_s=10.0)
    for _ in range(IN_FLIGHT_MAX + 5):
        radio.send("down", b"x", 0)
    assert radio.counts("down").outcomes["queue"] == 5


def test_next_due() -> None:
    radio = radio_of(delay_s=0.01)
    assert radio.next_due_ns("down") is None
    radio.send("down", b"x", 5)
    assert radio.next_due_ns("down") == 5 + 10 * MS
    assert radio.next_due_ns("up") is None
    assert radio.due("down", 4 + 10 * MS) == []
    assert radio.due("down", 5 + 10 * MS) == [b"x"]


@pytest.mark.parametrize(
    ("settings", "path"),
    [
        ({"loss": 1.5}, "up.loss"),
        ({"los": 0.1}, "up.los"),
        ({"blackouts": [{"start_s": 3.0, "end_s": 2.0}]}, "up.blackouts.0"),
        ({"tail_min_s": 0.2, "tail_max_s": 0.1}, "up"),
        ({"burst": {"leave": 0.0}}, "up.burst.leave"),
        ({"rate_bit_s": 0.0}, "up.rate_bit_s"),
    ],
)
def test_bad_settings_are_named(settings: dict[str, Any], path: str) -> None:
    with pytest.raises(ConfigError, match=path):
        fill(RadioConfig, {"up": settings}, "test")


def test_defaults_are_perfect() -> None:
    assert shipped("perfect") == RadioConfig()
    assert DirectionConfig() == RadioConfig().down


def test_the_process_forgets_what_it_has_logged() -> None:
    """It would grow by 1.3 MB a minute."""
    radio, logged = radio_of(), []
    process = SimProcess.__new__(SimProcess)
    process._radio = radio
    process._log = SimpleNamespace(
        write=lambda kind, at_ns, vector: logged.append((kind, delivery_from_vector(vector)))
    )
    sent = 0
    for second in range(3):
        for number in range(50):
            radio.send("up" if number % 3 else "down", bytes(20), second * S + number * MS)
        sent += 50
        process._record_deliveries(second * S)
        assert len(logged) == sent
        assert radio.deliveries == {"up": [], "down": []}
        assert sum(radio.counts(direction).sent for direction in DIRECTIONS) == sent
    assert {kind for kind, _ in logged} == {DELIVERY}
