"""BLAKE2b and the MAC of datagrams: the C core against hashlib, RFC 7693 and protocol/authentication.py."""

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from protocol.authentication import KEY_MAX_BYTES, KEY_MIN_BYTES, MAC_BYTES, Authenticator, Direction
from tests.onboard.c.parity import SETTINGS, octets, octets_of

NOBODY = bytes(16)
RNG = np.random.default_rng(1)
EDGES = (0, 1, 3, 16, 63, 64, 65, 127, 128, 129, 255, 256, 257, 383, 384, 1024, 1184, 5000)
DIRECTIONS: dict[Direction, str] = {"up": "DIRECTION_UP", "down": "DIRECTION_DOWN"}


def blake2b(core: Core, size: int, key: bytes, pieces: list[bytes], person: bytes = NOBODY) -> bytes:
    hashing, digest = core.Blake2b(), np.zeros(size, np.uint8)
    core.blake2b_start(hashing, size, octets(key), len(key), octets(person))
    for piece in pieces:
        core.blake2b_add(hashing, octets(piece), len(piece))
    core.blake2b_finish(hashing, digest)
    return octets_of(digest)


@pytest.mark.parametrize("size", [1, 8, 16, 20, 32, 48, 64])
@pytest.mark.parametrize("key_size", [0, 1, 16, 32, 63, 64])
def test_digests_of_all_lengths(core: Core, size: int, key_size: int) -> None:
    lengths = range(400) if (size, key_size) in ((16, 0), (16, 32)) else EDGES
    for length in lengths:
        data, key, person = RNG.bytes(length), RNG.bytes(key_size), RNG.bytes(16)
        expected = hashlib.blake2b(data, digest_size=size, key=key, person=person).digest()
        assert blake2b(core, size, key, [data], person) == expected, length


@SETTINGS
@given(pieces=st.lists(st.binary(max_size=300), max_size=8), key=st.binary(max_size=64))
def test_input_in_pieces(core: Core, pieces: list[bytes], key: bytes) -> None:
    assert blake2b(core, 16, key, pieces) == hashlib.blake2b(b"".join(pieces), digest_size=16, key=key).digest()


def test_the_example_of_rfc_7693(core: Core) -> None:
    """Appendix A."""
    expected = (
        "ba80a53f981c4d0d6a2797b69f12f6e94c212f14685ac4b74b12bb6fdbffa2d1"
        "7d87c5392aab792dc252d5de4533cc9518d38aa8dbf1925ab92386edd4009923"
    )
    assert blake2b(core, 64, b"", [b"abc"]).hex() == expected


def selftest_bytes(size: int, seed: int) -> bytes:
    """RFC 7693, appendix E, selftest_seq: a Fibonacci generator."""
    a, b, out = 0xDEAD4BAD * seed & 0xFFFFFFFF, 1, bytearray()
    for _ in range(size):
        a, b = b, (a + b) & 0xFFFFFFFF
        out.append(b >> 24)
    return bytes(out)


def test_the_self_test_of_rfc_7693(core: Core) -> None:
    """Appendix E: the digest of the digests of 24 lengths, without and with key."""
    digests = b""
    for size in (20, 32, 48, 64):
        for length in (0, 3, 128, 129, 255, 1024):
            data = selftest_bytes(length, length)
            digests += blake2b(core, size, b"", [data]) + blake2b(core, size, selftest_bytes(size, size), [data])
    expected = "c23a7800d98123bd10f506c61e29da5603d763b8bbad2e737f5e765a7bccd475"
    assert blake2b(core, 32, b"", [digests]).hex() == expected


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("key_size", [0, 16, 32, 64])
def test_macs(core: Core, direction: Direction, key_size: int) -> None:
    key, ours, mac = RNG.bytes(key_size), core.Authenticator(), np.zeros(MAC_BYTES, np.uint8)
    theirs = Authenticator(key or None, direction)
    assert core.authenticator_init(ours, octets(key), key_size, getattr(core, DIRECTIONS[direction]))
    for size in (28, 30, 112, 113, 500, 1184):
        data = RNG.bytes(size)
        core.authenticator_mac(ours, octets(data), size, mac)
        assert octets_of(mac) == theirs.mac(data)
        datagram = data + theirs.mac(data)
        assert core.authenticator_is_genuine(ours, octets(datagram), len(datagram))
        for place in (0, size - 1, size, size + MAC_BYTES - 1):
            for bit in range(8):
                forged = bytearray(datagram)
                forged[place] ^= 1 << bit
                assert not core.authenticator_is_genuine(ours, octets(bytes(forged)), len(forged))


def test_a_mac_of_the_other_direction_is_wrong(core: Core) -> None:
    ours, data = core.Authenticator(), bytes(40)
    assert core.authenticator_init(ours, octets(b""), 0, core.DIRECTION_DOWN)
    for direction in DIRECTIONS:
        datagram = data + Authenticator(None, direction).mac(data)
        assert core.authenticator_is_genuine(ours, octets(datagram), len(datagram)) == (direction == "down")


def test_keys_of_another_size_are_refused(core: Core) -> None:
    for size in range(80):
        taken = core.authenticator_init(core.Authenticator(), octets(bytes(size)), size, core.DIRECTION_UP)
        assert taken == (size == 0 or KEY_MIN_BYTES <= size <= KEY_MAX_BYTES)
