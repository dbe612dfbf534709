"""Shows a recording in the Rerun viewer: in its own window, or in a browser on this machine. Needs the `viz` extra.

No data leaves the machine: servers listen on loopback only, the viewer's telemetry is switched off by a separate
configuration folder, and the page is served with a policy that forbids other connections. No process stays behind:
the viewer is a direct child, which the kernel ends together with this process. For the browser, the viewer's own web
server is run once to get its three files, and then ended, because it keeps a processor busy while idle; this module
serves the files.
"""

import importlib.util
import json
import os
import socket
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from runtime.signals import die_with_parent

LOOPBACK: Final = "127.0.0.1"
WEB_PORT: Final = 9090
START_LIMIT_S: Final = 30.0
END_LIMIT_S: Final = 5.0
LIVE_MEMORY: Final = "512MB"
OPENED: Final = "the viewer is open"
"""What `dmrac view --live` prints once its window waits for data; with --web it prints the address of the page."""
ASSETS: Final = {
    "/": "text/html; charset=utf-8",
    "/re_viewer.js": "text/javascript",
    "/re_viewer_bg.wasm": "application/wasm",
}
RECORDING_PATH: Final = "/flight.rrd"
POLICY: Final = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' data: blob: http://127.0.0.1:*; worker-src 'self' blob:"
)


class ViewerError(Exception):
    """The viewer cannot be shown. The message, one line, states the reason and the remedy."""


def viewer_binary() -> Path:
    """Path of the viewer's program. Its Python wrapper is not used: the program would outlive it.

    Raises ViewerError if the `viz` extra is not installed.
    """
    found = importlib.util.find_spec("rerun_cli")
    binary = Path(found.origin).parent / "rerun" if found is not None and found.origin else None
    if binary is None or not binary.exists():
        raise ViewerError("the viewer is not installed: use scripts/view, or pip install 'async-dmrac[viz]'")
    return binary


@contextmanager
def running_viewer(*options: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run the viewer as a child on loopback, without telemetry; it ends with the context, or with this process."""
    with tempfile.TemporaryDirectory(prefix="dmrac_view_") as settings:
        folder = Path(settings) / "rerun"
        folder.mkdir()
        config = {
            "analytics_enabled": False,
            "analytics_id": "",
            "metadata": {},
            "config_file_path": str(folder / "analytics.json"),
            "data_dir_path": str(folder / "data"),
        }
        (folder / "analytics.json").write_text(json.dumps(config), encoding="utf-8")
        child = subprocess.Popen(
            [str(viewer_binary()), *options, "--bind", LOOPBACK],
            env={**os.environ, "XDG_CONFIG_HOME": settings, "RUST_LOG": "error"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=die_with_parent(),
        )
        try:
            yield child
        finally:
            end(child)


def end(child: subprocess.Popen[bytes]) -> None:
    """End a child: terminate it, and kill it if it has not ended after END_LIMIT_S."""
    child.terminate()
    try:
        child.wait(END_LIMIT_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()


def show_window(recording: Path) -> int:
    """Show a recording in the viewer's window until it is closed; returns the viewer's exit status.

    Raises ViewerError if there is no screen.
    """
    require_screen()
    with running_viewer(str(recording), "--port", "auto") as child:
        return child.wait()


@contextmanager
def live_viewer(web: bool) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Run a viewer that waits for data: a window, or with `web` only a server. Gives the child and its data address.

    Raises ViewerError if there is no screen, or the viewer does not start.
    """
    if not web:
        require_screen()
    port = free_port()
    options = ["--port", str(port), "--server-memory-limit", LIVE_MEMORY]
    with running_viewer(*options, *(["--serve-grpc"] if web else [])) as child:
        deadline = time.monotonic() + START_LIMIT_S
        while not _listens(port):
            if child.poll() is not None or time.monotonic() > deadline:
                raise ViewerError("the viewer did not start")
            time.sleep(0.05)
        yield child, f"rerun+http://{LOOPBACK}:{port}/proxy"


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((LOOPBACK, port)) == 0


def require_screen() -> None:
    """Raise ViewerError if no window can open."""
    if os.name == "posix" and os.uname().sysname == "Linux" and not has_screen():
        raise ViewerError("there is no screen here: add --web and open the address it prints in a browser")


def has_screen() -> bool:
    """Whether this session has a display."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def web_assets() -> dict[str, bytes]:
    """The files of the viewer's web page: path -> content.

    Raises ViewerError if the viewer does not serve them within START_LIMIT_S.
    """
    web, grpc = free_port(), free_port()
    with running_viewer("--serve-web", "--web-viewer-port", str(web), "--port", str(grpc)) as child:
        deadline = time.monotonic() + START_LIMIT_S
        while time.monotonic() < deadline and child.poll() is None:
            try:
                return {path: _fetch(f"http://{LOOPBACK}:{web}{path}") for path in ASSETS}
            except OSError:
                time.sleep(0.05)
    raise ViewerError(f"the viewer did not start within {START_LIMIT_S:.0f} s")


def free_port() -> int:
    """A port that is free now."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


class WebViewer:
    """Serves the viewer's web page to browsers on this machine. A context manager.

    Parameters
    ----------
    source: a recording, which is served too, or the address of a running viewer server (live).
    port: 0 takes a free one.

    Raises ViewerError from the constructor if the port is in use.
    """

    def __init__(self, source: Path | str, port: int = WEB_PORT) -> None:
        content = web_assets()
        if isinstance(source, Path):
            content[RECORDING_PATH] = source.read_bytes()
        try:
            self._server = ThreadingHTTPServer((LOOPBACK, port), _handler(content))
        except OSError as error:
            raise ViewerError(f"port {port} of {LOOPBACK}: {error.strerror}; choose another with --port") from None
        self._server.daemon_threads = True
        address = f"http://{LOOPBACK}:{self._server.server_port}"
        shown = source if isinstance(source, str) else address + RECORDING_PATH
        self.url = f"{address}/?url={quote(shown, safe='')}"
        """What to open in a browser."""

    def serve(self) -> None:
        """Serve until `stop` is called from another thread, or an exception (Ctrl-C) is raised."""
        self._server.serve_forever()

    def stop(self) -> None:
        """End `serve`."""
        self._server.shutdown()

    def __enter__(self) -> "WebViewer":
        return self

    def __exit__(self, *_: object) -> None:
        self._server.server_close()


def _fetch(url: str) -> bytes:
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))  # no proxy: the address is on loopback
    with opener.open(url, timeout=START_LIMIT_S) as response:
        return bytes(response.read())


def _handler(content: Mapping[str, bytes]) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            path = self.path.partition("?")[0]
            body = content.get(path)
            if body is None:
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Type", ASSETS.get(path, "application/octet-stream"))
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Content-Security-Policy", POLICY)
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: Any) -> None:
            """Print nothing: the terminal shows the address."""

    return Handler
