"""Non-blocking datagram sockets of a process: bound to their own address, filtered to one peer, never waiting."""

import errno
import socket
from typing import Final

from runtime.errors import StartError

DATAGRAM_MAX_BYTES: Final = 2048
"""Anything longer is cut here; no message of ours is longer than 1200 bytes, so a cut one is refused by its core."""
RECEIVE_BUFFER_BYTES: Final = 1 << 18


class AddressInUseError(StartError):
    """A local address cannot be bound. The message names it and says what to do."""


def split_address(address: str) -> tuple[str, int]:
    """Host and port of a validated "host:port"."""
    host, _, port = address.rpartition(":")
    return host, int(port)


class DatagramSocket:
    """One bound UDP socket. Sending never waits and never raises; what the kernel would not take is counted.

    With a `remote` the socket is connected: the kernel drops what other addresses send, and `send` needs no address.

    Parameters
    ----------
    name: the option or the configuration's key that gives the address, for messages: "--bind-link", "network.x".
    local: "host:port" to bind; port 0 takes any free port.
    remote: "host:port" of the only peer, or None to hear everybody and send nothing.

    Raises
    ------
    AddressInUseError
        If the address is taken, or is not one of this machine.
    """

    __slots__ = ("_socket", "received", "sent", "unsent")

    def __init__(self, name: str, local: str, remote: str | None) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.received = 0
        self.sent = 0
        self.unsent = 0
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            self._socket.setblocking(False)
            self._socket.bind(split_address(local))
            if remote is not None:
                self._socket.connect(split_address(remote))
        except OSError as error:
            self._socket.close()
            raise AddressInUseError(_explain(name, local, remote, error)) from None

    def fileno(self) -> int:
        """The file descriptor, so that `select` takes the object itself."""
        return self._socket.fileno()

    @property
    def local_address(self) -> str:
        """The address that was really bound, as "host:port"."""
        host, port = self._socket.getsockname()
        return f"{host}:{port}"

    def receive(self, limit: int) -> list[bytes]:
        """The datagrams that wait, oldest first, at most `limit`."""
        datagrams: list[bytes] = []
        receive = self._socket.recv
        for _ in range(limit):
            try:
                datagrams.append(receive(DATAGRAM_MAX_BYTES))
            except BlockingIOError:
                break
            except ConnectionError:
                continue  # the peer was absent when we sent; that is its affair, not a fault of ours
        self.received += len(datagrams)
        return datagrams

    def send(self, datagram: bytes) -> None:
        """Hand one datagram to the kernel; drop and count it if the kernel does not take it."""
        for _ in range(2):  # a first refusal only reports that an earlier datagram found nobody
            try:
                self._socket.send(datagram)
                self.sent += 1
                return
            except ConnectionRefusedError:
                continue
            except OSError:
                break
        self.unsent += 1

    def close(self) -> None:
        """Free the address."""
        self._socket.close()


def require_free(addresses: dict[str, str]) -> None:
    """Check that every address (by its name in the configuration's network) can be bound now.

    Raises
    ------
    AddressInUseError
        Naming the first that cannot.
    """
    for name, address in addresses.items():
        DatagramSocket(f"network.{name}", address, None).close()


def _explain(name: str, local: str, remote: str | None, error: OSError) -> str:
    """One line that names what was given, what is wrong with it, and what to do."""
    setting = f"{name} HOST:PORT" if name.startswith("--") else f"--set {name}=HOST:PORT"
    if error.errno == errno.EADDRINUSE:
        return (
            f"{name}: {local} is in use by another program (perhaps a flight that still runs); "
            f"end it, or choose another port with {setting}"
        )
    towards = f" (towards {remote})" if remote is not None else ""
    remedy = f"give an address of this machine and a port you may bind with {setting}"
    if isinstance(error, socket.gaierror):
        remedy = "give a host by its IPv4 address or by a name that this machine can look up"
    elif error.errno in (errno.ENETUNREACH, errno.EHOSTUNREACH):
        remedy = f"join the network that leads to {remote}"
    return f"{name}: {local}{towards} cannot be used: {error.strerror or error}; {remedy}"
