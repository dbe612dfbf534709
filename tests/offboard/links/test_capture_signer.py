"""Unsigned poses in, signed ones out, which a keyed relay takes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from offboard.config import PoseRelayConfig
from offboard.links.capture_signer import CaptureSigner
from offboard.links.pose_relay import PoseRelay
from protocol.keys import read_key, write_key
from protocol.mavlink.frames import FrameWriter
from protocol.mavlink.motion_capture import encode_odometry, odometry_covariances
from protocol.mavlink.signing import SigningClock
from protocol.mavlink.vehicle import encode_heartbeat
from runtime.sockets import DatagramSocket

KEY = bytes(range(32))
MS, UTC_NS = 10**6, 1_750_000_000 * 10**9
ROOT = Path(__file__).resolve().parents[3]


def unsigned(index: int) -> bytes:
    pose = ((0.01 * index, 0.0, -1.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    return FrameWriter(9, 1).write(encode_odometry(index * 10_000, *pose, odometry_covariances(1e-6, 1e-6, 1e-4)), 0)


def keyed_relay(key: bytes, utc_ns: int) -> PoseRelay:
    return PoseRelay(PoseRelayConfig(latency_s=0.0), key, SigningClock(utc_ns))


def test_a_keyed_relay_takes_what_was_signed_and_nothing_else() -> None:
    signer, relay = CaptureSigner(KEY, SigningClock(UTC_NS)), keyed_relay(KEY, UTC_NS)
    for index in range(1, 20):
        now_ns = index * 10 * MS
        assert relay.receive(unsigned(index), now_ns) is None
        (signed,) = signer.sign(unsigned(index), now_ns)
        pose = relay.receive(signed, now_ns)
        assert pose is not None
        assert pose.position_ned_m[0] == pytest.approx(0.01 * index)
        assert relay.receive(signed, now_ns) is None
    assert relay.rejected == {"unsigned": 19, "signature_replayed": 19}


def test_what_is_no_pose_is_not_signed() -> None:
    signer = CaptureSigner(KEY, SigningClock(UTC_NS))
    heartbeat = FrameWriter(9, 1).write(encode_heartbeat(0, 0, 0, False, 0), 0)
    for datagram in (b"", heartbeat, unsigned(1)[:-1], bytes(281)):
        assert signer.sign(datagram, 0) == []
    assert signer.signed == 0
    assert signer.rejected.total() == 4


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--offboard", "127.0.0.1:1", "--listen", "0.0.0.0:14575"), "must come from this machine"),
        (("--offboard", "nowhere"), "--offboard nowhere: expected HOST:PORT"),
    ],
)
def test_bad_options_are_named(
    words: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from async_dmrac.command_line import main

    write_key(tmp_path / "capture.key")
    assert main(["mocap", *words, "--capture-key-file", str(tmp_path / "capture.key")]) == 2
    assert said in capsys.readouterr().err


def test_the_command_relays_over_udp(tmp_path: Path) -> None:
    write_key(tmp_path / "capture.key")
    offboard = DatagramSocket("offboard", "127.0.0.1:0", None)
    probe = DatagramSocket("probe", "127.0.0.1:0", None)
    listen = probe.local_address
    probe.close()
    words = ("mocap", "--listen", listen, "--offboard", offboard.local_address)
    command = (sys.executable, "-m", "async_dmrac", *words, "--capture-key-file", str(tmp_path / "capture.key"))
    process = subprocess.Popen(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        while b"ready" not in process.stdout.readline():
            assert process.poll() is None
        capture = DatagramSocket("capture", "127.0.0.1:0", listen)
        relay, found = keyed_relay(read_key(tmp_path / "capture.key"), time.time_ns() - 10**9), None
        start_ns = time.monotonic_ns()
        for index in range(1, 500):
            capture.send(unsigned(index))
            time.sleep(0.02)
            for datagram in offboard.receive(8):
                found = relay.receive(datagram, time.monotonic_ns() - start_ns + 10**9) or found
            if found is not None:
                break
        assert found is not None
        capture.close()
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(20.0)
        offboard.close()
        process.stdout.close()
    assert process.returncode == 0
