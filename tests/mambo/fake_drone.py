"""An FTP and a telnet server on this machine, as small as the drone's, over a folder."""

import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path


class FakeDrone:
    """Both servers. spoil: files that arrive damaged. ran: commands of the shell. status: their result."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.spoil: set[str] = set()
        self.ran: list[str] = []
        self.status = 0
        self._sockets = [_listening() for _ in range(2)]
        self.ftp_port, self.telnet_port = (one.getsockname()[1] for one in self._sockets)
        for server, serve in zip(self._sockets, (self._serve_ftp, self._serve_telnet), strict=True):
            threading.Thread(target=_accept, args=(server, serve), daemon=True).start()

    def close(self) -> None:
        for one in self._sockets:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    # --- FTP: RFC 959, passive mode only ---

    def _serve_ftp(self, link: socket.socket) -> None:
        data: socket.socket | None = None
        renamed = ""
        _say(link, "220 ready")
        for line in link.makefile("r", encoding="utf-8"):
            word, _, argument = line.strip().partition(" ")
            name = argument.rpartition("/")[2]
            match word.upper():
                case "USER":
                    _say(link, "230 in")
                case "TYPE" | "CWD" | "NOOP":
                    _say(link, "250 ok")
                case "PASV" | "EPSV":
                    data = _listening()
                    port = data.getsockname()[1]
                    passive = f"227 passive (127,0,0,1,{port // 256},{port % 256})"
                    _say(link, f"229 passive (|||{port}|)" if word == "EPSV" else passive)
                case "NLST":
                    names = "".join(f"{one.name}\r\n" for one in sorted(self.folder.iterdir()))
                    _send(link, data, names.encode())
                case "RETR" if (self.folder / name).exists():
                    _send(link, data, (self.folder / name).read_bytes())
                case "STOR":
                    content = _receive(link, data)
                    (self.folder / name).write_bytes(content[:-1] if name in self.spoil else content)
                case "DELE":
                    (self.folder / name).unlink()
                    _say(link, "250 gone")
                case "RNFR":
                    renamed = name
                    _say(link, "350 to what")
                case "RNTO":
                    (self.folder / renamed).rename(self.folder / name)
                    _say(link, "250 renamed")
                case _:
                    _say(link, "550 no")

    # --- telnet ---

    def _serve_telnet(self, link: socket.socket) -> None:
        link.sendall(b"\xff\xfd\x1f\xff\xfb\x01\r\n# ")  # it wants to negotiate, as busybox does
        for line in link.makefile("r", encoding="utf-8"):
            command, _, echo = line.strip().rpartition("; echo ")
            self.ran.append(command)
            mark = echo.removesuffix(" $?").replace("''", "")
            link.sendall(f"{line.strip()}\r\nsome output\r\n{mark} {self.status}\r\n# ".encode())


def _listening() -> socket.socket:
    server = socket.socket()
    server.bind(("127.0.0.1", 0))
    server.listen()
    return server


def _accept(server: socket.socket, serve) -> None:  # type: ignore[no-untyped-def]
    while True:
        try:
            link, _ = server.accept()
        except OSError:
            return
        with link, contextlib.suppress(OSError):
            serve(link)


def _say(link: socket.socket, line: str) -> None:
    link.sendall(f"{line}\r\n".encode())


def _send(link: socket.socket, data: socket.socket | None, content: bytes) -> None:
    assert data is not None
    _say(link, "150 comes")
    with data, data.accept()[0] as one:
        one.sendall(content)
    _say(link, "226 done")


def _receive(link: socket.socket, data: socket.socket | None) -> bytes:
    assert data is not None
    _say(link, "150 give")
    parts = []
    with data, data.accept()[0] as one:
        while part := one.recv(65536):
            parts.append(part)
    _say(link, "226 done")
    return b"".join(parts)


@contextlib.contextmanager
def fake_drone(folder: Path) -> Iterator[FakeDrone]:
    folder.mkdir()
    drone = FakeDrone(folder)
    try:
        yield drone
    finally:
        drone.close()
