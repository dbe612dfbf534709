"""A recording of the motions of dmrac mambo check, made through the library by a stand-in with a scripted vehicle."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from mambo.build import Built
from mambo.check import BACK, BACKWARD, FORWARD, LIFTED, MOTIONS, NOSE_DOWN, RIGHT_DOWN, RIGHTWARD, SLOT_S, TURNED
from mambo.fake.wire import Calls, FlowCall, Sensors, encode_request
from tests.mambo.rig import GRAVITY, PERIOD_NS, Rig, board, write

TILT_RAD = 0.75
TURN_RAD = 1.5
MOVE_S = 2.0
"""Each motion begins a second after its slot."""

Spoil = Callable[[Sensors], Sensors]
SpoilFlow = Callable[[FlowCall], FlowCall | None]


def pose_at(time_s: float) -> tuple[float, float, float, float, float]:
    """Roll, pitch, rates p, q, r of the script."""
    slot, within = divmod(time_s, SLOT_S)
    share = min(max((within - 1.0) / MOVE_S, 0.0), 1.0)
    rate = 1.0 / MOVE_S if 0.0 < share < 1.0 else 0.0
    match int(slot):
        case n if n == NOSE_DOWN:
            return 0.0, -TILT_RAD * share, 0.0, -TILT_RAD * rate, 0.0
        case n if n == NOSE_DOWN + 1:
            return 0.0, -TILT_RAD * (1.0 - share), 0.0, TILT_RAD * rate, 0.0
        case n if n == RIGHT_DOWN:
            return TILT_RAD * share, 0.0, TILT_RAD * rate, 0.0, 0.0
        case n if n == RIGHT_DOWN + 1:
            return TILT_RAD * (1.0 - share), 0.0, -TILT_RAD * rate, 0.0, 0.0
        case n if n == TURNED:
            return 0.0, 0.0, 0.0, 0.0, TURN_RAD * rate
        case n if n == BACK:
            return 0.0, 0.0, 0.0, 0.0, -TURN_RAD * rate
    return 0.0, 0.0, 0.0, 0.0, 0.0


def height_at(time_s: float) -> float:
    slot, within = divmod(time_s, SLOT_S)
    lifted = min(max((within - 1.0) / MOVE_S, 0.0), 1.0)
    return 0.0 if slot < LIFTED else lifted if slot == LIFTED else 1.0 if slot < len(MOTIONS) - 1 else 1.0 - lifted


def velocity_at(time_s: float) -> tuple[float, float]:
    slot, within = divmod(time_s, SLOT_S)
    speed = 0.25 if 1.0 < within < 1.0 + MOVE_S else 0.0
    return {FORWARD: (speed, 0.0), BACKWARD: (-speed, 0.0), RIGHTWARD: (0.0, speed)}.get(int(slot), (0.0, 0.0))


def record(
    built: Built,
    folder: Path,
    spoil: Spoil = lambda sensors: sensors,
    spoil_flow: SpoilFlow = lambda flow: flow,
    period_ns: int = PERIOD_NS,
) -> Path:
    """Record all motions in mode record; returns the file."""
    write(folder, board("record"))
    rig, noise = Rig(built, folder), np.random.default_rng(7)
    with rig.process:
        count = int(SLOT_S * len(MOTIONS) * 1e9 / period_ns)
        for index in range(count):
            time_s = index * period_ns * 1e-9
            roll, pitch, p, q, r = pose_at(time_s)
            force = GRAVITY * np.array([np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)])
            height_m = height_at(time_s)
            sensors = Sensors(
                force + 0.2 * noise.standard_normal((5, 3)),
                np.array([p, q, r]) + 0.02 + 0.01 * noise.standard_normal((5, 3)),
                101325.0 - 11.6 * height_m + noise.standard_normal(),
                max(0.44, height_m) + 0.002 * noise.standard_normal(),
                4.0,
                90,
            )
            flow = spoil_flow(FlowCall((*velocity_at(time_s), 0.0), 1, 0.8)) if index % 3 == 0 else None
            calls = Calls.CONTROL | Calls.IMAGE | (Calls.FLOW if flow else Calls(0))
            rig.now_ns += period_ns
            sent = spoil(sensors)
            answer = rig.process.call(
                encode_request(rig.now_ns, 0, 0, calls, sent, flow or FlowCall((0.0, 0.0, 0.0), 0, 0.0))
            )
            assert answer.word == 2  # STOP: the motors never run
            assert answer.speeds == (0, 0, 0, 0)
    return folder / "dmrac.rec"
