"""The library in the stand-in under the address and undefined behaviour sanitizers, with bad datagrams."""

import socket
from pathlib import Path

import numpy as np
import pytest

from mambo.build import build, compile_inside, native_target
from mambo.fake.firmware_process import FirmwareProcess
from onboard.c.compile import BuildError
from tests.mambo.rig import OWN_PORT, Rig, board, write

OPTIONS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


@pytest.mark.full
def test_a_run_with_bad_datagrams_finds_nothing(tmp_path: Path) -> None:
    target = native_target()
    firmware = tmp_path / "firmware"
    try:
        compile_inside(target._replace(options=OPTIONS), firmware, ())
    except BuildError as error:
        pytest.skip(str(error).splitlines()[-1])
    write(tmp_path, board())
    built = build("native")
    rng = np.random.default_rng(5)
    rig = Rig(built, tmp_path)
    rig.process.close()
    rig.process = FirmwareProcess(built, tmp_path, lambda _: [str(firmware), "inside"])
    with rig.process, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 14573))
        for _ in range(3000):
            peer.sendto(rng.bytes(int(rng.integers(0, 1400))), ("127.0.0.1", OWN_PORT))
            answer = rig.call()
        assert answer.view["rejected_version"] + answer.view["rejected_length"] > 1000
