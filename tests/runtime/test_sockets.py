"""Datagram sockets: limited, filtered, non-blocking, and with a clear message for an address in use."""

import pytest

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
