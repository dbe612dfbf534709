"""Finds each axis, sign, unit and rate of the drone's sensors from a recording of motions that a person makes.

The motions follow each other in slots of SLOT_S, counted from the beginning of the recording. What is wrong is named
with what the settings should say; a recording without fault clears the vehicle for the mode fly, with these settings.
"""

import json
from collections.abc import Callable, Iterator
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from configs.loader import ConfigError
from mambo.config import BoardConfig
from mambo.recording import Body, Recording, in_body_axes
from protocol.conventions import GRAVITY, Array

SLOT_S: Final = 6.0
MOTIONS: Final = (
    "leave the drone level and still on the floor",
    "tilt its nose down by about 45 degrees and hold",
    "put it level again and hold",
    "tilt its right side down by about 45 degrees and hold",
    "put it level again and hold",
    "turn it clockwise, seen from above, by a quarter turn and hold",
    "turn it back and hold",
    "lift it, level, to about 1 m above the floor and hold",
    "move it forward by about half a metre and hold",
    "move it back and hold",
    "move it to the right by about half a metre and hold",
    "move it back, put it on the floor, and wait",
)
STILL, NOSE_DOWN, LEVEL, RIGHT_DOWN, LEVEL_2, TURNED, BACK, LIFTED, FORWARD, BACKWARD, RIGHTWARD, END = range(12)
MOTORS: Final = ("front left", "front right", "rear right", "rear left")
"""Where the firmware's motors 1 to 4 must be, with the order of configs/mambo.yaml."""
TILT_MIN_M_S2: Final = 3.0
"""Least change of the force along an axis that a tilt gives."""
TURN_MIN_RAD: Final = 0.5
LIFT_M: Final = (0.25, 2.5)
MOVE_M: Final = (0.15, 2.0)
PRESSURE_PA: Final = (2.0, 40.0)
"""By which the pressure falls when it is lifted."""
RATE_TOLERANCE: Final = 0.1
GAP_MAX_S: Final = 0.04
TURN_SHARE: Final = (0.6, 1.6)
"""Integrated rate over the angle that gravity tells."""


class Fault(NamedTuple):
    """Something that must not fly."""

    what: str
    text: str


class Slots:
    """A recording in body axes, cut into its slots."""

    def __init__(self, body: Body) -> None:
        self._body = body
        still = self._within(body.time_s, STILL, 1.0)
        self.bias: Array = body.rates[still].mean(axis=0) if still.any() else np.zeros(3)

    def _within(self, time_s: Array, slot: int, settle_s: float = 4.0) -> NDArray[np.bool_]:
        """Samples of a slot, without its first seconds, in which the motion is made."""
        start = slot * SLOT_S
        within: NDArray[np.bool_] = (time_s >= start + settle_s) & (time_s < start + SLOT_S)
        return within

    def force(self, slot: int) -> Array:
        """[3] m/s^2, while it is held."""
        mean: Array = self._body.force[self._within(self._body.time_s, slot)].mean(axis=0)
        return mean

    def turned(self, slot: int) -> Array:
        """[3] rad, integrated rates over a slot, without the bias at rest."""
        within = self._within(self._body.time_s, slot, 0.0)
        step_s = np.diff(self._body.time_s[within], prepend=slot * SLOT_S)
        angle: Array = ((self._body.rates[within] - self.bias) * step_s[:, None]).sum(axis=0)
        return angle

    def altitude_m(self, slot: int) -> float:
        """Median, while it is held."""
        return float(np.median(self._body.altitude_m[self._within(self._body.time_s, slot)]))

    def pressure_pa(self, slot: int) -> float:
        """Mean, while it is held."""
        return float(self._body.pressure_pa[self._within(self._body.time_s, slot)].mean())

    def moved(self, slot: int) -> Array:
        """[2] m, integrated flow over a slot."""
        within = self._within(self._body.flow_s, slot, 0.0)
        step_s = np.diff(self._body.flow_s[within], prepend=slot * SLOT_S)
        distance: Array = (self._body.velocity[within] * np.minimum(step_s, 0.1)[:, None]).sum(axis=0)
        return distance


def faults_of(recording: Recording, board: BoardConfig) -> list[Fault]:
    """All that is wrong. Raises ConfigError if the recording is too short for the motions."""
    body, needed_s = in_body_axes(recording, board), SLOT_S * len(MOTIONS)
    seconds = float(body.time_s[-1]) if len(body.time_s) else 0.0
    if seconds < needed_s - SLOT_S:
        raise ConfigError(f"recording of {seconds:.0f} s, the motions of dmrac mambo check take {needed_s:.0f} s")
    slots = Slots(body)
    checks: tuple[Callable[[], Iterator[Fault]], ...] = (
        lambda: _calls(body),
        lambda: _stuck(recording, board, body),
        lambda: _rest(slots),
        lambda: _tilts(slots),
        lambda: _turn(slots),
        lambda: _lift(slots),
        lambda: _moves(slots, body),
        lambda: _battery(body),
    )
    return [fault for check in checks for fault in check()]


