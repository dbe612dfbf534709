"""`dmrac view FLIGHT` on a screen of the test's own: the window shows the flight and goes when it is told to."""

import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from flight_record.viewer import viewer_binary
from tests.browser import drawn

SCREEN = "1500x950x24"
START_LIMIT_S = 30.0
DRAWN_LIMIT_S = 180.0
END_LIMIT_S = 20.0

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(shutil.which("Xvfb") is None, reason="no Xvfb on this machine"),
]


@pytest.fixture
def screen(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """A display without a monitor: its name, and the file that holds its picture."""
    read, write = os.pipe()
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", SCREEN, "-fbdir", str(tmp_path), "-nolisten", "tcp"]
    with subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL) as server:
        os.close(write)
        with os.fdopen(read) as number:
            name = f":{number.readline().strip()}"
        yield name, tmp_path / "Xvfb_screen0"
        server.terminate()


def picture_of(framebuffer: Path) -> np.ndarray:
    """[height, width, 3] of 0..1, from a file in the format of xwd."""
    data = framebuffer.read_bytes()
    head = struct.unpack(">25I", data[:100])
    width, height, line, start = head[4], head[5], head[12], head[0] + 12 * head[19]
    rows = np.frombuffer(data, np.uint8, height * line, start).reshape(height, line)
    return rows[:, : 4 * width].reshape(height, width, 4)[:, :, 2::-1] / 255.0


def test_the_window_shows_the_flight(full_flight: Path, screen: tuple[str, Path], tmp_path: Path) -> None:
    pytest.importorskip("flight_record.recording", reason="the viz extra is not installed")
    display, framebuffer = screen
    command = [sys.executable, "-m", "experiments.command_line", "view", str(full_flight)]
    environment = {**os.environ, "DISPLAY": display, "XDG_RUNTIME_DIR": str(tmp_path)}
    with subprocess.Popen(command, env=environment) as view:
        deadline = time.monotonic() + DRAWN_LIMIT_S
        while not (seen := drawn(picture_of(framebuffer))) and view.poll() is None and time.monotonic() < deadline:
            time.sleep(0.5)
        [window] = (int(pid) for pid in children_of(view.pid))
        view.send_signal(signal.SIGINT)
        assert view.wait(END_LIMIT_S) == 0
    assert seen
    assert not Path(f"/proc/{window}").exists(), f"{viewer_binary()} was left behind"


def children_of(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
