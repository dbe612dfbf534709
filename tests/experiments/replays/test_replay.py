"""A recorded lockstep flight, replayed with its deliveries and checked bit for bit."""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from async_dmrac.command_line import main
from configs.loader import ConfigError
from experiments.flights.flight_summary import write_summary
from experiments.flights.lockstep_flight import build_offboard, fly_lockstep
from experiments.flights.lockstep_log import LockstepLog
from experiments.flights.logged_flight import lockstep_summary
from experiments.flights.scenario import Choices, resolve
from experiments.replays.recorded_flight import RecordedFlight, read_recorded
from experiments.replays.replay import figures, figures_of_recorded, refly, verdict, with_choices
from experiments.replays.replay_check import CheckResult, check_flight, check_log
from offboard.training.network import InputPlan, feature_set, initial_state
from onboard.record.datagram_log import HEAD, TOPIC, DatagramLogWriter, Entry, read_tick
from onboard.record.tick import OFFSET, TICK

SETTINGS = (
    "onboard.guidance.trajectory.settle_s=0.0",
    "onboard.guidance.land_after_s=60.0",
    "radio.up.loss=0.1",
    "radio.down.blackouts=[{start_s: 1.5, end_s: 2.0}]",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recorded flight of six and a half seconds that trains, and receives the features it starts from."""
    folder = tmp_path_factory.mktemp("flight")
    config = resolve("figure8_wind", Choices("dmrac", 11, 6.5, SETTINGS))
    network = config.features.trained
    features = feature_set(initial_state(network, np.random.default_rng(3)), InputPlan.of(network), 1, 0, 100)
    experience = tmp_path_factory.mktemp("experience") / "start.npz"
    teacher = build_offboard(config, 1).learner
    teacher.warm_start(features)
    teacher.issue(features)
    experience.write_bytes(teacher.experience())
    config = config.model_copy(update={"experience": str(experience)})
    with LockstepLog(folder, config) as log:
        outcome = fly_lockstep(config, (log,))
    write_summary(folder, lockstep_summary(config, outcome))
    experience.unlink()  # the record must work without it
    return folder


@pytest.fixture(scope="module")
def flight(folder: Path) -> RecordedFlight:
    return read_recorded(folder)


def test_what_was_recorded(flight: RecordedFlight) -> None:
    assert flight.lockstep
    assert flight.with_offboard
    figures = figures_of_recorded(flight)
    assert figures.survived
    assert figures.feature_version >= 1
    assert flight.experience is not None
    assert figures.link["down"].longest_gap_s == pytest.approx(0.54, abs=0.05)
    assert figures.link["up"].lost_share > 0.05
    sent = {
        direction: counts["sent"] for direction, counts in flight.summary["link"].items() if direction != "rejected"
    }
    assert sent == {direction: len(deliveries) for direction, deliveries in flight.deliveries.items()}


def test_the_same_controller_flies_the_same_flight(flight: RecordedFlight, tmp_path: Path) -> None:
    outcome = refly(flight, flight.config, tmp_path)
    assert outcome.trace_sha256 == flight.summary["trace_sha256"]
    assert outcome.deliveries == flight.deliveries
    lines = verdict(flight, flight.config, outcome)
    assert lines[0].endswith("recorded deliveries used"), "one by one, none skipped and none shared"
    assert "equal bit for bit" in lines[-1]
    assert read_recorded(tmp_path).deliveries == flight.deliveries


def test_another_controller_gets_the_same_link(flight: RecordedFlight, tmp_path: Path) -> None:
    config = with_choices(flight.config, "pid", None)
    assert config.controller == "pid"
    assert config.radio == flight.config.radio
    outcome = refly(flight, config, tmp_path)
    again = figures(config, outcome.trace, outcome.crash_reason, outcome.deliveries)
    assert again.survived
    assert again.feature_version == 0
    original = figures_of_recorded(flight)
    for direction in ("up", "down"):
        assert again.link[direction].lost_share == pytest.approx(original.link[direction].lost_share, abs=0.05)
        assert again.link[direction].longest_gap_s == pytest.approx(original.link[direction].longest_gap_s, abs=0.15)
    assert "trace hash" not in " ".join(verdict(flight, config, outcome))


def test_choices_change_only_what_was_chosen(flight: RecordedFlight) -> None:
    assert with_choices(flight.config, None, None) == flight.config
    seeded = with_choices(flight.config, None, 5)
    assert (seeded.seed, seeded.onboard.seed, seeded.offboard.seed) == (5, 5, 5)
    assert seeded.model_copy(update={"seed": 11}).vehicle == flight.config.vehicle
    there_and_back = with_choices(with_choices(flight.config, "pid", None), "dmrac", None)
    assert there_and_back.onboard == flight.config.onboard
    assert there_and_back.offboard.experience.mode == "learn"
    with pytest.raises(ConfigError, match="unknown controller 'pidd'"):
        with_choices(flight.config, "pidd", None)


# --- bit for bit -----------------------------------------------------------------------------------------------------


def test_a_new_core_gives_the_same_bits(flight: RecordedFlight) -> None:
    (result,) = check_flight(flight)
    assert result.difference is None
    assert result.incomplete == ""
    assert (result.ticks, result.rows, result.failed_steps) == (1300, 1300, 0)
    assert result.datagrams_in > 1800
    assert result.datagrams_out > 1250


def spoil(flight: RecordedFlight, change: Callable[[list[tuple[int, bytes]], np.ndarray], None]) -> CheckResult:
    """The check of a log whose datagrams or rows were changed in memory."""
    log = flight.onboard_logs[0]
    datagram_log, topic = log.raw[TOPIC], log.vectors[TICK.topic]
    rows = topic.values
    log.raw[TOPIC], topic.values = list(datagram_log), rows.copy()
    try:
        change(log.raw[TOPIC], topic.values)
        return check_log(flight, log, None)
    finally:
        log.raw[TOPIC], topic.values = datagram_log, rows


def with_entries(record: bytes, change: Callable[[Entry, bytes], bytes | None]) -> bytes:
    """A record of the datagram log with its entries changed, or removed if `change` returns None."""
    tick, writer = read_tick(record), DatagramLogWriter()
    for kind, arrival in tick.entries:
        changed = change(kind, arrival.datagram)
        if changed is not None:
            writer.put(kind, [arrival._replace(datagram=changed)])
    return record[: HEAD.size] + writer.end_tick(0, 0)[HEAD.size :]


def test_one_bit_of_a_motor_datagram_is_found(flight: RecordedFlight) -> None:
    def change(datagram_log: list[tuple[int, bytes]], rows: np.ndarray) -> None:
        def flip(kind: Entry, data: bytes) -> bytes:
            return data[:20] + bytes([data[20] ^ 1]) + data[21:] if kind is Entry.TO_VEHICLE else data

        datagram_log[700] = (datagram_log[700][0], with_entries(datagram_log[700][1], flip))

    difference = spoil(flight, change).difference
    assert difference is not None
    assert (difference.tick, difference.time_s) == (700, pytest.approx(3.5))
    assert difference.field == "motor datagram, byte 20"


def test_the_last_bit_of_a_tick_field_is_found_and_named(flight: RecordedFlight) -> None:
    def change(datagram_log: list[tuple[int, bytes]], rows: np.ndarray) -> None:
        column = OFFSET["position_adaptive_e"]
        rows[800, column] = np.nextafter(rows[800, column], np.inf)

    difference = spoil(flight, change).difference
    assert difference is not None
    assert difference.tick == 800
    assert difference.field == "onboard/tick position_adaptive_e"
    assert str(difference).startswith("tick 800 at 4.000 s: onboard/tick position_adaptive_e: ")


def test_a_sensor_datagram_that_was_not_there_is_found_at_once(flight: RecordedFlight) -> None:
    def change(datagram_log: list[tuple[int, bytes]], rows: np.ndarray) -> None:
        leave_out = iter([True])

        def drop(kind: Entry, data: bytes) -> bytes | None:
            return None if kind is Entry.FROM_VEHICLE and next(leave_out, False) else data

        datagram_log[900] = (datagram_log[900][0], with_entries(datagram_log[900][1], drop))

    difference = spoil(flight, change).difference
    assert difference is not None
    assert difference.tick == 900


def test_a_gap_in_the_log_ends_the_check_and_is_reported(flight: RecordedFlight) -> None:
    result = spoil(flight, lambda datagram_log, rows: datagram_log.pop(500))  # type: ignore[arg-type, return-value]
    assert result.difference is None
    assert result.ticks == 500
    assert result.incomplete == "the log lost the ticks 500 to 500"


def test_a_step_that_failed_in_flight_must_fail_here_too(flight: RecordedFlight) -> None:
    def change(datagram_log: list[tuple[int, bytes]], rows: np.ndarray) -> None:
        now, record = datagram_log[600]
        datagram_log[600] = (now, record[: HEAD.size - 1] + b"\x01" + record[HEAD.size :])

    difference = spoil(flight, change).difference
    assert difference is not None
    assert (difference.field, difference.logged, difference.replayed) == ("step", "raised", "done")


def test_changed_code_is_found(flight: RecordedFlight) -> None:
    """The purpose of the check: it detects a number that differs in its ninth digit."""
    config = flight.config
    lag = config.onboard.airframe.motor_lag_up_s * (1.0 + 1e-8)
    airframe = config.onboard.airframe.model_copy(update={"motor_lag_up_s": lag})
    onboard = config.onboard.model_copy(update={"airframe": airframe})
    changed = dataclasses.replace(flight, config=config.model_copy(update={"onboard": onboard}))
    (result,) = check_flight(changed)
    assert result.difference is not None
    assert result.difference.field.startswith("onboard/tick")


# --- the command -----------------------------------------------------------------------------------------------------


def test_the_command_checks_and_saves_traces(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(folder), "--check"]) == 0
    assert "1300 ticks" in capsys.readouterr().out
    trace = tmp_path / "mine.csv"
    assert main(["replay", str(folder), "--save-trace", str(trace)]) == 0
    assert trace.read_text(encoding="utf-8").startswith("# Recorded in lockstep: figure8_wind, dmrac, seed 11.\n")


def test_an_error_is_reported_in_one_line(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    shutil.copy(folder / "onboard.mcap", bare)
    wrong = {
        (str(tmp_path / "nowhere"),): "no such flight",
        (str(tmp_path),): "contains no flight log",
        (str(bare),): "the logs of onboard and vehicle are needed",
        (str(bare), "--save-trace", str(tmp_path / "x.csv")): "holds no radio/delivery records",
        (str(folder), "--save-trace", str(tmp_path / "x.txt")): "expected a name that ends in .csv",
        (str(folder), "--check", "--seed", "3"): "it takes no --controller and no --seed",
        (str(folder), "--controller", "nobody"): "unknown controller 'nobody'",
        (str(folder), "--seed", "-4"): "--seed -4: allowed are 0 to",
    }
    for words, expected in wrong.items():
        assert main(["replay", *words, *(() if "--check" in words else ("--out", str(tmp_path / "out")))]) == 2
        error = capsys.readouterr().err
        assert expected in error
        assert len(error.strip().splitlines()) == 1
