"""The viewer's page in a real browser: it draws the flight, and it talks to nobody but this machine."""

import asyncio
import base64
import json
import shutil
import subprocess
import threading
import time
import urllib.request
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from tornado.websocket import WebSocketClientConnection, websocket_connect

from flight_record.reader import open_flight
from flight_record.scene import build_scene
from flight_record.viewer import WebViewer

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
OPTIONS = (
    *("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--ignore-gpu-blocklist", "--window-size=1500,950", "--remote-debugging-port=0", "about:blank"),
)
DRAWN_LIMIT_S = 90.0

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium or Chrome on this machine"),
]


@pytest.fixture
def page_address(tmp_path: Path) -> Iterator[str]:
    """A headless browser's empty page, as the address of its debugging socket."""
    command = [str(BROWSER), *OPTIONS, f"--user-data-dir={tmp_path / 'browser'}"]
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port_file = tmp_path / "browser" / "DevToolsActivePort"
        deadline = time.monotonic() + 30
        while not port_file.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        port = port_file.read_text(encoding="utf-8").split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=10) as answer:
            pages = json.loads(answer.read())
        yield next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")
    finally:
        browser.terminate()
        browser.wait(20)


class Browser:
    """A page driven over its debugging socket."""

    def __init__(self, connection: WebSocketClientConnection) -> None:
        self._connection = connection
        self._number = 0
        self.requests: list[str] = []
        self.blocked: list[str] = []

    async def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        await self._connection.write_message(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            text = await self._connection.read_message()
            assert text is not None, "the browser closed the connection"
            message = json.loads(text)
            if message.get("method") == "Network.requestWillBeSent":
                self.requests.append(message["params"]["request"]["url"])
            if message.get("method") == "Network.loadingFailed" and message["params"].get("blockedReason") == "csp":
                self.blocked.append(message["params"]["requestId"])
            if message.get("id") == self._number:
                found: dict[str, Any] = message.get("result", {})
                return found

    async def close(self) -> None:
        self._connection.close()
        while await self._connection.read_message() is not None:
            pass

    async def picture(self) -> np.ndarray:
        """[height, width, 3] of 0..1; black while the browser is between two pages."""
        shot = await self.call("Page.captureScreenshot", format="png")
        if "data" not in shot:
            return np.zeros((900, 1500, 3))
        return imread(BytesIO(base64.b64decode(shot["data"])))[:, :, :3]


def drawn(picture: np.ndarray) -> bool:
    """Whether the room to the left and the curves to the right show more than an empty page's few colours."""
    height, width, _ = picture.shape
    parts = picture[100 : height - 100, : width // 2], picture[100 : height - 100, 2 * width // 3 :]
    return all(colours(part) > 60 for part in parts)


def colours(picture: np.ndarray) -> int:
    return len(np.unique((picture.reshape(-1, 3) * 31).astype(int), axis=0))


def test_the_flight_is_drawn_and_nobody_else_is_told(page_address: str, full_flight: Path, tmp_path: Path) -> None:
    recording = pytest.importorskip("flight_record.recording", reason="the viz extra is not installed")
    recording.save_recording(build_scene(open_flight(full_flight)), tmp_path / "flight.rrd", "test")

    async def look(url: str) -> tuple[np.ndarray, Browser]:
        browser = Browser(await websocket_connect(page_address, max_message_size=1 << 26))
        await browser.call("Network.enable")
        await browser.call("Page.navigate", url=url)
        deadline = time.monotonic() + DRAWN_LIMIT_S
        while not drawn(picture := await browser.picture()) and time.monotonic() < deadline:
            await asyncio.sleep(1.0)
        await browser.close()
        return picture, browser

    with WebViewer(tmp_path / "flight.rrd", port=0) as viewer:
        server = threading.Thread(target=viewer.serve)
        server.start()
        try:
            picture, browser = asyncio.run(look(viewer.url))
        finally:
            viewer.stop()
            server.join()
    assert drawn(picture), f"{colours(picture)} colours"
    sent = [url for url in browser.requests if not url.startswith(("http://127.0.0.1:", "data:", "blob:"))]
    assert len(browser.blocked) >= len(sent), f"asked for {sent}, of which {len(browser.blocked)} were stopped"
