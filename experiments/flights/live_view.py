"""Runs `dmrac view --live` beside a flight.

The viewer reads the logs while they are written, so the processes of the flight are not involved. It is started before
the flight, with low priority, because preparing its page takes a second of a processor.
"""

import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from configs.loader import ConfigError
from flight_log.viewer import OPENED, ViewerError, require_screen, viewer_binary
from runtime.signals import die_with_parent

READY_LIMIT_S: Final = 60.0
NICENESS: Final = 10


@contextmanager
def live_view(folder: Path, web: bool, port: int | None = None) -> Iterator[Callable[[], None]]:
    """Run the viewer for the flight in `folder`, and end it on exit.

    Yields a function that waits until the person closes the viewer or presses Ctrl-C. Prints the address of the page
    (`web`).

    Raises
    ------
    ConfigError
        If the viewer does not start; contains its message.
    """
    command = [sys.executable, "-m", "async_dmrac", "view", str(folder), "--live"]
    command += ["--web"] if web else []
    command += ["--port", str(port)] if port is not None else []
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,  # Ctrl-C goes to the flight, which ends the viewer
        preexec_fn=_quietly(die_with_parent()),
    )
    try:
        print(_first_line(process), flush=True)
        yield lambda: _wait(process, web)
    finally:
        process.terminate()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def require_viewer(web: bool) -> None:
    """Raise ConfigError if the viewer, or a screen for its window, is missing."""
    try:
        viewer_binary()
        if not web:
            require_screen()
    except ViewerError as error:
        raise ConfigError(f"--view: {error}") from None


def _quietly(prepare: Callable[[], None]) -> Callable[[], None]:
    def in_child() -> None:
        os.nice(NICENESS)
        prepare()

    return in_child


def _first_line(process: subprocess.Popen[str]) -> str:
    """Return the viewer's line when it is ready. Raises ConfigError if it does not start."""
    assert process.stdout is not None
    deadline = time.monotonic() + READY_LIMIT_S
    while not select.select([process.stdout], (), (), 0.1)[0]:
        if time.monotonic() > deadline:
            raise ConfigError(f"--view: the viewer did not start within {READY_LIMIT_S:.0f} s")
    line = process.stdout.readline().strip()
    if line != OPENED and not line.startswith("http://"):
        raise ConfigError(f"--view: {line.removeprefix('dmrac view: ')}")
    return line


def _wait(process: subprocess.Popen[str], web: bool) -> None:
    """Wait until Ctrl-C, or until the viewer's window is closed."""
    if process.poll() is None:
        print(f"the flight is over; the {'page stays up' if web else 'window stays open'} until Ctrl-C", flush=True)
    with suppress(KeyboardInterrupt):
        process.wait()
