"""Datagram sockets: limited, filtered, non-blocking, and with a clear message for an address in use."""

import socket
import time

import pytest

from runtime import sockets
from runtime.sockets import AddressInUseError, DatagramSocket, require_free


@pytest.fixture
def pair():
    first = DatagramSocket("first", "127.0.0.1:0", None)
    second = DatagramSocket("second", "127.0.0.1:0", first.local_address)
    yield first, second
    first.close()
    second.close()


def test_carries_datagrams_in_order_and_stops_at_the_limit(pair) -> None:
    first, second = pair
    for number in range(5):
        second.send(bytes([number]))
    assert first.receive(3) == [b"\x00", b"\x01", b"\x02"]
    assert first.receive(3) == [b"\x03", b"\x04"]
    assert first.receive(3) == []
    assert (second.sent, first.received) == (5, 5)


def test_a_datagram_has_the_time_of_its_arrival_not_of_the_read(pair) -> None:
    first, second = pair
    for _ in range(20):  # Linux begins to stamp a while after the first socket asked; until then it stamps the read
        second.send(b"early")
        time.sleep(0.03)
        second.send(b"late")
        (early, early_ns), (late, late_ns) = first.receive_stamped(4)
        assert (early, late) == (b"early", b"late")
        assert late_ns <= time.monotonic_ns()
        if early_ns < late_ns:
            break
    assert early_ns + 25_000_000 <= late_ns


@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_a_step_of_the_clock_of_the_day_moves_no_arrival_out_of_its_bounds(pair, monkeypatch, step_s: int) -> None:
    first, second = pair
    day_ns = time.time_ns
    assert first.receive_stamped(4) == []
    empty_ns = time.monotonic_ns()
    second.send(b"between")
    monkeypatch.setattr(sockets.time, "time_ns", lambda: day_ns() + step_s * 10**9)
    ((_, arrival_ns),) = first.receive_stamped(4)
    assert empty_ns - 1_000_000 <= arrival_ns <= time.monotonic_ns()


def test_without_a_stamp_of_the_kernel_the_time_after_the_read_counts(pair) -> None:
    first, second = pair
    first._socket.setsockopt(socket.SOL_SOCKET, sockets.SO_TIMESTAMPNS, 0)
    second.send(b"unstamped")
    time.sleep(0.01)
    read_ns = time.monotonic_ns()
    ((_, arrival_ns),) = first.receive_stamped(4)
    assert read_ns <= arrival_ns <= time.monotonic_ns()


def test_receives_only_from_its_peer(pair) -> None:
    _, second = pair
    stranger = DatagramSocket("stranger", "127.0.0.1:0", second.local_address)
    stranger.send(b"rubbish")
    assert second.receive(4) == []
    stranger.close()


def test_an_absent_peer_is_not_an_error_and_is_found_later() -> None:
    gone = DatagramSocket("gone", "127.0.0.1:0", None)
    address = gone.local_address
    gone.close()
    lonely = DatagramSocket("lonely", "127.0.0.1:0", address)
    for _ in range(3):
        lonely.send(b"anyone?")
        assert lonely.receive(4) == []
    back = DatagramSocket("back", address, None)
    lonely.send(b"here")
    assert back.receive(4) == [b"here"]
    lonely.close()
    back.close()


def test_an_address_in_use_is_named_with_the_remedy(pair) -> None:
    first, _ = pair
    with pytest.raises(AddressInUseError, match=rf"network\.vehicle: {first.local_address} is in use.*--set network"):
        require_free({"vehicle": first.local_address})


def test_an_address_of_another_machine_is_named() -> None:
    with pytest.raises(AddressInUseError, match=r"network\.vehicle: 192\.0\.2\.1:14560 cannot be used.*this machine"):
        require_free({"vehicle": "192.0.2.1:14560"})


def test_an_unknown_host_is_named_with_the_remedy() -> None:
    with pytest.raises(AddressInUseError, match=r"--bind-link: .* \(towards no-such-host\.invalid:1\).*IPv4 address"):
        DatagramSocket("--bind-link", "127.0.0.1:0", "no-such-host.invalid:1")


def test_an_address_in_use_that_an_option_set_is_named_by_the_option(pair) -> None:
    first, _ = pair
    with pytest.raises(AddressInUseError, match=r"--bind: .* is in use .* with --bind HOST:PORT$"):
        DatagramSocket("--bind", first.local_address, None)
