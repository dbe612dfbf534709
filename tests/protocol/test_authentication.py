import pytest

from protocol.authentication import Authenticator, is_loopback, require_loopback_without_key

KEY = b"k" * 32


@pytest.mark.parametrize("host", ["127.0.0.1", "127.9.9.9", "::1", "[::1]", "localhost", "::ffff:127.0.0.1"])
def test_loopback_needs_no_key(host: str) -> None:
    assert is_loopback(host)
    require_loopback_without_key(host, None)


@pytest.mark.parametrize(
    "host", ["192.168.1.7", "0.0.0.0", "::", "8.8.8.8", "::ffff:10.0.0.1", "localhost.evil.example", ""]
)
def test_another_machine_needs_one(host: str) -> None:
    with pytest.raises(ValueError, match="without a key"):
        require_loopback_without_key(host, None)
    require_loopback_without_key(host, KEY)


def test_key_and_direction_make_the_mac() -> None:
    up, down = Authenticator(KEY, "up"), Authenticator(KEY, "down")
    macs = {up.mac(b"data"), down.mac(b"data"), Authenticator(None, "up").mac(b"data"), up.mac(b"date")}
    assert len(macs) == 4
    assert up.is_genuine(b"data" + up.mac(b"data"))
    assert not down.is_genuine(b"data" + up.mac(b"data"))


@pytest.mark.parametrize("key", [b"", b"k" * 15, b"k" * 65])
def test_a_key_of_a_wrong_length_is_not_shown(key: bytes) -> None:
    with pytest.raises(ValueError, match="allowed 16 to 64") as caught:
        Authenticator(key, "up")
    assert "kkk" not in str(caught.value)
