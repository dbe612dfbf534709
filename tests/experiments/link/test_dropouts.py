"""The shipped dropout traces, their two formats, and flights with them."""

import json
from pathlib import Path

import numpy as np
import pytest

from async_dmrac.command_line import main
from configs.loader import ConfigError
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from experiments.link.dropout_flights import HEADINGS, DropoutFlight, fly_one
from experiments.link.dropout_trace import COLUMNS, FOLDER, load_trace, trace_names, write_csv
from experiments.replays.link_quality import link_quality
from sim_vehicle.link.radio import Delivery, Radio, RadioConfig

MS = 1_000_000
S = 1_000_000_000
HEAD = ",".join(COLUMNS) + "\n"


def deliveries(count: int = 300) -> Radio:
    config = RadioConfig.model_validate(
        {"up": {"loss": 0.2, "delay_s": 0.01}, "down": {"duplication": 0.2, "corruption": 0.2, "jitter_s": 0.01}}
    )
    radio = Radio(config, np.random.default_rng(3))
    for index in range(count):
        for direction in ("up", "down"):
            radio.send(direction, bytes(100), index * 10 * MS)
    return radio


@pytest.mark.parametrize("name", trace_names())
def test_every_shipped_trace_loads_and_does_something(name: str) -> None:
    trace = load_trace(name)
    assert trace.description
    assert trace.radio != RadioConfig() or any(trace.deliveries.values())
    assert (FOLDER / f"{name}.csv").exists() == bool(trace.deliveries)


def test_recorded_traces_have_the_statistics_of_their_radio() -> None:
    quality = {
        name: link_quality(load_trace(f"recorded_{name}").deliveries["down"], 30.0) for name in ("medium", "bad")
    }
    assert 0.02 < quality["medium"].lost_share < 0.09
    assert 0.15 < quality["bad"].lost_share < 0.35
    bluetooth = link_quality(load_trace("recorded_bluetooth").deliveries["down"], 30.0)
    assert bluetooth.delay_median_s == pytest.approx(0.0135, abs=0.003), "8 ms, jitter, and waiting for one's turn"


