"""The stand-in's process: one request, one answer."""

import subprocess
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from mambo.build import Built, run_command
from mambo.fake.wire import ANSWER_BYTES, EVENT, Answer, decode_answer, event_count
from runtime.errors import PlainError

ENDS_IN_S: Final = 10.0
Command = Callable[[Built], list[str]]
"""The command that runs a build."""


class FirmwareError(PlainError):
    """The stand-in does not answer. The message has what it printed."""


class FirmwareProcess:
    """A running stand-in with the library in it. A context manager.

    folder: holds the configuration image; the library writes there.
    """

    def __init__(self, built: Built, folder: Path, command: Command = run_command) -> None:
        """Raises ConfigError without qemu-arm."""
        self._process = subprocess.Popen(
            command(built),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={"DMRAC_FOLDER": str(folder), "PATH": "/usr/bin:/bin"},
        )

    def call(self, request: bytes) -> Answer:
        """Answer of a request. Raises FirmwareError if the process has ended."""
        process = self._process
        assert process.stdin is not None
        try:
            process.stdin.write(request)
            process.stdin.flush()
        except BrokenPipeError:
            raise self._ended() from None
        head = self._read(ANSWER_BYTES)
        return decode_answer(head, self._read(event_count(head) * EVENT.size))

    def _read(self, size: int) -> bytes:
        assert self._process.stdout is not None
        data = self._process.stdout.read(size)
        if len(data) != size:
            raise self._ended()
        return data

    def _ended(self) -> FirmwareError:
        self._process.kill()
        _, printed = self._process.communicate()
        return FirmwareError(f"the stand-in for the firmware ended: {printed.decode(errors='replace').strip()}")

    def close(self) -> None:
        """End the process: it ends by itself at the end of its requests."""
        try:
            self._process.communicate(timeout=ENDS_IN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
