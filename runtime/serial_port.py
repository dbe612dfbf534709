"""A serial port with the interface of a datagram socket: sends and receives complete frames, without waiting."""

import errno
import fcntl
import os
import termios
import time
from collections.abc import Callable
from typing import Final

from runtime.errors import StartError
from runtime.sockets import Stamped

READ_BYTES: Final = 4096
READS_MAX: Final = 8
"""Most reads in one `receive`; enough for far more than 1 Mbit/s."""
WAITING_MAX: Final = 256
"""Most frames that wait for the next `receive`; beyond it the oldest are dropped."""


class SerialPort:
    """An open serial device in raw mode, 8N1. Sending never waits; frames that could not be sent are counted.

    Parameters
    ----------
    name: the option or configuration key that sets the port, for messages.
    device: path, such as "/dev/ttyUSB0".
    baud: bits per second, one of the system's speeds.
    cut: gets received bytes, returns complete frames (onboard.links.frame_stream.FrameStream.feed).

    Raises
    ------
    StartError
        If the device cannot be opened, is not a serial port, is in use, or does not support the speed.
    """

    def __init__(self, name: str, device: str, baud: int, cut: Callable[[bytes], list[bytes]]) -> None:
        self._cut = cut
        self._frames: list[bytes] = []
        self._rest = b""
        self.received = 0
        self.sent = 0
        self.unsent = 0
        self.dropped = 0
        """Frames dropped because more than WAITING_MAX were waiting."""
        self.hung_up = False
        """The device is gone: unplugged, or its other end closed."""
        self._descriptor = _open(name, device, baud)

    def fileno(self) -> int:
        """The file descriptor, for `select`."""
        return self._descriptor

    def receive(self, limit: int) -> list[bytes]:
        """The complete frames that have arrived, oldest first, at most `limit`."""
        for _ in range(READS_MAX):
            data = self._read()
            if not data:
                break
            self._frames += self._cut(data)
        if len(self._frames) > WAITING_MAX:
            self.dropped += len(self._frames) - WAITING_MAX
            self._frames = self._frames[-WAITING_MAX:]
        frames, self._frames = self._frames[:limit], self._frames[limit:]
        self.received += len(frames)
        return frames

    def receive_stamped(self, limit: int) -> list[Stamped]:
        """The frames of `receive`, stamped after the read: a serial line has no time of arrival."""
        frames = self.receive(limit)
        now_ns = time.monotonic_ns()
        return [Stamped(frame, now_ns) for frame in frames]

    def send(self, frame: bytes) -> None:
        """Send one frame; drop and count it while the one before is not completely sent."""
        if self._rest:
            self._rest = self._rest[self._write(self._rest) :]
        if self._rest:
            self.unsent += 1
            return
        written = self._write(frame)
        if written == 0:
            self.unsent += 1
            return
        self._rest = frame[written:]
        self.sent += 1

    def close(self) -> None:
        """Close the device."""
        os.close(self._descriptor)

    def _read(self) -> bytes:
        try:
            return os.read(self._descriptor, READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:  # unplugged; onboard sees the sensors grow old
            self.hung_up = True
            return b""

    def _write(self, data: bytes) -> int:
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            return 0
        except OSError:
            self.hung_up = True
            return 0


def _open(name: str, device: str, baud: int) -> int:
    """The device's descriptor, raw, exclusive, non-blocking. Raises StartError."""
    speed = getattr(termios, f"B{baud}", None)
    if speed is None:
        known = ", ".join(str(number) for number in _speeds())
        raise StartError(f"{name} {device}: {baud} baud is not supported; allowed are {known}")
    try:
        descriptor = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        reason = "in use by another program" if error.errno == errno.EBUSY else error.strerror
        raise StartError(f"{name} {device}: cannot be opened: {reason}") from None
    try:
        fcntl.ioctl(descriptor, termios.TIOCEXCL)
        _make_raw(descriptor, speed)
        termios.tcflush(descriptor, termios.TCIOFLUSH)
    except (OSError, termios.error) as error:
        os.close(descriptor)
        raise StartError(f"{name} {device}: not a serial port: {error.args[-1]}") from None
    return descriptor


def _make_raw(descriptor: int, speed: int) -> None:
    """8 bits, no parity, one stop bit, no flow control, bytes as they are."""
    control = termios.CS8 | termios.CREAD | termios.CLOCAL
    characters = termios.tcgetattr(descriptor)[6]
    characters[termios.VMIN], characters[termios.VTIME] = 0, 0
    termios.tcsetattr(descriptor, termios.TCSANOW, [0, 0, control, 0, speed, speed, characters])


def _speeds() -> list[int]:
    return sorted(int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit() and name != "B0")
