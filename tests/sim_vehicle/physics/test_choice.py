"""The configuration or an option chooses the physics; an error names a choice that cannot be used."""

import sys
from pathlib import Path

import pytest

from async_dmrac.command_line import main
from configs.loader import ConfigError
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from flight_log.log_file import read_log_file
from sim_vehicle.config import load_vehicle
from sim_vehicle.physics.choice import advance_and_check, physics_of
from sim_vehicle.vehicle import SimVehicle

MISSING = (
    "vehicle.physics: 'mujoco': the package mujoco is not installed; install the extra with pip install '.[mujoco]'"
)


@pytest.fixture
def without_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)  # any import of it now fails


@pytest.fixture
def flight_file(tmp_path: Path) -> Path:
    path = tmp_path / "flight.yaml"
    path.write_text(resolve("hover", Choices("pid", 1, 6.0)).to_yaml(), encoding="utf-8")
    return path


def test_the_own_physics_is_the_default() -> None:
    assert load_vehicle().physics == "own"
    assert physics_of(load_vehicle()) is advance_and_check


def test_another_name_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"physics: 'bullet': .*'own' or 'mujoco'"):
        load_vehicle("mambo", {"physics": "bullet"})
    with pytest.raises(ConfigError, match=r"vehicle\.physics: 'bullet': .*'own' or 'mujoco'"):
        resolve("hover", Choices(assignments=("vehicle.physics=bullet",)))


def test_another_name_on_the_command_line_is_refused(flight_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["sim", "--config", str(flight_file), "--physics", "bullet"])
    assert ended.value.code == 2
    assert "argument --physics: invalid choice: 'bullet'" in capsys.readouterr().err


@pytest.mark.usefixtures("without_mujoco")
def test_a_missing_package_names_the_extra() -> None:
    config = resolve("hover", Choices("pid", 1, 6.0, ("vehicle.physics=mujoco",)))  # it can be composed for elsewhere
    with pytest.raises(ConfigError) as refused:
        fly_lockstep(config, with_offboard=False)
    assert str(refused.value).startswith(MISSING)


@pytest.mark.usefixtures("without_mujoco")
def test_the_process_ends_with_one_line_if_the_package_is_missing(
    flight_file: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["sim", "--config", str(flight_file), "--out", str(out), "--physics", "mujoco"]) == 2
    [line] = capfd.readouterr().err.splitlines()
    assert line.startswith(MISSING)
    assert not out.exists()


@pytest.mark.parametrize(("words", "physics"), [([], "own"), (["--physics", "mujoco"], "mujoco")])
def test_the_option_overrules_the_configuration(
    words: list[str],
    physics: str,
    flight_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("mujoco", reason="the mujoco extra is not installed")
    flown = []

    class Process:
        """Instead of a flight."""

        def __init__(self, vehicle: SimVehicle, *_: object) -> None:
            flown.append(vehicle)

        def fly(self) -> int:
            return 0

        def close(self) -> None: ...

        def summary(self) -> dict[str, str]:
            return {}

    for name, other in (("SimProcess", Process), ("request_realtime", id), ("prepare_interpreter", list)):
        monkeypatch.setattr(f"sim_vehicle.command.{name}", other)
    out = tmp_path / "out"
    assert main(["sim", "--config", str(flight_file), "--out", str(out), *words]) == 0
    assert [vehicle._physics is advance_and_check for vehicle in flown] == [physics == "own"]
    assert read_log_file(out / "sim_vehicle.mcap").metadata["physics"] == physics


@pytest.mark.usefixtures("without_mujoco")
def test_the_own_physics_does_not_need_the_package() -> None:
    SimVehicle(load_vehicle(), 1).step(20_000_000)
