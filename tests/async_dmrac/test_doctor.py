"""What `dmrac doctor` finds."""

import importlib.util
import os
import socket
from pathlib import Path

import pytest

from async_dmrac import doctor
from async_dmrac.command_line import main
from async_dmrac.doctor import PURPOSE, Finding, examine
from configs.addresses import Addresses
from runtime.extras import EXTRAS


def findings(folder: Path) -> dict[str, Finding]:
    return {one.name: one for one in examine(folder)}


def test_it_names_every_extra(tmp_path: Path) -> None:
    found = findings(tmp_path)
    assert set(PURPOSE) == set(EXTRAS)
    assert {f"extra {name}" for name in EXTRAS} <= set(found)
    assert found["record"].detail.startswith(str(tmp_path))
    assert {"Python", "C compiler", "clock", "timer slack", "real-time priority", "wake-up", "ports"} <= set(found)


def test_it_leaves_the_process_that_asks_as_it_was(tmp_path: Path) -> None:
    before = os.sched_getscheduler(0), Path("/proc/self/timerslack_ns").read_text(encoding="ascii")
    findings(tmp_path)
    assert (os.sched_getscheduler(0), Path("/proc/self/timerslack_ns").read_text(encoding="ascii")) == before


def test_something_that_a_flight_needs_gives_status_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "torch" else find(name))
    assert main(["doctor"]) == 1
    assert "missing  not installed: torch (the trainer)" in capsys.readouterr().out


def test_a_port_in_use_is_named_with_the_way_around_it(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        monkeypatch.setattr(doctor, "Addresses", lambda: Addresses(motion_capture=address))
        found = doctor._ports()
    assert found.state == "warning"
    assert "in use" in found.detail
    assert found.remedy == "fly with --vehicle 2"


def test_without_a_compiler_only_the_c_core_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    found = doctor._compiler()
    assert found.state == "absent"
    assert "no-such-compiler" in found.remedy