def _calls(body: Body) -> Iterator[Fault]:
    gaps_s = np.diff(body.time_s)
    rate_hz = len(gaps_s) / float(gaps_s.sum())
    if abs(rate_hz / 200.0 - 1.0) > RATE_TOLERANCE:
        yield Fault("calls", f"the firmware calls at {rate_hz:.0f} Hz, expected 200")
    if gaps_s.max() > GAP_MAX_S:
        yield Fault("calls", f"a gap of {gaps_s.max() * 1e3:.0f} ms between two calls, allowed {GAP_MAX_S * 1e3:.0f}")


def _stuck(recording: Recording, board: BoardConfig, body: Body) -> Iterator[Fault]:
    for name, values in (("accelerometer", body.force), ("gyroscope", body.rates)):
        for axis in np.flatnonzero(np.ptp(values, axis=0) == 0.0):
            yield Fault(name, f"{name} {'xyz'[axis]} never changes: stuck, or sensors.imu or layout is wrong")
    for name, one in (("altitude", body.altitude_m), ("pressure", body.pressure_pa)):
        if np.ptp(one) == 0.0:
            yield Fault(name, f"{name} never changes: stuck, or layout.{name} is wrong")
    if len(body.flow_s) == 0:
        yield Fault("flow", "the firmware never called RSEDU_optical_flow")
    if board.sensors.imu == "fifo":
        raw = recording.samples.values
        difference = raw["fifo_accelerometer"].mean(axis=(0, 1)) - raw["accelerometer"].mean(axis=0)
        if np.abs(difference).max() > 1.0:
            text = "FIFO and single accelerometer differ in their means: layout.fifo_accelerometer is wrong,"
            yield Fault("accelerometer", f"{text} or use sensors.imu=single")


def _rest(slots: Slots) -> Iterator[Fault]:
    force = slots.force(STILL)
    size = float(np.linalg.norm(force))
    if abs(size - GRAVITY) > 1.5:
        factor = GRAVITY / size if size > 0.0 else 0.0
        yield Fault("accelerometer", f"{size:.3g} m/s^2 at rest, expected 9.81: unit? times {factor:.3g} would fit")
    axis = int(np.argmax(np.abs(force)))
    if axis != 2:
        yield Fault("accelerometer", f"gravity is on body {'xyz'[axis]}, expected z: sensors.accelerometer_axes")
    elif force[2] > 0.0:
        yield Fault("accelerometer", "body z is positive at rest, expected negative: wrong sign of z")
    if np.abs(slots.bias).max() > 0.3:
        yield Fault("gyroscope", f"a rate of {np.abs(slots.bias).max():.2g} rad/s at rest: unit, or it was moved")


class Tilt(NamedTuple):
    """What a tilt must show: the force along `axis` becomes negative, the angle about `about` has `sign`."""

    slot: int
    name: str
    axis: int
    about: int
    sign: float


TILTS: Final = (Tilt(NOSE_DOWN, "nose down", 0, 1, -1.0), Tilt(RIGHT_DOWN, "right side down", 1, 0, 1.0))


def _tilts(slots: Slots) -> Iterator[Fault]:
    level = slots.force(STILL)
    for tilt in TILTS:
        change, turned = slots.force(tilt.slot) - level, slots.turned(tilt.slot)
        axis, about = "xyz"[tilt.axis], "xyz"[tilt.about]
        across = change[1 - tilt.axis]
        if abs(change[tilt.axis]) < max(TILT_MIN_M_S2, abs(across)):
            yield Fault("accelerometer", f"{tilt.name}: body {axis} does not show it: axes swapped, or not tilted")
        elif change[tilt.axis] > 0.0:
            yield Fault("accelerometer", f"{tilt.name}: wrong sign of body {axis}")
        if abs(turned[tilt.about]) < max(0.3, np.abs(np.delete(turned, tilt.about)).max()):
            yield Fault("gyroscope", f"{tilt.name}: body {about} does not show it: axes swapped, unit, or not tilted")
            continue
        if turned[tilt.about] * tilt.sign < 0.0:
            yield Fault("gyroscope", f"{tilt.name}: wrong sign of body {about}")
        angle = float(np.arcsin(np.clip(abs(change[tilt.axis]) / GRAVITY, 0.0, 1.0)))
        share = abs(turned[tilt.about]) / max(angle, 0.1)
        if not TURN_SHARE[0] <= share <= TURN_SHARE[1]:
            yield Fault("gyroscope", f"{tilt.name}: {share:.2g} times gravity's angle: unit of body {about}")


