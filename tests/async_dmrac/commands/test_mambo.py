"""`dmrac mambo`: the order of its steps is enforced, and mistakes are named."""

import json
import stat
from pathlib import Path

import pytest
import yaml

from async_dmrac import command_line
from mambo.board import board_config
from mambo.check import Fault, write_certificate


@pytest.fixture
def flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    assert command_line.main(["keygen", "flight.key"]) == 0
    words = ["config", "hover", "--controller", "pid", "--out", "flight.yaml", "--set", "network.key_file=flight.key"]
    assert command_line.main(words) == 0
    return tmp_path / "flight.yaml"


def config(*words: str) -> int:
    return command_line.main(["mambo", "config", "flight.yaml", *words])


def test_the_default_mode_never_runs_the_motors(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert config() == 0
    assert "mode record, with key, mode of the file 0600" in capsys.readouterr().out
    path = flight.with_name("dmrac.bin")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert bytes.fromhex(flight.with_name("flight.key").read_text()) in path.read_bytes()


def test_an_image_says_where_the_library_sends(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its addresses are those of configs/mambo.yaml; another one of offboard's in the flight is noted."""
    addresses = {"radio_onboard": "192.168.3.2:14573", "radio_offboard": "192.168.3.1:14571"}
    words = ["config", "hover", "--controller", "pid", "--out", "flight.yaml", "--set", "network.key_file=flight.key"]
    same = [word for name, address in addresses.items() for word in ("--set", f"network.{name}={address}")]
    assert command_line.main([*words, *same]) == 0
    assert config() == 0
    shown = capsys.readouterr().out
    assert "link: from port 14571 to offboard 192.168.3.2:14573, ground station 192.168.3.2:14550" in shown
    assert "NOTE" not in shown
    assert config("--set", "link.offboard=[192, 168, 3, 7]") == 0
    shown = capsys.readouterr().out
    assert "network.radio_onboard is 192.168.3.2:14573, the image has 192.168.3.7:14573" in shown
    assert "network.radio_offboard" not in shown
    assert config("--set", "link.own_port=14577") == 0
    assert "network.radio_offboard is 192.168.3.1:14571, the image has :14577" in capsys.readouterr().out


def test_a_network_that_is_no_mapping_is_named(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight.write_text(yaml.safe_dump({**yaml.safe_load(flight.read_text()), "network": 5}))
    assert config() == 2
    assert "flight.yaml: network: 5, expected a mapping of keys" in capsys.readouterr().err


def test_an_image_that_flies_needs_a_check_of_the_same_settings(
    flight: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert config("--mode", "fly") == 2
    assert "needs --check FILE" in capsys.readouterr().err
    check = flight.with_name("check.json")
    write_certificate(check, board_config(), [Fault("flow", "wrong sign")], Path("dmrac.rec"))
    assert config("--mode", "fly", "--check", "check.json") == 2
    assert "has not passed" in capsys.readouterr().err
    write_certificate(check, board_config(), [], Path("dmrac.rec"))
    assert config("--mode", "fly", "--check", "check.json", "--set", "sensors.imu=single") == 2
    assert "other settings" in capsys.readouterr().err
    assert not flight.with_name("dmrac.bin").exists()
    assert config("--mode", "fly", "--check", "check.json") == 0
    assert json.loads(check.read_text())["passed"] is True


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--set", "layout.pressure=9"), "layout.pressure: 9"),
        (("--set", "sensors.colour=red"), "sensors.colour"),
        (("--board", "nothing.yaml"), "nothing.yaml: cannot be read"),
    ],
)
def test_a_wrong_setting_is_named(
    flight: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str
) -> None:
    assert config(*words) == 2
    assert message in capsys.readouterr().err


def test_check_prints_the_motions_and_wants_the_motors(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command_line.main(["mambo", "check"]) == 0
    assert "tilt its nose down" in capsys.readouterr().out
    assert command_line.main(["mambo", "check", "nothing.rec", "--motors", "front left"]) == 2
    assert "nothing.rec: cannot be read" in capsys.readouterr().err


def test_the_drones_library_cannot_fly_with_the_laptops_core(capsys: pytest.CaptureFixture[str]) -> None:
    assert command_line.main(["fly", "hover", "--vehicle", "mambo-native", "--core", "c"]) == 2
    assert "--vehicle mambo-native: not with --core" in capsys.readouterr().err
