"""The viewer's page in a real browser: it draws the flight, and connects only to this machine."""

import threading
from pathlib import Path

import pytest

from flight_log.reader import open_flight
from flight_log.scene import build_scene
from flight_log.viewer import WebViewer
from tests import browser

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(browser.PROGRAM is None, reason="no Chromium or Chrome on this machine"),
]


def test_the_flight_is_drawn_without_connections_to_other_hosts(full_flight: Path, tmp_path: Path) -> None:
    recording = pytest.importorskip("flight_log.rerun_scene", reason="the viz extra is not installed")
    recording.save_recording(build_scene(open_flight(full_flight)), tmp_path / "flight.rrd", "test")
    with browser.running_browser(tmp_path) as socket, WebViewer(tmp_path / "flight.rrd", port=0) as viewer:
        server = threading.Thread(target=viewer.serve)
        server.start()
        try:
            picture, page = browser.look_at(socket, viewer.url, browser.drawn_picture)
        finally:
            viewer.stop()
            server.join()
    assert browser.drawn(picture), f"{browser.colours(picture)} colours"
    sent = [url for url in page.requests if not url.startswith(("http://127.0.0.1:", "data:", "blob:"))]
    assert len(page.blocked) >= len(sent), f"asked for {sent}, of which {len(page.blocked)} were stopped"
