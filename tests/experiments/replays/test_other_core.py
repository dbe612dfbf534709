"""A recorded flight given to the other onboard core: the same decisions, and motor commands but for rounding."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from async_dmrac.command_line import main
from experiments.replays.judges import MOTOR_DIFFERENCE_MAX
from experiments.replays.recorded_flight import RecordedFlight, read_recorded
from experiments.replays.replay_check import CheckResult, check_flight, check_log
from flight_log.log_file import LogFile
from onboard.c.compile import BuildError, compiler
from onboard.record.tick import OFFSET, TICK

try:
    compiler()
except BuildError as error:
    pytest.skip(str(error), allow_module_level=True)

WORDS = "fly figure8_wind --controller mrac --lockstep --duration 6"


def flown(core: str, folder: Path) -> RecordedFlight:
    assert main([*WORDS.split(), "--core", core, "--out", str(folder)]) == 0
    return read_recorded(folder)


@pytest.fixture(scope="module")
def by_numpy(tmp_path_factory: pytest.TempPathFactory) -> RecordedFlight:
    return flown("numpy", tmp_path_factory.mktemp("numpy"))


@pytest.fixture(scope="module")
def by_c(tmp_path_factory: pytest.TempPathFactory) -> RecordedFlight:
    return flown("c", tmp_path_factory.mktemp("c"))


def test_the_c_core_decides_what_numpys_did(by_numpy: RecordedFlight) -> None:
    (result,) = check_flight(by_numpy, core="c")
    assert result.equal
    assert (result.ticks, result.rows) == (1200, 1200)
    assert "the same modes, events, feature versions and numbers of datagrams, motor commands within " in str(result)


def test_the_float_core_decides_the_same_too(by_numpy: RecordedFlight) -> None:
    (result,) = check_flight(by_numpy, core="c", precision="float")
    assert result.equal
    assert 1e-9 < result.motor_difference < MOTOR_DIFFERENCE_MAX["float"]


def test_the_core_that_flew_gives_the_same_bits_and_the_record_names_it(by_c: RecordedFlight) -> None:
    assert by_c.core == "c"
    assert "--core c" in by_c.summary["command"]
    (result,) = check_flight(by_c)
    assert result.equal
    assert "equal bit for bit" in str(result)
    (other,) = check_flight(by_c, core="numpy")
    assert other.equal
    assert "motor commands within" in str(other)


def test_both_flights_are_as_good(by_numpy: RecordedFlight, by_c: RecordedFlight) -> None:
    errors = [flight.summary["position_rmse_m"] for flight in (by_numpy, by_c)]
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.01)


def spoiled(flight: RecordedFlight, column: str, change: float) -> CheckResult:
    """The check of a log whose row 600 has another number in this column."""
    topic = flight.onboard_logs[0].vectors[TICK.topic]
    rows, topic.values = topic.values, topic.values.copy()
    topic.values[600, OFFSET[column]] += change
    try:
        return check_log(flight, flight.onboard_logs[0], None, "c")
    finally:
        topic.values = rows


@pytest.mark.parametrize(
    ("column", "change"),
    [("mode", 1.0), ("feature_version", 1.0), ("law", 1.0), ("motor_3", 2.0 * MOTOR_DIFFERENCE_MAX["double"])],
)
def test_another_decision_or_command_is_found(by_numpy: RecordedFlight, column: str, change: float) -> None:
    difference = spoiled(by_numpy, column, change).difference
    assert difference is not None
    assert (difference.tick, difference.field) == (600, f"onboard/tick {column}")


def test_rounding_is_no_difference(by_numpy: RecordedFlight) -> None:
    assert spoiled(by_numpy, "motor_3", 0.5 * MOTOR_DIFFERENCE_MAX["double"]).equal
    assert spoiled(by_numpy, "position_n", 1e-12).equal


def with_events(flight: RecordedFlight, change: Any) -> CheckResult:
    """The check of a log with other events."""
    log: LogFile = flight.onboard_logs[0]
    kept, log.texts = log.texts, {topic: change(list(events)) for topic, events in log.texts.items()}
    try:
        return check_log(flight, log, None, "c")
    finally:
        log.texts = kept


def test_another_event_is_found(by_numpy: RecordedFlight) -> None:
    missing = with_events(by_numpy, lambda events: events[:3] + events[4:]).difference
    assert missing is not None
    assert missing.field == "event"
    more = with_events(by_numpy, lambda events: [*events, (10**12, "never")]).difference
    assert more is not None
    assert (more.logged, more.replayed) == ("'never'", "none")
    trace = with_events(by_numpy, lambda events: [*events, (10**12, "Traceback (most recent call last):")])
    assert trace.equal, "the process's report of a tick that raised is no event of the core"


def test_options_that_do_not_fit(by_numpy: RecordedFlight, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = {
        ("replay", str(by_numpy.path), "--core", "c"): "--core c: only with --check",
        ("fly", "hover", "--core", "c"): "--core c: only with --lockstep",
        ("replay", str(by_numpy.path), "--check", "--precision", "float"): "--precision float: only with --core c",
    }
    for words, expected in wrong.items():
        assert main(list(words)) == 2
        assert expected in capsys.readouterr().err
