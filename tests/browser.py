"""A headless browser, driven over its debugging socket: opens a page, takes its picture, tells what it asked for."""

import asyncio
import base64
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.image import imread
from tornado.websocket import WebSocketClientConnection, websocket_connect

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
OPTIONS = (
    *("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--ignore-gpu-blocklist", "--window-size=1500,950", "--remote-debugging-port=0", "about:blank"),
)
START_LIMIT_S = 60.0
DRAWN_LIMIT_S = 150.0
LOOK_PERIOD_S = 1.0


@contextmanager
def running_browser(folder: Path, prefix: tuple[str, ...] = ()) -> Iterator[str]:
    """A headless browser with its files in `folder`; the address of its empty page's debugging socket."""
    command = [*prefix, str(PROGRAM), *OPTIONS, f"--user-data-dir={folder / 'browser'}"]
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port_file = folder / "browser" / "DevToolsActivePort"
        deadline = time.monotonic() + START_LIMIT_S
        while not port_file.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        port = port_file.read_text(encoding="utf-8").split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=START_LIMIT_S) as answer:
            pages = json.loads(answer.read())
        yield next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")
    finally:
        browser.terminate()
        browser.wait(20)


class Page:
    """A page of the browser."""

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

    async def value(self, script: str) -> Any:
        """What a JavaScript expression gives on the page."""
        answer = await self.call("Runtime.evaluate", expression=script, returnByValue=True)
        return answer["result"]["value"]

    async def close(self) -> None:
        self._connection.close()
        while await self._connection.read_message() is not None:
            pass

    async def picture(self, **options: Any) -> np.ndarray:
        """[height, width, 3] of 0..1; black while the browser is between two pages."""
        shot = await self.call("Page.captureScreenshot", format="png", **options)
        if "data" not in shot:
            return np.zeros((900, 1500, 3))
        return imread(BytesIO(base64.b64decode(shot["data"])))[:, :, :3]


Look = Callable[[Page], Any]


def look_at(socket_address: str, url: str, look: Look) -> tuple[Any, Page]:
    """Opens a URL and looks; what `look` (a coroutine) gave, and the page as it was left."""

    async def visit() -> tuple[Any, Page]:
        page = Page(await websocket_connect(socket_address, max_message_size=1 << 27))
        await page.call("Network.enable")
        await page.call("Page.navigate", url=url)
        try:
            return await look(page), page
        finally:
            await page.close()

    return asyncio.run(visit())


async def drawn_picture(page: Page) -> np.ndarray:
    """The picture once the viewer has drawn something, or the last one before the time was up."""
    deadline = time.monotonic() + DRAWN_LIMIT_S
    while not drawn(picture := await page.picture()) and time.monotonic() < deadline:
        await asyncio.sleep(LOOK_PERIOD_S)
    return picture


def drawn(picture: np.ndarray) -> bool:
    """Whether the room to the left and the curves to the right show more than an empty viewer's few colours."""
    return all(colours(part) > 60 for part in (room(picture), curves(picture)))


def room(picture: np.ndarray) -> np.ndarray:
    """Where the viewer shows path and vehicle."""
    height, width, _ = picture.shape
    return picture[100 : height - 100, : width // 2]


def curves(picture: np.ndarray) -> np.ndarray:
    """Where the viewer shows curves."""
    height, width, _ = picture.shape
    return picture[100 : height - 100, 2 * width // 3 :]


def colours(picture: np.ndarray) -> int:
    return len(np.unique((picture.reshape(-1, 3) * 31).astype(int), axis=0))
