"""The instruments of `dmrac bench`."""

from importlib.util import find_spec
from pathlib import Path

import pytest

from experiments.flights.scenario import Choices, resolve
from experiments.timing.learning_speed import admission_ms, fleet_round_ms, training_round_ms
from experiments.timing.step_timing import (
    BLOCKS,
    LOG,
    STEP,
    Replay,
    Stopwatch,
    quantiles_us,
    record_flight,
    run_hot,
    run_paced,
)
from experiments.timing.vehicle_speed import vehicle_speeds
from flight_log.reader import open_flight
from flight_log.writer import FlightLogWriter
from onboard.record.datagram_log import TOPIC, Entry, read_tick

CONFIG = resolve("hover", Choices(duration_s=5.0))


def test_a_replayed_flight_sends_the_same_motor_commands() -> None:
    flown: list[list[bytes]] = []
    recording = record_flight(CONFIG, 3.0, lambda output: flown.append(list(output.to_vehicle)))
    replay = Replay(CONFIG, recording, blocks=True)
    again: list[list[bytes]] = []
    replay.observe = lambda output: again.append(list(output.to_vehicle))
    run_hot(replay)
    assert len(flown) == len(again) == 600
    assert flown == again
    assert len({frames[0] for frames in flown}) > 300, "a flight, not a vehicle at rest"
    for name in (STEP, *(name for name, _ in BLOCKS)):
        p50, p99, highest = replay.watch.quantiles_us(name)
        assert 0.0 <= p50 <= p99 <= highest
    blocks_us = sum(replay.watch.quantiles_us(name)[0] for name, _ in BLOCKS)
    assert blocks_us < replay.watch.quantiles_us(STEP)[0]


def test_what_is_logged_of_a_tick_is_timed_and_complete(tmp_path: Path) -> None:
    recording = record_flight(CONFIG, 1.0)
    with FlightLogWriter(tmp_path / "onboard.mcap", "onboard", threaded=False) as log:
        replay = Replay(CONFIG, recording, False, log)
        run_hot(replay)
    p50, p99, _ = replay.watch.quantiles_us(LOG)
    assert 0.0 < p50 <= p99
    flight = open_flight(tmp_path)
    assert [len(flight[topic]) for topic in ("onboard/tick", "onboard/loop")] == [200, 200]
    datagram_log = [read_tick(data) for _, data in flight.messages(TOPIC)]
    assert [tick.of(Entry.FROM_VEHICLE) for tick in datagram_log] == recording.vehicle
    assert all(tick.of(Entry.TO_VEHICLE) for tick in datagram_log[1:])


def test_the_paced_loop_and_the_bare_loop_take_turns() -> None:
    replay = Replay(CONFIG, record_flight(CONFIG, 0.5), blocks=False)
    ours, bare = run_paced(replay, 2_000_000, 0)
    assert len(ours) == 100
    assert bare
    assert min(*ours, *bare) >= 0


def test_a_stopwatch_adds_up_the_calls_of_a_tick() -> None:
    class Owner:
        def work(self, amount: int) -> int:
            return 2 * amount

    owner, watch = Owner(), Stopwatch()
    watch.wrap(owner, "work", "work")
    assert [owner.work(3), owner.work(4)] == [6, 8]
    watch.end_tick()
    watch.end_tick()
    assert watch.ticks["work"][0] > 0
    assert watch.ticks["work"][1] == 0


def test_quantiles_are_in_microseconds() -> None:
    assert quantiles_us(range(0, 101_000, 1000)) == (50.0, 99.0, 100.0)


def test_the_vehicle_is_timed_bare_whole_and_in_a_batch() -> None:
    rates = vehicle_speeds(runs=1)
    over_others = ["the" for name in ("mujoco", "rotorpy") if find_spec(name) is not None]
    assert [name.split()[0] for name in rates] == ["rigid", "with", *over_others, "in"]
    assert all(0.0 < rate < float("inf") for rate in rates.values())


def test_learning_is_timed_on_a_flights_own_samples() -> None:
    assert training_round_ms(resolve("hover", Choices("dmrac")), runs=1) > 0.0
    assert fleet_round_ms(resolve("hover", Choices("dmrac")), vehicles=2, runs=1) > 0.0
    assert admission_ms(samples=2) > 0.0
    with pytest.raises(RuntimeError, match="hover with pid: nothing to train on"):
        training_round_ms(resolve("hover", Choices("pid", None, None, ("offboard.trainer.minimum_samples=100000",))))
