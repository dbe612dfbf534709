"""`dmrac fly --view --web`: a browser shows a flight over UDP while it is flown, and no process is left."""

import asyncio
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from configs.addresses import ADDRESSES
from flight_log.live import END_FILE
from flight_log.reader import open_flight
from tests import browser

DURATION_S = 300.0
"""The test ends it as soon as it is done."""
END_LIMIT_S = 60.0
QUIET = ("nice", "-n", "15")
"""The browser must leave the processors to the flight: without a graphics card it would use all of them."""
LOOPBACK = "0100007F"
LISTENING = "0A"

pytestmark = [
    pytest.mark.full,
    pytest.mark.realtime,
    pytest.mark.skipif(browser.PROGRAM is None, reason="no Chromium or Chrome on this machine"),
]


def test_a_browser_shows_the_flight_while_it_is_flown(tmp_path: Path) -> None:
    pytest.importorskip("flight_log.rerun_scene", reason="the viz extra is not installed")
    folder = tmp_path / "flight"

    async def look(page: browser.Page) -> tuple[np.ndarray, np.ndarray]:
        """A picture of the viewer, and the next one that differs."""
        first = later = await browser.drawn_picture(page)
        while (later == first).all() and not (folder / END_FILE).exists():
            await asyncio.sleep(browser.LOOK_PERIOD_S)
            later = await page.picture()
        return first, later

    environment = {**os.environ, "BROWSER": "true"}  # no window of a person's own browser
    with subprocess.Popen(fly_command(folder), stdout=subprocess.PIPE, text=True, env=environment) as fly:
        assert fly.stdout is not None
        url = fly.stdout.readline().strip()
        assert url.startswith("http://127.0.0.1:")
        with browser.running_browser(tmp_path, QUIET) as socket:
            (first, later), _ = browser.look_at(socket, url, look)
        flown_already = (folder / END_FILE).exists()
        family = descendants(fly.pid)
        heard = listening_addresses(family)
        fly.send_signal(signal.SIGINT)
        output = next(line for line in fly.stdout if line.startswith("the flight is over"))
        fly.send_signal(signal.SIGINT)
        fly.wait(END_LIMIT_S)
    assert not flown_already, "the test was slower than the flight"
    assert browser.drawn(first), f"{browser.colours(first)} colours"
    assert (browser.room(first) != browser.room(later)).any(), "the picture stands still"
    assert len(family) == 5, "three processes of the flight, the page's server and the viewer"
    assert not [pid for pid in family if Path(f"/proc/{pid}").exists()]
    assert heard == {LOOPBACK}
    assert output.strip() == "the flight is over; the page stays up until Ctrl-C"
    assert len(open_flight(folder)["onboard/tick"]) > 0
    assert (folder / "report.html").exists()


def fly_command(folder: Path) -> list[str]:
    """The flight, on addresses that no flight of a person uses."""
    names = ADDRESSES
    command = [sys.executable, "-m", "async_dmrac", "fly", "figure8_wind", "--view", "--web"]
    command += ["--out", str(folder), "--duration", str(DURATION_S)]
    for index, name in enumerate(names):
        command += ["--set", f"network.{name}=127.0.0.1:{16560 + index}"]
    return command


def descendants(pid: int) -> list[int]:
    children = [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()]
    return [found for child in children for found in (child, *descendants(child))]


def listening_addresses(pids: list[int]) -> set[str]:
    """Where the processes listen for TCP connections, as the kernel writes addresses."""
    owned = {os.readlink(entry) for pid in pids for entry in Path(f"/proc/{pid}/fd").iterdir()}
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text(encoding="ascii").splitlines()[1:]:
            _, local, _, state, *rest = line.split()
            if state == LISTENING and f"socket:[{rest[5]}]" in owned:
                found.add(local.partition(":")[0])
    return found
