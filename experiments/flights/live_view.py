"""`dmrac view --live` beside a flight.

It reads the logs as they grow, so no process of the flight knows that it is watched, and it is started ahead of the
flight with a low claim on the processors: preparing the viewer's page takes a second of one.
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
from flight_log.viewer import OPENED
from runtime.signals import die_with_parent

READY_LIMIT_S: Final = 60.0
NICENESS: Final = 10


@contextmanager
def live_view(folder: Path, web: bool, port: int | None = None) -> Iterator[Callable[[], None]]:
    """The viewer, which follows the flight into `folder`; what it gives waits until the viewer is no longer wanted.

    Prints the address of the page (`web`). On the way out the viewer is ended.

    Raises
    ------
    ConfigError
        If the viewer cannot be shown: what it said.
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
        start_new_session=True,  # Ctrl-C is for the flight, which ends the viewer itself
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


def _quietly(prepare: Callable[[], None]) -> Callable[[], None]:
    def in_child() -> None:
        os.nice(NICENESS)
        prepare()

    return in_child


def _first_line(process: subprocess.Popen[str]) -> str:
    """What the viewer says when it is ready. Raises ConfigError if it is not."""
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
    """Until Ctrl-C, or until the viewer's window is closed."""
    if process.poll() is None:
        print(f"the flight is over; the {'page stays up' if web else 'window stays open'} until Ctrl-C", flush=True)
    with suppress(KeyboardInterrupt):
        process.wait()
