"""Receives many datagrams with one system call (recvmmsg), with the kernel's stamps and its count of dropped datagrams.

A datagram costs about 0.8 us, a call of its own 3.5 us. So a flood can be read to its end in every step.
"""

import ctypes
import errno
import os
import socket
from typing import Any, Final, NamedTuple

import numpy as np

DATAGRAM_MAX_BYTES: Final = 2048
"""Longer datagrams are cut. No message of this project is longer than 1200 bytes, so the core refuses a cut one."""
BATCH: Final = 64
SO_TIMESTAMPNS: Final = 35
SO_RXQ_OVFL: Final = 40
"""Linux's numbers on all common processors; Python 3.11 has no names for them."""
_DONT_WAIT: Final = 0x40
_HEAD_BYTES: Final = socket.CMSG_LEN(0)
_STAMP_BYTES: Final = socket.CMSG_SPACE(16)
_CONTROL_BYTES: Final = _STAMP_BYTES + socket.CMSG_SPACE(4)


class _Buffer(ctypes.Structure):
    """struct iovec."""

    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _Header(ctypes.Structure):
    """struct mmsghdr, with its struct msghdr."""

    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint),
        ("buffer", ctypes.c_void_p),
        ("buffers", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
        ("message_end", ctypes.c_size_t * 0),
        ("length", ctypes.c_uint),
    )


class Batch(NamedTuple):
    """What one call has received."""

    datagrams: list[bytes]
    """Oldest first."""
    stamps_ns: list[int]
    """Of the clock of the day; 0 without a stamp."""
    full: bool
    """Whether more may be waiting."""


def receiver_of(one: socket.socket) -> "BatchReceiver | SingleReceiver":
    """The receiver of a non-blocking socket: in batches where the system has recvmmsg."""
    call = getattr(ctypes.CDLL(None, use_errno=True), "recvmmsg", None)
    return SingleReceiver(one) if call is None else BatchReceiver(one, call)


class SingleReceiver:
    """Reads one datagram with each call, without stamps: for a system without recvmmsg."""

    def __init__(self, one: socket.socket) -> None:
        self._socket = one
        self.dropped = 0
        """Not known: always 0."""

    def receive(self, limit: int) -> Batch:
        """The next datagram, if there is one. Raises ConnectionError as a socket does."""
        try:
            return Batch([self._socket.recv(DATAGRAM_MAX_BYTES)], [0], full=limit > 0)
        except BlockingIOError:
            return Batch([], [], full=False)


class BatchReceiver:
    """Reads one non-blocking datagram socket. `dropped`: datagrams that the kernel dropped, by its count."""

    def __init__(self, one: socket.socket, call: Any) -> None:
        """`call`: recvmmsg of the C library."""
        self._call = call
        self._call.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)
        self._descriptor = one.fileno()
        self._data = np.zeros((BATCH, DATAGRAM_MAX_BYTES), np.uint8)
        self._bytes = self._data.data.cast("B")
        self._control = np.zeros((BATCH, _CONTROL_BYTES), np.uint8)
        self._buffers = (_Buffer * BATCH)()
        self._headers = (_Header * BATCH)()
        for index, (buffer, header) in enumerate(zip(self._buffers, self._headers, strict=True)):
            buffer.base, buffer.length = self._data[index].ctypes.data, DATAGRAM_MAX_BYTES
            header.buffer, header.buffers = ctypes.addressof(buffer), 1
            header.control, header.control_length = self._control[index].ctypes.data, _CONTROL_BYTES
        self._address = ctypes.addressof(self._headers)
        whole: Any = self._headers  # which is a buffer, too
        raw = np.frombuffer(whole, np.uint8).reshape(BATCH, ctypes.sizeof(_Header))
        self._lengths = _column(raw, _Header.length.offset, np.uint32)
        self._control_lengths = _column(raw, _Header.control_length.offset, np.uintp)
        self._stamp_kind = _column(self._control, _HEAD_BYTES - 4, np.int32)
        self._seconds = _column(self._control, _HEAD_BYTES, np.int64)
        self._nanoseconds = _column(self._control, _HEAD_BYTES + 8, np.int64)
        self.dropped = 0

    def receive(self, limit: int) -> Batch:
        """The datagrams that have arrived, at most `limit` and BATCH. Raises ConnectionError as a socket does."""
        wanted = min(limit, BATCH)
        count: int = self._call(self._descriptor, self._address, wanted, _DONT_WAIT, None)
        if count <= 0:
            return self._nothing()
        lengths = self._lengths[:count].tolist()
        starts = range(0, count * DATAGRAM_MAX_BYTES, DATAGRAM_MAX_BYTES)
        whole = self._bytes
        datagrams = [whole[start : start + length].tobytes() for start, length in zip(starts, lengths, strict=True)]
        stamped = (self._control_lengths[:count] >= _STAMP_BYTES) & (self._stamp_kind[:count] == SO_TIMESTAMPNS)
        stamps_ns = np.where(stamped, self._seconds[:count] * 10**9 + self._nanoseconds[:count], 0).tolist()
        self._note_dropped(count - 1)
        self._control_lengths[:count] = _CONTROL_BYTES
        return Batch(datagrams, stamps_ns, count == wanted)

    def _nothing(self) -> Batch:
        number = ctypes.get_errno()
        if number == errno.ECONNREFUSED:
            raise ConnectionRefusedError(number, os.strerror(number))
        return Batch([], [], full=False)

    def _note_dropped(self, newest: int) -> None:
        """The kernel's count, 32 bits, comes with each datagram once there is one to report."""
        start, end = 0, int(self._control_lengths[newest])
        control = self._control[newest]
        while start + _HEAD_BYTES + 4 <= end:
            kind = int(control[start + _HEAD_BYTES - 4 : start + _HEAD_BYTES].view(np.int32)[0])
            if kind == SO_RXQ_OVFL:
                count = int(control[start + _HEAD_BYTES : start + _HEAD_BYTES + 4].view(np.uint32)[0])
                self.dropped += (count - self.dropped) % 2**32
                return
            start += _STAMP_BYTES


def _column(rows: np.ndarray, offset: int, kind: type) -> np.ndarray:
    """A view of one field of every row."""
    return rows[:, offset : offset + np.dtype(kind).itemsize].view(kind)[:, 0]
