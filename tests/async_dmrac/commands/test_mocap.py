"""Poses that waited in the relay are dropped: offboard would take them for later ones."""

import time
from types import SimpleNamespace
from typing import Any

import pytest

from async_dmrac.commands import mocap
from async_dmrac.commands.mocap import HELD_UP_NS, held_up
from protocol.keys import write_key
from runtime.sockets import Stamped

FAR_NS = 3_600_000_000_000


def test_a_pose_may_wait_no_longer_than_offboard_reckons_with() -> None:
    assert not held_up(0, HELD_UP_NS)
    assert held_up(0, HELD_UP_NS + 1)


@pytest.mark.parametrize(("age_ns", "signed"), [(-FAR_NS, 1), (FAR_NS, 0)])
def test_the_relay_drops_what_waited(age_ns: int, signed: int, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    key = tmp_path / "capture.key"
    write_key(key)
    stop, taken = SimpleNamespace(count=0), list[bytes]()

    class Socket:
        unsent = 0

        def __init__(self, *_: Any) -> None: ...

        def receive_stamped(self, limit: int) -> list[Stamped]:
            stop.count = 1
            return [Stamped(b"pose", time.monotonic_ns() - age_ns)]

        def close(self) -> None: ...

    class Signer:
        def __init__(self, *_: Any) -> None:
            self.signed, self.rejected = 0, SimpleNamespace(total=lambda: 0)

        def sign(self, datagram: bytes, now_ns: int) -> list[bytes]:
            taken.append(datagram)
            return []

    for name, stand_in in (("StopRequest", lambda: stop), ("CaptureSigner", Signer), ("DatagramSocket", Socket)):
        monkeypatch.setattr(mocap, name, stand_in)
    monkeypatch.setattr(mocap.select, "select", lambda *_: None)
    addresses = {"listen": "127.0.0.1:18931", "offboard": "127.0.0.1:18932"}
    assert mocap.run(SimpleNamespace(**addresses, capture_key_file=str(key), json=True)) == 0  # type: ignore[arg-type]
    assert len(taken) == signed
