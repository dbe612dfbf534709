"""Requests and answers of the stand-in for the firmware, as mambo/fake/firmware.c reads and writes them."""

import struct
from enum import IntFlag
from typing import Final, NamedTuple

import numpy as np

from onboard.record.tick import TICK
from protocol.conventions import Array
from protocol.statistics import REJECTIONS

FIFO_SAMPLES: Final = 5
DROPPED: Final = ("imu", "flow", "range", "pressure", "battery")
"""Readings that the library dropped, in its order (mambo/library/readings.h)."""
VIEW: Final = (
    *("state", "mode", "check", "stage", "calls", "missed", "twice", "late", "over_budget", "left_out", "version"),
    *("swaps", "refusals", "taken_back", "samples_taken", "samples_dropped", "samples_repeated"),
    *(f"dropped_{name}" for name in DROPPED),
    *(f"rejected_{name}" for name in REJECTIONS),
)
"""Whole numbers of mambo/library/view.h, in its order."""
REQUEST: Final = struct.Struct(f"<3qi{2 * 3 * FIFO_SAMPLES}f3fI3fif")
ANSWER_HEAD: Final = struct.Struct("<i4hii4x")
EVENT: Final = struct.Struct("<q104s")
ANSWER_BYTES: Final = ANSWER_HEAD.size + 8 * len(VIEW) + 8 * len(TICK.fields)
REFUSED: Final = 1
"""State of a library that has refused its configuration."""


class Calls(IntFlag):
    """What the firmware does in a request."""

    CONTROL = 1
    FLOW = 2
    TWICE = 4
    """Calls the library twice in a row."""
    STOPS_MOTORS = 8
    """Writes STOP over the library's command before the call."""
    FREEZES = 16
    """Gives the last acquisition again."""
    IMAGE = 32


class Sensors(NamedTuple):
    """What the acquisition structure holds, in the firmware's axes and units."""

    accelerometer: Array
    """[5, 3], m/s^2, the newest last."""
    gyroscope: Array
    """[5, 3], rad/s."""
    pressure_pa: float
    altitude_m: float
    battery_v: float
    battery_percent: int


class FlowCall(NamedTuple):
    """Arguments of RSEDU_optical_flow."""

    velocity: tuple[float, float, float]
    """m/s, the firmware's axes."""
    defined: int
    quality: float


class Answer(NamedTuple):
    """What the library did."""

    word: int
    """Motor word: 1 START, 2 STOP, 3 RUN."""
    speeds: tuple[int, int, int, int]
    """Motors 1 to 4 of the firmware."""
    ultrasound: int
    view: dict[str, int]
    """Per VIEW."""
    tick: Array
    """Per onboard.record.tick.TICK."""
    events: list[tuple[int, str]]


NO_FLOW: Final = FlowCall((0.0, 0.0, 0.0), 0, 0.0)


def encode_request(
    now_ns: int, wall_ns: int, spent_ns: int, calls: Calls, sensors: Sensors, flow: FlowCall = NO_FLOW
) -> bytes:
    """A request.

    now_ns: the firmware's monotonic clock. wall_ns: since 1970. spent_ns: that the call takes.
    """
    floats = (*sensors.accelerometer.ravel().tolist(), *sensors.gyroscope.ravel().tolist(), *sensors[2:5])
    return REQUEST.pack(
        *(now_ns, wall_ns, spent_ns, calls, *floats, sensors.battery_percent),
        *(*flow.velocity, flow.defined, flow.quality),
    )


def decode_answer(data: bytes, events: bytes) -> Answer:
    """An answer. events: the texts that followed."""
    word, *speeds, ultrasound, _ = ANSWER_HEAD.unpack_from(data)
    first = ANSWER_HEAD.size
    numbers = struct.unpack_from(f"<{len(VIEW)}q", data, first)
    tick = np.frombuffer(data, "<f8", len(TICK.fields), first + 8 * len(VIEW)).copy()
    texts = [(when, text.split(b"\0")[0].decode()) for when, text in EVENT.iter_unpack(events)]
    s1, s2, s3, s4 = speeds
    return Answer(word, (s1, s2, s3, s4), ultrasound, dict(zip(VIEW, numbers, strict=True)), tick, texts)


def event_count(data: bytes) -> int:
    """Number of texts that follow the fixed part of an answer."""
    count: int = ANSWER_HEAD.unpack_from(data)[-1]
    return count
