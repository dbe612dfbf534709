"""The public functions: fly a scenario, read a record, and the errors that a user sees."""

from pathlib import Path

import pytest

import async_dmrac
from configs.loader import ConfigError
from flight_log.reader import FlightError
from sim_vehicle.records import TRUTH


def test_a_flight_returns_its_record_and_can_be_loaded_again(tmp_path: Path) -> None:
    out = tmp_path / "flown"
    settings = {"vehicle.body.mass_kg": 0.065, "vehicle.initial.position_ned_m": [0.1, 0.0, 0.0]}
    flight = async_dmrac.fly("hover", controller="pid", seed=3, duration_s=5.0, set=settings, out=out)
    tick = flight["onboard/tick"]
    assert len(tick) == 1000
    assert flight[TRUTH.topic]["position_n"][0] == pytest.approx(0.1, abs=1e-3)
    assert (flight.summary["controller"], flight.summary["seed"], flight.summary["mode"]) == ("pid", 3, "lockstep")
    assert flight.summary["survived"]
    assert flight.summary["onboard"]["calibration"]["accepted"] == 1
    assert {"config.yaml", "onboard.mcap", "summary.json", "flight.png", "report.html"} <= {
        path.name for path in out.iterdir()
    }
    again = async_dmrac.load_flight(out)
    assert again.summary == flight.summary
    assert (again["onboard/tick"].values == tick.values).all()
    assert (async_dmrac.load_flight(out / "onboard.mcap")["onboard/tick"].values == tick.values).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "nowhere"}, "unknown scenario 'nowhere': allowed are blackout, "),
        ({"controller": "magic"}, "unknown controller 'magic': allowed are bias, "),
        ({"seed": -1}, "greater than or equal to 0"),
        ({"duration_s": 1.0}, "greater than or equal to 5"),
        ({"set": {"vehicle.body.weight": 1.0}}, r"vehicle\.body\.weight: unknown key; allowed are "),
        ({"set": {"vehicle.body.mass_kg": "heavy"}}, r"vehicle\.body\.mass_kg: 'heavy'"),
    ],
)
def test_a_wrong_argument_is_named_and_leaves_no_folder(
    arguments: dict[str, object], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=message):
        async_dmrac.fly(**{"scenario": "hover"} | arguments)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_a_flight_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(ConfigError, match="already"):
        async_dmrac.fly("hover", duration_s=5.0, out=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]


def test_a_folder_without_a_log_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FlightError, match=str(tmp_path)):
        async_dmrac.load_flight(tmp_path)


def test_there_is_nothing_else() -> None:
    assert set(async_dmrac.__all__) == {"__version__", "fly", "load_flight"}
    with pytest.raises(AttributeError, match="no attribute 'land'"):
        async_dmrac.land  # noqa: B018
