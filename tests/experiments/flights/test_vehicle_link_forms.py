"""A lockstep flight is the same to the bit whether the vehicle's frames carry their fields or are read from bytes."""

from typing import Any

import numpy as np
import pytest

from experiments.flights.lockstep_flight import LockstepOutcome, fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.cores import CORES
from protocol.mavlink.frames import FrameBytes, FrameReader, FrameWriter, Message

FAULTS = (
    "vehicle.disturbances=[{kind: sensor_fault, sensor: imu, fault: silent, onset_s: 5.0, end_s: 5.05}, "
    "{kind: sensor_fault, sensor: flow, fault: frozen, onset_s: 5.5}, {kind: clock_jump, onset_s: 6.0, jump_s: 1.0}]"
)
WIRE = (
    "vehicle.impairment={both: {delay_s: 0.004, jitter_s: 0.002, loss: 0.03, corruption: 0.02, duplication: 0.02, "
    "reordering: 0.02}}"
)
FLIGHTS: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "wind": ("figure8_wind", "l1", ()),
    "chip": ("rotor_chip", "mrac", ()),
    "faults": ("figure8_wind", "pid", (FAULTS,)),
    "impaired wire": ("hover", "bias", (WIRE,)),
}


def fly(name: str, core: str) -> LockstepOutcome:
    scenario, controller, assignments = FLIGHTS[name]
    return fly_lockstep(resolve(scenario, Choices(controller, 5, 7.0, assignments)), core=core)


@pytest.mark.parametrize("core", CORES)
@pytest.mark.parametrize("name", FLIGHTS)
def test_frames_and_bytes_give_the_same_flight(name: str, core: str, monkeypatch: pytest.MonkeyPatch) -> None:
    carried: list[bool] = []
    read = FrameReader.read

    def noting(self: FrameReader, datagram: bytes, now_ns: int) -> Any:
        carried.append(type(datagram) is FrameBytes)
        return read(self, datagram, now_ns)

    monkeypatch.setattr(FrameReader, "read", noting)
    by_frames = fly(name, core)
    assert sum(carried) > 0.9 * len(carried) > 0
    carried.clear()
    write = FrameWriter.write

    def plain(self: FrameWriter, message: Message, now_ns: int) -> bytes:
        return bytes(bytearray(write(self, message, now_ns)))

    monkeypatch.setattr(FrameWriter, "write", plain)
    by_bytes = fly(name, core)
    assert not any(carried)
    assert by_frames.trace_sha256 == by_bytes.trace_sha256
    assert by_frames.events == by_bytes.events
    assert by_frames.onboard == by_bytes.onboard
    assert by_frames.crash_reason == by_bytes.crash_reason
    for one, other in ((by_frames.trace.tick, by_bytes.trace.tick), (by_frames.trace.truth, by_bytes.trace.truth)):
        np.testing.assert_array_equal(one.rows, other.rows)
