"""A record of a stranger names classes of the stranger: no command that reads it runs their code without --trust."""

from collections.abc import Callable
from contextlib import nullcontext
from importlib.util import find_spec
from pathlib import Path

import pytest

import configs.named_class
from async_dmrac.command_line import main
from configs.loader import ConfigError
from experiments.campaigns.campaign import CampaignConfig, Case, Seeds
from experiments.campaigns.runner import CampaignRun, prepare_folder
from experiments.campaigns.store import CampaignStore
from experiments.flights.scenario import Choices, resolve
from experiments.replays import recorded_flight
from experiments.replays.recorded_flight import read_recorded
from flight_log.writer import FlightLogWriter
from onboard.record.tick import TICK

MODULE = "a_strangers_module"
CODE = """
from pathlib import Path
Path(__file__).with_name("ran").touch()
"""
Ran = Callable[[], bool]
BY_CONTROLLER = ("class: onboard.control.cascade:CascadedController", f"class: {MODULE}:Law")
BY_DISTURBANCE = ("disturbances: []", f"disturbances: [{{kind: '{MODULE}:Wind'}}]")
BY_FILE = ("disturbances: []", f"disturbances: [{{kind: '{MODULE}.py:Wind'}}]")
BY_TWO_NAMES = ("disturbances: []", f"disturbances: [{{kind: 'sim_vehicle.disturbances.wind:{MODULE}.py:Wind'}}]")
READS_LOGS_ONLY = (
    *("log info", "log check", "log export --csv", "log merge -o all.mcap", "report", "compare -o c.html FLIGHT"),
    *("learn --out memory", *(("view --save f.rrd",) if find_spec("rerun") else ())),
)
IMPORTS = ("replay", "replay --check", "replay --controller pid", "replay --save-trace t.csv")


@pytest.fixture
def ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Ran:
    """Whether the stranger's module was imported."""
    (tmp_path / f"{MODULE}.py").write_text(CODE, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(__import__("sys").modules, MODULE, raising=False)
    return (tmp_path / "ran").exists


def strangers_flight(folder: Path, named: tuple[str, str]) -> Path:
    text = resolve("hover", Choices("pid", 1)).to_yaml()
    assert text.count(named[0]) == 1
    config = text.replace(*named).encode()
    with FlightLogWriter(folder / "onboard.mcap", "onboard", {"session": "1"}, {"config.yaml": config}) as log:
        for tick in range(50):
            log.write(TICK, tick * 5_000_000, [0.0] * len(TICK.fields))  # type: ignore[arg-type]
    return folder


@pytest.mark.parametrize("named", [BY_CONTROLLER, BY_DISTURBANCE], ids=["controller", "disturbance"])
@pytest.mark.parametrize("command", [*READS_LOGS_ONLY, *IMPORTS])
def test_no_command_runs_a_strangers_code(
    command: str, named: tuple[str, str], ran: Ran, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = strangers_flight(tmp_path / "flight", named)
    status = main([*command.replace("FLIGHT", str(flight)).split(), str(flight)])
    assert not ran()
    if command in IMPORTS:
        assert status == 2
        [line] = capsys.readouterr().err.splitlines()
        assert f"{flight}: config.yaml" in line
        assert MODULE in line
        assert line.endswith("add --trust")


@pytest.mark.parametrize("named", [BY_FILE, BY_TWO_NAMES], ids=["file", "two names"])
def test_nor_that_of_a_strangers_file(named: tuple[str, str], ran: Ran, tmp_path: Path) -> None:
    assert main(["replay", str(strangers_flight(tmp_path / "flight", named))]) == 2
    assert not ran()


@pytest.mark.parametrize("named", [BY_CONTROLLER, BY_DISTURBANCE, BY_FILE], ids=["controller", "disturbance", "file"])
def test_trust_runs_it(named: tuple[str, str], ran: Ran, tmp_path: Path) -> None:
    flight = strangers_flight(tmp_path / "flight", named)
    assert main(["replay", "--trust", str(flight)]) == 2, "the class itself does not exist"
    assert ran()


def test_without_the_safeguard_the_code_runs(ran: Ran, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorded_flight, "classes_for", lambda trust: nullcontext())
    with pytest.raises(ConfigError):
        read_recorded(strangers_flight(tmp_path / "flight", BY_CONTROLLER))
    assert ran()


@pytest.mark.parametrize("command", ["figures", "refly"])
def test_nor_does_a_campaign(
    command: str, ran: Ran, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(name="hover", scenario="hover", set={"onboard.controller.class": f"{MODULE}:Law"})
    campaign = CampaignConfig(description="a stranger's", controllers=("pid",), cases=(case,), seeds=Seeds(count=1))
    folder = tmp_path / "campaign"
    prepare_folder(CampaignRun(campaign, "stranger", folder), resume=False)
    assert ran(), "the stranger's own machine"
    (tmp_path / "ran").unlink()
    monkeypatch.delitem(__import__("sys").modules, MODULE)
    CampaignStore(folder).close()
    status = main([command, str(folder)])
    assert not ran()
    assert status == 2
    assert capsys.readouterr().err


def test_only_what_is_shipped_is_imported(ran: Ran, tmp_path: Path) -> None:
    modules = "onboard.__main__:main", "antigravity:x", f"{MODULE}:Law", "sim_vehicle.disturbances.:x"
    files = f"{MODULE}.py:Law", f"{tmp_path / MODULE}.py:Law", f"sim_vehicle.disturbances.wind:{MODULE}.py:Law"
    with configs.named_class.shipped_classes_only():
        for path in (*modules, *files, "this_session:Law"):
            with pytest.raises(ConfigError, match="not part of this project"):
                configs.named_class.named_class(path, "key")
        assert configs.named_class.named_class("onboard.control.cascade:CascadedController", "key")
    assert not ran()
