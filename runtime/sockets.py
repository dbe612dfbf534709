"""Non-blocking datagram sockets: bound to an own address, and connected to one peer where there is one."""

import errno
import socket
from typing import Final

from runtime.errors import StartError

DATAGRAM_MAX_BYTES: Final = 2048
"""Longer datagrams are cut. No message of this project is longer than 1200 bytes, so the core refuses a cut one."""
RECEIVE_BUFFER_BYTES: Final = 1 << 18


class AddressInUseError(StartError):
    """A local address cannot be bound. The message names it and the remedy."""


def split_address(address: str) -> tuple[str, int]:
    """Host and port of a validated "host:port"."""
    host, _, port = address.rpartition(":")
    return host, int(port)


class DatagramSocket:
    """One bound UDP socket. Sending never waits and never raises; datagrams that the kernel refuses are counted.

    With a `remote` the socket is connected: the kernel drops datagrams from other addresses.

    Parameters
    ----------
    name: the option or configuration key that sets the address, for messages: "--bind-link", "network.x".
    local: "host:port" to bind; port 0 takes any free port.
    remote: "host:port" of the only peer; None to receive from every address and send nothing.

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
        """The file descriptor, for `select`."""
        return self._socket.fileno()

    @property
    def local_address(self) -> str:
        """The bound address, as "host:port"."""
        host, port = self._socket.getsockname()
        return f"{host}:{port}"

    def receive(self, limit: int) -> list[bytes]:
        """The datagrams that have arrived, oldest first, at most `limit`."""
        datagrams: list[bytes] = []
        receive = self._socket.recv
        for _ in range(limit):
            try:
                datagrams.append(receive(DATAGRAM_MAX_BYTES))
            except BlockingIOError:
                break
            except ConnectionError:
                continue  # an earlier datagram found no peer; not an error of this side
        self.received += len(datagrams)
        return datagrams

    def send(self, datagram: bytes) -> None:
        """Send one datagram; drop and count it if the kernel refuses it."""
        for _ in range(2):  # the first refusal only reports that an earlier datagram found no peer
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
        """Close the socket."""
        self._socket.close()


def require_free(addresses: dict[str, str]) -> None:
    """Check that every address (given by its name in `network`) can be bound now.

    Raises
    ------
    AddressInUseError
        If one cannot. The message names the first such address.
    """
    for name, address in addresses.items():
        DatagramSocket(f"network.{name}", address, None).close()


def _explain(name: str, local: str, remote: str | None, error: OSError) -> str:
    """One line with the address, the error and the remedy."""
    setting = f"{name} HOST:PORT" if name.startswith("--") else f"--set {name}=HOST:PORT"
    if error.errno == errno.EADDRINUSE:
        return (
            f"{name}: {local} is in use by another program (perhaps by a flight that still runs); "
            f"end it, or choose another port with {setting}"
        )
    towards = f" (towards {remote})" if remote is not None else ""
    remedy = f"give an address of this machine and a port you may bind with {setting}"
    if isinstance(error, socket.gaierror):
        remedy = "give a host by its IPv4 address or by a name that this machine can look up"
    elif error.errno in (errno.ENETUNREACH, errno.EHOSTUNREACH):
        remedy = f"join the network that leads to {remote}"
    return f"{name}: {local}{towards} cannot be used: {error.strerror or error}; {remedy}"
