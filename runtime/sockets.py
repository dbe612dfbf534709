"""Non-blocking datagram sockets: bound to an own address, and connected to one peer where there is one.

Theory of operation of arrival times. The kernel stamps each datagram on the clock of the day. `receive_stamped`
converts the stamp to the monotonic clock with an offset that it measures around the read. The offset is exact to the
time between two calls, and it never makes an arrival too early. If the clock of the day was set in between, two bounds
remain: a datagram that a read finds came after the last read that found nothing, and before the end of this read.
"""

import contextlib
import errno
import socket
import struct
import time
from typing import Final, NamedTuple

from runtime.errors import StartError

DATAGRAM_MAX_BYTES: Final = 2048
"""Longer datagrams are cut. No message of this project is longer than 1200 bytes, so the core refuses a cut one."""
RECEIVE_BUFFER_BYTES: Final = 1 << 18
SO_TIMESTAMPNS: Final = 35
"""Linux's number on all common processors; Python 3.11 has no name for it."""
_TIMESPEC: Final = struct.Struct("@qq")
_CONTROL_BYTES: Final = socket.CMSG_SPACE(_TIMESPEC.size)
_OFFSET_TRIES: Final = 3
_OFFSET_GOOD_NS: Final = 5_000


class Stamped(NamedTuple):
    """A datagram and the time of its arrival, monotonic clock."""

    datagram: bytes
    arrival_ns: int


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

    __slots__ = ("_earliest_ns", "_socket", "received", "sent", "unsent")

    def __init__(self, name: str, local: str, remote: str | None) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._earliest_ns = time.monotonic_ns()  # the next datagram arrived no earlier
        self.received = 0
        self.sent = 0
        self.unsent = 0
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            _request_stamps(self._socket)
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
        return [stamped.datagram for stamped in self.receive_stamped(limit)]

    def receive_stamped(self, limit: int) -> list[Stamped]:
        """The datagrams that have arrived, oldest first, at most `limit`, with their arrival times in order."""
        stamped: list[Stamped] = []
        receive, clock, offset_ns = self._socket.recvmsg, time.monotonic_ns, _day_minus_monotonic_ns()
        for _ in range(limit):
            before_ns = clock()
            try:
                datagram, control, _, _ = receive(DATAGRAM_MAX_BYTES, _CONTROL_BYTES)
            except BlockingIOError:
                self._earliest_ns = before_ns
                break
            except ConnectionError:
                continue  # an earlier datagram found no peer; not an error of this side
            arrival_ns = clock()
            for _, kind, data in control:
                if kind == SO_TIMESTAMPNS and len(data) == _TIMESPEC.size:
                    seconds, nanoseconds = _TIMESPEC.unpack(data)
                    arrival_ns = min(arrival_ns, seconds * 1_000_000_000 + nanoseconds - offset_ns)
            self._earliest_ns = max(self._earliest_ns, arrival_ns)
            stamped.append(Stamped(datagram, self._earliest_ns))
        self.received += len(stamped)
        return stamped

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


def _request_stamps(one: socket.socket) -> None:
    """Ask the kernel to stamp arrivals. Where it cannot, the time after the read counts."""
    with contextlib.suppress(OSError):
        one.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)


def _day_minus_monotonic_ns() -> int:
    """The clock of the day minus the monotonic clock; the error is at most the time between two calls."""
    least_ns, offset_ns = None, 0
    for _ in range(_OFFSET_TRIES):
        before_ns = time.monotonic_ns()
        day_ns = time.time_ns()
        after_ns = time.monotonic_ns()
        if least_ns is None or after_ns - before_ns < least_ns:
            least_ns, offset_ns = after_ns - before_ns, day_ns - after_ns
        if least_ns < _OFFSET_GOOD_NS:
            break
    return offset_ns


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
