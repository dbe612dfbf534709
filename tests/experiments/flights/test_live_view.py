"""`fly --view`: the viewer starts before the flight, its output is shown, and it ends with the flight."""

import os
import sys
from pathlib import Path

import pytest

from configs.loader import ConfigError
from experiments.flights import live_view as module
from experiments.flights.live_view import live_view

STAND_IN = """
import os, sys, time
print({printed!r}, flush=True)
print(os.getpid(), os.nice(0), *sys.argv[1:], file=open({log!r}, "w"), flush=True)
time.sleep({lives_s})
"""


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A program of the test instead of the viewer; it writes its arguments to `log`."""

    def put(printed: str, lives_s: float) -> Path:
        log = tmp_path / "log"
        script = tmp_path / "viewer"
        script.write_text(f"#!{sys.executable}\n{STAND_IN.format(printed=printed, log=str(log), lives_s=lives_s)}")
        script.chmod(0o755)
        monkeypatch.setattr(module.sys, "executable", str(script))
        return log

    return put


def runs(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def test_the_viewer_is_quiet_and_ends_with_the_flight(
    stand_in, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = stand_in("http://127.0.0.1:1/?url=x", 60.0)
    with live_view(tmp_path, web=True, port=7) as watch:
        assert callable(watch)
        assert capsys.readouterr().out == "http://127.0.0.1:1/?url=x\n"
        while not log.exists() or not log.read_text(encoding="utf-8").endswith("\n"):
            pass
        pid, niceness, *words = log.read_text(encoding="utf-8").split()
        assert runs(int(pid))
    assert not runs(int(pid))
    assert int(niceness) >= min(os.nice(0) + module.NICENESS, 19)
    assert words[-6:] == ["view", str(tmp_path), "--live", "--web", "--port", "7"]


def test_a_viewer_that_does_not_start_ends_the_command_before_the_flight(stand_in, tmp_path: Path) -> None:
    stand_in("dmrac view: port 9090 of 127.0.0.1: Address already in use; choose another with --port", 0.0)
    with pytest.raises(ConfigError, match=r"--view: port 9090 of 127.0.0.1"), live_view(tmp_path, web=True):
        pytest.fail("there is no viewer to fly with")


def test_the_viewer_stays_until_its_window_is_closed(
    stand_in, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stand_in("the viewer is open", 0.3)
    with live_view(tmp_path, web=False) as watch:
        watch()
    assert "the window stays open until Ctrl-C" in capsys.readouterr().out
