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

MISSING = "vehicle.physics: '{0}': the package {0} is not installed; install the extra with pip install '.[{0}]'"
OTHERS = ("mujoco", "rotorpy")


@pytest.fixture
def without_others(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in OTHERS:
        for module in [one for one in sys.modules if one.startswith(f"{name}.")]:
            monkeypatch.delitem(sys.modules, module)
        monkeypatch.setitem(sys.modules, name, None)  # any import of it now fails


@pytest.fixture
def flight_file(tmp_path: Path) -> Path:
    path = tmp_path / "flight.yaml"
    path.write_text(resolve("hover", Choices("pid", 1, 6.0)).to_yaml(), encoding="utf-8")
    return path


def test_the_own_physics_is_the_default() -> None:
    assert load_vehicle().physics == "own"
    assert physics_of(load_vehicle()) is advance_and_check


def test_another_name_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"physics: 'bullet': .*'own', 'mujoco' or 'rotorpy'"):
        load_vehicle("mambo", {"physics": "bullet"})
    with pytest.raises(ConfigError, match=r"vehicle\.physics: 'bullet': .*'own', 'mujoco' or 'rotorpy'"):
        resolve("hover", Choices(assignments=("vehicle.physics=bullet",)))


def test_another_name_on_the_command_line_is_refused(flight_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["sim", "--config", str(flight_file), "--physics", "bullet"])
    assert ended.value.code == 2
    assert "argument --physics: invalid choice: 'bullet'" in capsys.readouterr().err


@pytest.mark.usefixtures("without_others")
@pytest.mark.parametrize("name", OTHERS)
def test_a_missing_package_names_the_extra(name: str) -> None:
    config = resolve("hover", Choices("pid", 1, 6.0, (f"vehicle.physics={name}",)))  # it can be composed for elsewhere
    with pytest.raises(ConfigError) as refused:
        fly_lockstep(config, with_offboard=False)
    assert str(refused.value).startswith(MISSING.format(name))


@pytest.mark.usefixtures("without_others")
@pytest.mark.parametrize("name", OTHERS)
def test_the_process_ends_with_one_line_if_the_package_is_missing(
    name: str, flight_file: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["sim", "--config", str(flight_file), "--out", str(out), "--physics", name]) == 2
    [line] = capfd.readouterr().err.splitlines()
    assert line.startswith(MISSING.format(name))
    assert not out.exists()


def test_the_option_refuses_what_the_configuration_would_lose(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "flight.yaml"
    choices = Choices("pid", 1, 6.0, ("vehicle.physics=rotorpy", "vehicle.rotorpy.flapping_m=0.01"))
    path.write_text(resolve("hover", choices).to_yaml(), encoding="utf-8")
    assert main(["sim", "--config", str(path), "--out", str(tmp_path / "out"), "--physics", "own"]) == 2
    [line] = capfd.readouterr().err.splitlines()
    assert line == f"{path}: vehicle: rotorpy: its keys need physics 'rotorpy', not 'own'"


@pytest.mark.parametrize(
    ("words", "physics"),
    [([], "own"), (["--physics", "mujoco"], "mujoco"), (["--physics", "rotorpy"], "rotorpy")],
)
def test_the_option_overrules_the_configuration(
    words: list[str],
    physics: str,
    flight_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    if physics != "own":
        pytest.importorskip(physics, reason=f"the {physics} extra is not installed")
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


@pytest.mark.usefixtures("without_others")
def test_the_own_physics_does_not_need_the_package() -> None:
    SimVehicle(load_vehicle(), 1).step(20_000_000)
