"""Poses that waited in the relay are dropped: offboard would take them for later ones."""

import socket
import time
from types import SimpleNamespace
from typing import Any

import pytest

from async_dmrac.commands import mocap
from async_dmrac.commands.mocap import HELD_UP_NS, held_up
from protocol.keys import write_key


def test_a_pose_may_wait_no_longer_than_offboard_reckons_with() -> None:
    assert not held_up(0, HELD_UP_NS)
    assert held_up(0, HELD_UP_NS + 1)


@pytest.mark.parametrize(("allowed_ns", "signed"), [(10**12, 1), (HELD_UP_NS, 0)])
def test_the_relay_drops_what_waited(
    allowed_ns: int, signed: int, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = tmp_path / "capture.key"
    write_key(key)
    stop, sent = SimpleNamespace(count=0), list[bytes]()
    pose = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def readable(*_: Any) -> None:
        if stop.count == 0:
            pose.sendto(b"pose", ("127.0.0.1", 18931))
            time.sleep(0.1)
            stop.count = 1

    class Signer:
        def __init__(self, *_: Any) -> None:
            self.signed, self.rejected = 0, SimpleNamespace(total=lambda: 0)

        def sign(self, datagram: bytes, now_ns: int) -> list[bytes]:
            sent.append(datagram)
            return []

    monkeypatch.setattr(mocap, "HELD_UP_NS", allowed_ns)
    monkeypatch.setattr(mocap, "StopRequest", lambda: stop)
    monkeypatch.setattr(mocap, "CaptureSigner", Signer)
    monkeypatch.setattr(mocap.select, "select", readable)
    addresses = {"listen": "127.0.0.1:18931", "offboard": "127.0.0.1:18932"}
    assert mocap.run(SimpleNamespace(**addresses, capture_key_file=str(key), json=True)) == 0  # type: ignore[arg-type]
    pose.close()
    assert len(sent) == signed
