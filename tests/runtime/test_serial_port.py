"""The serial port, on a pair of pseudo-terminals: frames in both directions, and errors of the line."""

import os
import pty
import time

import pytest

from onboard.links.frame_stream import FrameStream
from protocol.mavlink.frames import FrameWriter
from protocol.mavlink.vehicle import encode_heartbeat
from runtime.errors import StartError
from runtime.serial_port import WAITING_MAX, SerialPort


@pytest.fixture
def line():
    """(descriptor of the other end, port under test)."""
    far, near = pty.openpty()
    port = SerialPort("vehicle", os.ttyname(near), 921600, FrameStream().feed)
    os.close(near)
    os.set_blocking(far, False)
    yield far, port
    port.close()
    os.close(far)


def heartbeat(number=0):
    return FrameWriter(1, 1).write(encode_heartbeat(number, 8, 0, False, 3), 0)


def wait_for(receive, count):
    got, end = [], time.monotonic() + 5.0
    while len(got) < count and time.monotonic() < end:
        got += receive()
        time.sleep(0.001)
    return got


def test_frames_cross_the_line_both_ways_byte_for_byte(line):
    far, port = line
    sent = [heartbeat(number) for number in range(256)]  # every byte value, including control characters
    for frame in sent[:20]:
        for byte in frame:
            os.write(far, bytes([byte]))
    assert wait_for(lambda: port.receive(8), 20) == sent[:20]
    for frame in sent[20:60]:
        port.send(frame)
    expected = b"".join(sent[20:60])
    data, end = b"", time.monotonic() + 5.0
    while len(data) < len(expected) and time.monotonic() < end:
        try:
            data += os.read(far, 4096)
        except BlockingIOError:
            time.sleep(0.001)
    assert data == expected
    assert (port.received, port.sent, port.unsent) == (20, 40, 0)


def test_reading_without_data_neither_waits_nor_fails(line):
    _, port = line
    assert port.receive(8) == []
    assert not port.hung_up


def test_receive_returns_at_most_the_limit_and_the_rest_later(line):
    far, port = line
    os.write(far, b"".join(heartbeat(number) for number in range(10)))
    time.sleep(0.01)
    assert len(wait_for(lambda: port.receive(4), 4)) >= 4
    assert len(wait_for(lambda: port.receive(16), 1)) > 0


def test_frames_that_are_not_fetched_are_bounded():
    far, near = pty.openpty()
    port = SerialPort("vehicle", os.ttyname(near), 115200, lambda data: [data[:1]] * 1000)
    os.write(far, b"x")
    assert wait_for(lambda: port.receive(10), 1) == [b"x"] * 10
    assert port.dropped == 1000 - WAITING_MAX
    port.close()
    os.close(far)
    os.close(near)


def test_a_full_line_loses_only_complete_frames(line):
    far, port = line
    frame = heartbeat(5)
    for _ in range(20_000):
        port.send(frame)
        if port.unsent > 10:
            break
    assert port.unsent > 10
    stream, got = FrameStream(), 0
    end = time.monotonic() + 5.0
    while got < port.sent and time.monotonic() < end:
        try:
            got += len(stream.feed(os.read(far, 4096)))
        except BlockingIOError:
            port.send(frame)  # sends the rest of the incomplete frame
    assert got > 0
    assert not stream.skipped


def test_an_unplugged_device_is_noted_and_raises_nothing():
    far, near = pty.openpty()
    port = SerialPort("vehicle", os.ttyname(near), 115200, FrameStream().feed)
    os.close(near)
    os.close(far)
    assert port.receive(4) == []
    port.send(heartbeat())
    assert port.hung_up
    assert port.unsent == 1
    port.close()


@pytest.mark.parametrize(
    ("device", "baud", "message"),
    [
        ("/dev/does-not-exist", 115200, "cannot be opened: No such file"),
        ("/dev/null", 115200, "not a serial port"),
        ("/dev/null", 123, "123 baud is not supported; allowed are"),
    ],
)
def test_a_port_that_cannot_be_used_is_named(device, baud, message):
    with pytest.raises(StartError, match=message):
        SerialPort("vehicle", device, baud, FrameStream().feed)