def _turn(slots: Slots) -> Iterator[Fault]:
    turned = slots.turned(TURNED)
    if abs(turned[2]) < max(TURN_MIN_RAD, np.abs(turned[:2]).max()):
        yield Fault("gyroscope", "clockwise turn: body z does not show it: axes swapped, unit, or not turned")
    elif turned[2] < 0.0:
        yield Fault("gyroscope", "clockwise turn: wrong sign of body z")
    elif turned[2] > 4.0:
        yield Fault("gyroscope", f"a quarter turn gives {turned[2]:.2g} rad: unit of body z")


def _lift(slots: Slots) -> Iterator[Fault]:
    lifted_m = slots.altitude_m(LIFTED) - slots.altitude_m(STILL)
    if not LIFT_M[0] <= lifted_m <= LIFT_M[1]:
        text = "wrong sign, unit, or the sensor is off" if lifted_m < LIFT_M[0] else "unit"
        yield Fault("altitude", f"lifted by about 1 m, the altitude changes by {lifted_m:+.3g} m: {text}")
    fallen_pa = slots.pressure_pa(STILL) - slots.pressure_pa(LIFTED)
    if not PRESSURE_PA[0] <= fallen_pa <= PRESSURE_PA[1]:
        yield Fault("pressure", f"lifted by about 1 m, the pressure falls by {fallen_pa:+.3g} Pa, expected 12")
    pressure_pa = slots.pressure_pa(STILL)
    if not 30_000.0 <= pressure_pa <= 120_000.0:
        yield Fault("pressure", f"{pressure_pa:.4g} Pa, expected about 101000: unit or layout.pressure")


def _moves(slots: Slots, body: Body) -> Iterator[Fault]:
    if len(body.flow_s) == 0:
        return
    for slot, name, axis in ((FORWARD, "forward", 0), (RIGHTWARD, "to the right", 1)):
        moved_m = slots.moved(slot)
        if abs(moved_m[axis]) < max(MOVE_M[0], abs(moved_m[1 - axis])):
            yield Fault("flow", f"moved {name}: body {'xy'[axis]} does not show it: axes swapped, unit, or not moved")
        elif moved_m[axis] < 0.0:
            yield Fault("flow", f"moved {name}: wrong sign of body {'xy'[axis]}")
        elif moved_m[axis] > MOVE_M[1]:
            yield Fault("flow", f"moved {name} by half a metre, the flow gives {moved_m[axis]:.2g} m: unit")


def _battery(body: Body) -> Iterator[Fault]:
    voltage_v, percent = float(np.median(body.battery_v)), float(np.median(body.battery_percent))
    if not 2.5 <= voltage_v <= 4.5:
        yield Fault("battery", f"{voltage_v:.3g} V, expected 3.0 to 4.35: unit or layout.battery_voltage")
    if not 0.0 < percent <= 100.0:
        yield Fault("battery", f"{percent:.3g} per cent, expected 1 to 100: layout.battery_percent")


def motor_faults(answers: list[str]) -> list[Fault]:
    """What a person saw in mode bench, of the motors in the order in which they turned, against where they must be."""
    return [
        Fault("motors", f"motor {number} of the firmware is {answer or 'not seen'}, expected {place}: motors.order")
        for number, (answer, place) in enumerate(zip(answers, MOTORS, strict=True), start=1)
        if answer != place
    ]


# --- the certificate ---


def settings_digest(board: BoardConfig) -> str:
    """What a check is valid for: places, axes, units and motors."""
    checked = {name: getattr(board, name).model_dump(mode="json") for name in ("layout", "sensors", "motors")}
    return blake2b(json.dumps(checked, sort_keys=True).encode(), digest_size=16).hexdigest()


def write_certificate(path: Path, board: BoardConfig, faults: list[Fault], recording: Path) -> None:
    """Write the result of a check as JSON."""
    content: dict[str, Any] = {
        "settings": settings_digest(board),
        "recording": recording.name,
        "passed": not faults,
        "faults": [fault._asdict() for fault in faults],
    }
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def require_certificate(path: Path, board: BoardConfig) -> None:
    """Raise ConfigError unless a check has passed with the same settings."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        passed, settings = content["passed"] is True, content["settings"]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; run dmrac mambo check first") from None
    except (ValueError, KeyError, TypeError):
        raise ConfigError(f"{path}: is not a result of dmrac mambo check") from None
    if not passed:
        raise ConfigError(f"{path}: the check has not passed; correct the settings and check again")
    if settings != settings_digest(board):
        raise ConfigError(f"{path}: the check was made with other settings (layout, sensors or motors); check again")
