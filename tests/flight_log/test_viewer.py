import os
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from async_dmrac.commands import view
from flight_log import viewer
from flight_log.reader import open_flight
from flight_log.scene import build_scene
from flight_log.viewer import RECORDING_PATH, ViewerError, WebViewer, live_viewer, viewer_binary

recording = pytest.importorskip("flight_log.rerun_scene", reason="the viz extra is not installed")


def run_view(*words: object) -> int:
    import argparse

    parser = argparse.ArgumentParser(prog="dmrac view")
    view.add_arguments(parser)
    return view.run(parser.parse_args([str(word) for word in words]))


def test_a_saved_recording_is_complete(full_flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "flight.rrd"
    assert run_view(full_flight, "--save", target) == 0
    assert capsys.readouterr().out == f"{target}\n"
    environment = {**os.environ, "XDG_CONFIG_HOME": str(tmp_path), "HOME": str(tmp_path)}
    words = [str(viewer_binary()), "rrd", "print", str(target)]
    result = subprocess.run(words, capture_output=True, text=True, env=environment, timeout=60, check=True)
    for entity in (
        "/world/vehicle/thrust",
        "/world/arrows/wind",
        "/world/path/flown",
        "/curves/norm_W/position",
        "/events",
    ):
        assert entity in result.stdout


def test_bad_input_gives_one_line(tmp_path: Path, full_flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_view(tmp_path / "nothing") == 2
    assert run_view(full_flight, "--save", tmp_path / "no" / "flight.rrd") == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first == f"dmrac view: {tmp_path / 'nothing'}: no such flight"
    assert second == f"dmrac view: {tmp_path / 'no' / 'flight.rrd'}: cannot be written: No such file or directory"


def test_without_a_screen_the_message_names_the_remedy(
    full_flight: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert run_view(full_flight) == 2
    assert capsys.readouterr().err == (
        "dmrac view: there is no screen here: add --web and open the address it prints in a browser\n"
    )


def test_without_the_extra_the_message_names_the_remedy(
    full_flight: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(viewer.importlib.util, "find_spec", lambda name: None)
    assert run_view(full_flight) == 2
    assert "not installed: use scripts/view" in capsys.readouterr().err


@pytest.fixture
def served(full_flight: Path, tmp_path: Path) -> Iterator[WebViewer]:
    recording.save_recording(build_scene(open_flight(full_flight)), tmp_path / "flight.rrd", "test")
    with WebViewer(tmp_path / "flight.rrd", port=0) as page:
        thread = threading.Thread(target=page.serve)
        thread.start()
        yield page
        page.stop()
        thread.join()


def test_the_page_is_served_on_loopback_with_its_policy(served: WebViewer, tmp_path: Path) -> None:
    address = served.url.partition("/?")[0]
    assert served.url.endswith("flight.rrd")
    assert address.startswith("http://127.0.0.1:")
    with urllib.request.urlopen(served.url, timeout=10) as answer:
        assert b"canvas" in answer.read()
        assert "connect-src 'self' data: blob: http://127.0.0.1:*;" in answer.headers["Content-Security-Policy"]
    with urllib.request.urlopen(address + RECORDING_PATH, timeout=10) as answer:
        assert answer.read() == (tmp_path / "flight.rrd").read_bytes()
    with urllib.request.urlopen(address + "/re_viewer_bg.wasm", timeout=10) as answer:
        assert answer.read(4) == b"\0asm"
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(address + "/etc/passwd", timeout=10)
    port = int(address.rpartition(":")[2])
    with pytest.raises(ViewerError, match=f"port {port} of 127.0.0.1: Address already in use"):
        WebViewer(tmp_path / "flight.rrd", port)
    outside = socket.gethostbyname(socket.gethostname())
    if not outside.startswith("127."):
        with socket.socket() as probe:
            assert probe.connect_ex((outside, port)) != 0


LIVE_PROCESS = """
import time
from flight_log.viewer import live_viewer
with live_viewer(web=True) as (child, address):
    print(child.pid, address, flush=True)
    time.sleep(60)
"""


def test_no_viewer_outlives_its_parent() -> None:
    with live_viewer(web=True) as (child, address):
        assert address.startswith("rerun+http://127.0.0.1:")
    assert child.poll() is not None
    parent = subprocess.Popen([sys.executable, "-c", LIVE_PROCESS], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    with parent, parent.stdout:
        pid = int(parent.stdout.readline().split()[0])
        parent.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 5
    while _runs(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not _runs(pid)


def _runs(pid: int) -> bool:
    """Whether a process exists and is not a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
