import pytest

from protocol.authentication import Authenticator

KEY = b"k" * 32


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
