"""The drone over USB: files by FTP, commands by telnet. Every step is printed before it is done."""

import ftplib
import io
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from runtime.errors import PlainError

USB_HOST: Final = "192.168.2.1"
FTP_PORT: Final = 21
TELNET_PORT: Final = 23
TIMEOUT_S: Final = 5.0
ANSWER_BYTES_MAX: Final = 65536
IAC: Final = 0xFF
Say = Callable[[str], None]
"""Prints one line."""


class DroneError(PlainError):
    """The drone does not do what it should. The message says at which step, and what is left as it was."""


class Files:
    """Files on the drone, in one folder.

    host, port: of its FTP server. folder: as the FTP server names it. say: prints each step.
    """

    def __init__(self, host: str, port: int, folder: str, say: Say) -> None:
        self._ftp, self._folder, self._say = ftplib.FTP(), folder, say
        say(f"connect to ftp://{host}:{port}{folder}")
        with _named(f"ftp://{host}:{port}"):
            self._ftp.connect(host, port, timeout=TIMEOUT_S)
            self._ftp.login()
            self._ftp.cwd(folder)

    def names(self) -> list[str]:
        """Names in the folder."""
        with _named("list the folder"):
            return [name.rpartition("/")[2] for name in self._ftp.nlst()]

    def read(self, name: str) -> bytes:
        """The content of a file."""
        self._say(f"read {name}")
        content = io.BytesIO()
        with _named(f"read {name}"):
            self._ftp.retrbinary(f"RETR {name}", content.write)
        return content.getvalue()

    def write(self, name: str, content: bytes) -> None:
        """Write a file beside, read it back, compare, and only then give it its name."""
        part = f"{name}.new"
        self._say(f"write {part} ({len(content)} bytes)")
        with _named(f"write {part}"):
            self._ftp.storbinary(f"STOR {part}", io.BytesIO(content))
        if self.read(part) != content:
            raise DroneError(f"{part}: what the drone has is not what was sent; {name} is unchanged")
        self.rename(part, name)

    def rename(self, old: str, new: str) -> None:
        """Give a file another name."""
        self._say(f"rename {old} to {new}")
        with _named(f"rename {old}"):
            if new in self.names():
                self._ftp.delete(new)
            self._ftp.rename(old, new)

    def close(self) -> None:
        """End the connection."""
        self._ftp.close()


@contextmanager
def _named(step: str) -> Iterator[None]:
    try:
        yield
    except ftplib.all_errors as error:
        raise DroneError(f"{step}: {error}") from None


class Shell:
    """Commands on the drone. A telnet server's negotiation is refused; it then behaves as a plain line."""

    def __init__(self, host: str, port: int, say: Say) -> None:
        self._say = say
        say(f"connect to telnet {host}:{port}")
        try:
            self._socket = socket.create_connection((host, port), TIMEOUT_S)
        except OSError as error:
            raise DroneError(f"telnet {host}:{port}: {error}") from None

    def run(self, command: str) -> str:
        """What a command prints. Raises DroneError if it fails or does not end."""
        self._say(f"run {command}")
        mark = f"dmrac-{time.monotonic_ns():x}"
        # the mark is written in two parts, so that the echo of the command does not hold it
        line = f"{command}; echo {mark[:6]}''{mark[6:]} $?\n"
        try:
            self._socket.sendall(line.encode())
            text = self._until(mark)
        except OSError as error:
            raise DroneError(f"{command}: {error}") from None
        printed, _, status = text.rpartition(mark)
        if not status.split() or status.split()[0] != "0":
            raise DroneError(f"{command}: ended with status {status.strip() or '?'}: {printed.strip()[-200:]}")
        return printed

    def _until(self, mark: str) -> str:
        """Everything until the line with the mark is complete."""
        received, deadline = b"", time.monotonic() + TIMEOUT_S
        while len(received) < ANSWER_BYTES_MAX:
            self._socket.settimeout(max(0.01, deadline - time.monotonic()))
            part = self._socket.recv(4096)
            if not part:
                raise OSError("the drone closed the connection")
            received += part
            plain = self._without_negotiation(received)
            after = plain.rpartition(mark.encode())[2]
            if mark.encode() in plain and b"\n" in after:
                return plain.decode(errors="replace")
        raise OSError("too long an answer")

    def _without_negotiation(self, data: bytes) -> bytes:
        out, at = bytearray(), 0
        while at < len(data):
            if data[at] == IAC and at + 2 < len(data):
                at += 3
                continue
            out.append(data[at])
            at += 1
        return bytes(out)

    def close(self) -> None:
        """End the connection."""
        self._socket.close()


def keep(path: Path, content: bytes) -> None:
    """Save a file of the drone on this machine. Raises DroneError if another content is there already."""
    if path.exists():
        if path.read_bytes() != content:
            raise DroneError(f"{path}: another file is saved there already; move it away, then try again")
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