def test_deliveries_are_stored_to_the_microsecond(tmp_path: Path) -> None:
    radio = deliveries()
    path = tmp_path / "mine.csv"
    write_csv(path, radio.deliveries, "Made up.")
    trace = load_trace(str(path))
    assert trace.description == "Made up."
    for direction, written in radio.deliveries.items():
        for before, after in zip(written, trace.deliveries[direction], strict=True):
            assert (before.outcome, before.flipped_bit) == (after.outcome, after.flipped_bit)
            for name in ("sent_ns", "delay_ns", "copy_delay_ns"):
                assert getattr(after, name) == pytest.approx(getattr(before, name), abs=501)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected the head"),
        ("up,1,loss,,,\n", "expected the head"),
        (HEAD + "up,1,loss\n", "line 2: 'up,1,loss': 3 cells, expected 6"),
        (HEAD + "sideways,1,loss,,,\n", "direction 'sideways', allowed are up, down"),
        (HEAD + "up,1,eaten,,,\n", "outcome 'eaten', allowed are delivered, loss"),
        (HEAD + "up,1,delivered,,,\n", "a delivered datagram needs a delay_ms"),
        (HEAD + "up,1,loss,3,,\n", "a delivered datagram needs a delay_ms"),
        (HEAD + "up,one,loss,,,\n", "could not convert string to float: 'one'"),
        (HEAD + "up,nan,loss,,,\n", "nan ms, allowed are 0 to"),
        (HEAD + "up,-3,loss,,,\n", "-3 ms, allowed are 0 to"),
        (HEAD + "up,1,delivered,3,,x\n", "invalid literal for int"),
        (HEAD + "up,2,loss,,,\ndown,1,loss,,,\nup,1,loss,,,\n", "up at 1.000 ms: sent_ms decreases"),
    ],
)
def test_an_error_in_a_file_is_named(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as error:
        load_trace(str(path))
    assert message in str(error.value)
    assert str(path) in str(error.value)


def test_a_pattern_with_an_unknown_key_is_named(tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text("description: x\nradio_values: {up: {los: 0.3}}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"wrong.yaml: radio.up.los: unknown key"):
        load_trace(str(path))


def test_an_unknown_trace_is_reported_before_any_flight(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dropouts", "blackout_1s", "no_such"]) == 2
    error = capsys.readouterr().err
    assert "unknown dropout trace 'no_such': allowed are blackout_10s, " in error
    assert len(error.strip().splitlines()) == 1


def test_the_quality_of_a_link() -> None:
    def sent(at_ms: int, delay_ms: int) -> Delivery:
        return Delivery(at_ms * MS, 50, "delivered" if delay_ms >= 0 else "loss", delay_ms * MS, -1, -1)

    quality = link_quality([sent(100, 10), sent(200, -1), sent(300, -1), sent(400, 20), sent(500, -1)], 1.0)
    assert (quality.sent, quality.lost, quality.longest_burst) == (5, 3, 2)
    assert quality.longest_gap_s == pytest.approx(0.58), "the end of the flight ends the last silence"
    assert quality.bytes_per_s == pytest.approx(250.0)
    assert quality.delay_median_s == pytest.approx(0.015)
    nothing = link_quality([], 2.0)
    assert (nothing.lost_share, nothing.longest_gap_s, nothing.longest_burst) == (0.0, 2.0, 0)


def test_flights_have_the_losses_of_their_traces() -> None:
    """The vehicle survives even a link that is dead from the start."""
    dead = fly_one(DropoutFlight("dead", "hover", Choices("pid", 1, 9.5)))
    bad = fly_one(DropoutFlight("recorded_bad", "hover", Choices("pid", 1, 7.0)))
    assert (dead.lost_up, dead.lost_down) == (1.0, 1.0)
    assert dead.gap_down_s == pytest.approx(9.5, abs=0.01)
    assert 0.1 < bad.lost_down < 0.4
    for row in (dead, bad):
        assert row.survived
        assert row.position_rmse_m < 0.5
        assert len(row.cells()) == len(HEADINGS)
        assert row.cells()[6] == "none"


def test_the_vehicle_survives_a_delay_of_a_quarter_of_a_second() -> None:
    """The clock offset is wrong by 65 ms here: poses at the wrong time appear rotated while the vehicle turns."""
    late = fly_one(DropoutFlight("late", "figure8_wind", Choices("pid", 3, 13.0)))
    assert late.survived
    assert late.position_rmse_m < 0.1


@pytest.mark.parametrize("name", trace_names())
def test_the_vehicle_survives_every_shipped_trace(name: str) -> None:
    assert fly_one(DropoutFlight(name, "figure8_wind", Choices("pid", 2, 16.0))).survived


def test_the_command_flies_one_trace(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = tmp_path / "rows.json"
    assert main(["dropouts", "dead", "--controller", "pid", "--duration", "8", "--jobs", "1", "--out", str(rows)]) == 0
    assert capsys.readouterr().out.count(" yes ") == 2, "and one over a perfect link"
    assert [row["trace"] for row in json.loads(rows.read_text(encoding="utf-8"))] == ["perfect", "dead"]


@pytest.mark.full
def test_the_command_flies_all_traces(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dropouts"]) == 0
    assert capsys.readouterr().out.count(" yes ") == len(trace_names()) + 1


def labelled(*assignments: str) -> int:
    """Labelled samples of a short figure-8 over a link that loses 60 % each way."""
    loss = [f"radio.{way}.{key}" for way in ("up", "down") for key in ("loss=0.6", "burst.enter=0.0")]
    flight = fly_lockstep(resolve("figure8_wind", Choices(seed=7, duration_s=10.0, assignments=(*loss, *assignments))))
    assert flight.crash_reason == ""
    return int(flight.offboard["samples"])


def test_sending_batches_twice_gives_more_labels() -> None:
    once, twice = labelled("onboard.samples.repeat_from_loss=1.0"), labelled()
    assert once > 30
    assert twice > 1.3 * once, "40 % arrive, or 64 %"


def test_a_narrow_link_gets_no_repeated_batches() -> None:
    """A full queue drops a tenth of the datagrams down; with twice the bytes the way up would drop some, too."""
    narrow = fly_one(
        DropoutFlight("narrow", "figure8_wind", Choices("dmrac", 2, 12.0, ("offboard.trainer.minimum_samples=60",)))
    )
    assert narrow.lost_down > 0.1
    assert narrow.lost_up == 0.0
