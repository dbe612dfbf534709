"""Non-blocking datagram sockets: bound to an own address, and connected to one peer where there is one.

Theory of operation of arrival times. The kernel stamps each datagram on the clock of the day. `receive_stamped`
converts the stamp to the monotonic clock with an offset that it measures around the read. The offset is exact to the
time between two calls, and it never makes an arrival too early. If the clock of the day was set in between, two bounds
remain: a datagram that a read finds came after the last read that left nothing, and before the end of this read.
"""

import contextlib
import errno
import socket
import time
from typing import Final, NamedTuple

from runtime.batch_receive import SO_RXQ_OVFL, SO_TIMESTAMPNS, receiver_of
from runtime.errors import StartError

RECEIVE_BUFFER_BYTES: Final = 1 << 20
"""Holds a flood of 50,000 datagrams a second for one tick; the kernel may allow less (net.core.rmem_max)."""
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

    __slots__ = ("_earliest_ns", "_receiver", "_socket", "received", "sent", "unsent")

    def __init__(self, name: str, local: str, remote: str | None) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._earliest_ns = time.monotonic_ns()  # the next datagram arrived no earlier
        self.received = 0
        self.sent = 0
        self.unsent = 0
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            for option in (SO_TIMESTAMPNS, SO_RXQ_OVFL):
                _request(self._socket, option)
            self._socket.setblocking(False)
            self._receiver = receiver_of(self._socket)
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

    @property
    def dropped(self) -> int:
        """Datagrams that the kernel dropped because its queue was full."""
        return self._receiver.dropped

    def receive(self, limit: int) -> list[bytes]:
        """The datagrams that have arrived, oldest first, at most `limit`."""
        return [stamped.datagram for stamped in self.receive_stamped(limit)]

    def receive_stamped(self, limit: int) -> list[Stamped]:
        """The datagrams that have arrived, oldest first, at most `limit`, with their arrival times in order."""
        stamped: list[Stamped] = []
        clock, offset_ns, full, earliest_ns = time.monotonic_ns, _day_minus_monotonic_ns(), True, self._earliest_ns
        for _ in range(limit):
            if not full or len(stamped) >= limit:
                break
            before_ns = clock()
            try:
                datagrams, stamps_ns, full = self._receiver.receive(limit - len(stamped))
            except ConnectionError:
                continue  # an earlier datagram found no peer; not an error of this side
            after_ns = clock()
            for datagram, stamp_ns in zip(datagrams, stamps_ns, strict=True):
                arrival_ns = stamp_ns - offset_ns if stamp_ns else after_ns
                if arrival_ns > earliest_ns:
                    earliest_ns = arrival_ns if arrival_ns < after_ns else after_ns
                stamped.append(Stamped(datagram, earliest_ns))
            if not full:
                earliest_ns = max(earliest_ns, before_ns)
        self._earliest_ns = earliest_ns
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


def _request(one: socket.socket, option: int) -> None:
    """Ask the kernel for stamps or for its count of drops. Where it has no stamps, the time after the read counts."""
    with contextlib.suppress(OSError):
        one.setsockopt(socket.SOL_SOCKET, option, 1)


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
