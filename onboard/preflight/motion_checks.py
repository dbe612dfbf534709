"""Preflight checks for which a person moves the vehicle by hand: axes and signs of IMU, flow, height and pose.

The requested motion is the reference: nose down, right side down, a turn to the right, a lift and a walk forward
determine every axis and sign. In FRD, at rest, the accelerometer reads g (sin pitch, -sin roll cos pitch,
-cos roll cos pitch): nose down makes x negative, right side down makes y negative.
"""

from typing import Final

import numpy as np

from onboard.preflight.checks import LOST, Check, PreflightConfig, Step, absent, frequency, judged, rotation, vector
from onboard.preflight.recorder import StepData
from protocol.conventions import Array

WINDOW_S: Final = 0.5
"""Duration at the beginning and the end of a step in which the vehicle is held still."""
_TURN: Final[dict[Step, tuple[int, float]]] = {
    Step.NOSE_DOWN: (1, -1.0),
    Step.RIGHT_DOWN: (0, 1.0),
    Step.TURN_RIGHT: (2, 1.0),
}
"""Body axis and sign of each turn."""
_FORCE_AXIS: Final = {Step.NOSE_DOWN: 0, Step.RIGHT_DOWN: 1}
"""Axis on which the specific force becomes negative."""
_NAMES: Final = {
    Step.NOSE_DOWN: "nose down",
    Step.RIGHT_DOWN: "right side down",
    Step.TURN_RIGHT: "turn right",
    Step.LIFT: "lift",
    Step.FORWARD: "forward",
}
_LEAST_SAMPLES: Final = 100


def check_motion(step: Step, data: StepData, config: PreflightConfig, with_pose: bool) -> list[Check]:
    """The rows of one step."""
    name = _NAMES[step]
    if len(data.imu_arrival_s) < _LEAST_SAMPLES:
        return [judged(f"{name}: IMU", False, f"{len(data.imu_arrival_s)} samples", "a stream", "the stream stopped")]
    if step is Step.LIFT:
        return _check_lift(data, config, with_pose)
    if step is Step.FORWARD:
        return [_check_forward(data, config)]
    checks = [_check_force(step, data, config)] if step in _FORCE_AXIS else []
    checks.append(_check_rates(step, data, config))
    if step in _FORCE_AXIS:
        checks.append(_check_flow(step, data, config))
    if with_pose:
        checks.append(_check_pose_turn(step, data, config))
    return checks


# -- inertial sensors -------------------------------------------------------------------------------------------------


def _check_force(step: Step, data: StepData, config: PreflightConfig) -> Check:
    """Axis and sign of the accelerometer in a tilt."""
    before, after = _ends(data.imu_arrival_s, data.accelerometer)
    axis, change = _FORCE_AXIS[step], after - before
    level = float(np.hypot(change[0], change[1]))
    tilt = _tilt(data)
    share = float(change[axis]) / max(level, 1e-9)
    other = float(change[1 - axis]) / max(level, 1e-9)
    if tilt < config.tilt_min_rad:
        hint = "the vehicle was hardly tilted, or an axis does not work"
    elif share > 0.8:
        hint = f"sign of accelerometer {'xy'[axis]} is reversed"
    elif abs(other) > 0.8:
        hint = "accelerometer x and y are swapped"
    else:
        hint = f"axes are turned by {np.degrees(np.arctan2(other, -share)):.0f} deg about z"
    good = tilt >= config.tilt_min_rad and share < -0.8
    wanted = f"{'xy'[axis]} becomes negative, tilt of 30 deg"
    measured = f"change {vector(change)} m/s^2, tilt {np.degrees(tilt):.0f} deg"
    return judged(f"{_NAMES[step]}: accelerometer", good, measured, wanted, hint)


def _check_rates(step: Step, data: StepData, config: PreflightConfig) -> Check:
    """Axis, sign and unit of the gyroscope: its integrated angle, in a tilt against the accelerometer's."""
    axis, sign = _TURN[step]
    angles = _turned(data)
    about = float(angles[axis]) * sign
    truth = _tilt(data) if step in _FORCE_AXIS else 0.5 * np.pi
    low, high = (1.0 - config.angle_tolerance) * truth, (1.0 + config.angle_tolerance) * truth
    if step is Step.TURN_RIGHT:
        low, high = config.turn_min_rad, np.pi
    largest = int(np.argmax(np.abs(angles)))
    ratio = about / max(truth, 1e-9)
    if largest != axis:
        hint = f"the rotation is on {'xyz'[largest]}: gyroscope axes are swapped"
    elif about < 0.0:
        hint = f"sign of gyroscope {'xyz'[axis]} is reversed"
    elif 30.0 < ratio < 90.0:
        hint = "rates seem to be in degrees per second, not rad/s"
    elif data.rejected["gyroscope"]:
        hint = "rates were too large and dropped: unit of the gyroscope?"
    else:
        hint = f"gyroscope gives {ratio:.2g} times the angle: scale, lost samples, or not moved as requested"
    good = largest == axis and low <= about <= high and truth >= config.tilt_min_rad
    sums = vector(np.degrees(angles))
    wanted = f"{'+' if sign > 0 else '-'}{np.degrees(truth):.0f} deg about {'xyz'[axis]}"
    return judged(f"{_NAMES[step]}: gyroscope", good, f"{sums} deg", wanted, hint)


def _check_flow(step: Step, data: StepData, config: PreflightConfig) -> Check:
    """The gyro sums of the flow sensor must equal the IMU's, or rotation would be taken as motion."""
    name = f"{_NAMES[step]}: flow's gyro"
    if len(data.flow) < 10:
        return judged(name, False, f"{len(data.flow)} frames", "flow frames", "no HIL_OPTICAL_FLOW")
    axis, _ = _TURN[step]
    summed, expected = float(data.flow[:, 2 + axis].sum()), float(_turned(data)[axis])
    good = abs(summed - expected) <= config.angle_tolerance * max(abs(expected), config.tilt_min_rad)
    measured = f"{np.degrees(summed):.0f} deg about {'xy'[axis]}"
    hint = f"integrated_{'xy'[axis]}gyro does not follow the IMU: sign, axis or unit"
    return judged(name, good, measured, f"the IMU's {np.degrees(expected):.0f} deg", hint)


# -- pose -------------------------------------------------------------------------------------------------------------


def _check_pose_turn(step: Step, data: StepData, config: PreflightConfig) -> Check:
    """Rotation of the pose in body axes against the requested one and the IMU's."""
    name = f"{_NAMES[step]}: pose"
    if len(data.pose_s) < 10:
        return judged(name, False, f"{len(data.pose_s)} poses", "poses", LOST)
    axis, sign = _TURN[step]
    truth = _tilt(data) if step in _FORCE_AXIS else abs(float(_turned(data)[2]))
    expected = np.zeros(3)
    expected[axis] = sign * truth
    turn = _pose_turn(data)
    tolerance = max(config.pose_angle_tolerance_rad, config.angle_tolerance * truth)
    good = truth >= config.tilt_min_rad and float(np.linalg.norm(turn - expected)) <= tolerance
    hint = "the pose's frame is not NED with an FRD body"
    if float(np.linalg.norm(_pose_turn(data, (3, 0, 1, 2)) - expected)) <= tolerance:
        hint = "the quaternion is x, y, z, w; it must have w first"
    elif float(np.linalg.norm(_pose_turn(data, inverse=True) - expected)) <= tolerance:
        hint = "the quaternion is world to body; it must be body to world"
    elif float(np.linalg.norm(turn + expected)) <= tolerance:
        hint = f"the rotation about {'xyz'[axis]} is reversed: the pose's axes are not FRD"
    elif int(np.argmax(np.abs(turn))) != axis:
        hint = f"the pose turns about {'xyz'[int(np.argmax(np.abs(turn)))]}: its axes are swapped"
    wanted = f"{np.degrees(sign * truth):+.0f} deg about {'xyz'[axis]}"
    return judged(name, good, f"{vector(np.degrees(turn))} deg", wanted, hint)


def _check_forward(data: StepData, config: PreflightConfig) -> Check:
    """The pose's position moves in the direction of the nose of its attitude."""
    name, wanted = "forward: pose", "forward in the pose's own heading"
    if len(data.pose_s) < 10:
        return judged(name, False, f"{len(data.pose_s)} poses", wanted, LOST)
    before, after = _ends(data.pose_s, data.poses)
    nose = rotation(before[3:7])[:, 0]
    heading = float(np.arctan2(nose[1], nose[0]))
    moved = after[:2] - before[:2]
    length = float(np.hypot(*moved))
    off = float(np.angle(np.exp(1j * (np.arctan2(moved[1], moved[0]) - heading))))
    good = length >= config.lift_min_m and abs(off) < 0.5
    hint = "hardly moved" if length < config.lift_min_m else "position and attitude are not in one frame"
    return judged(name, good, f"{length:.2f} m, {np.degrees(off):+.0f} deg off the nose", wanted, hint)


# -- height -----------------------------------------------------------------------------------------------------------


def _check_lift(data: StepData, config: PreflightConfig, with_pose: bool) -> list[Check]:
    checks = [_check_range(data, config), _check_pressure(data, config)]
    if with_pose:
        checks.append(_check_pose_height(data, config))
    return checks


def _check_range(data: StepData, config: PreflightConfig) -> Check:
    """The ultrasonic distance grows to about a metre, and readings continue to arrive."""
    end_s = data.imu_arrival_s[-1]
    late = data.range_m[data.range_arrival_s > end_s - 2.0 * WINDOW_S]
    wanted = f"{config.lift_min_m} to {config.lift_max_m} m at the end"
    if len(late) < 2:
        reason = data.rejected
        hint = "no DISTANCE_SENSOR with orientation 25 (down)"
        if reason["range_orientation"]:
            hint = "orientation is not 25 (down)"
        elif reason["range"]:
            hint = "current_distance is in cm"
        return judged("lift: range", False, "no reading", wanted, hint)
    distance_m = float(np.median(late))
    rate_hz = frequency(data.range_arrival_s[data.range_arrival_s > end_s - 2.0 * WINDOW_S])
    good = config.lift_min_m + 0.1 <= distance_m <= config.lift_max_m and rate_hz >= config.range_rate_min_hz
    hint = "rate too low" if rate_hz < config.range_rate_min_hz else "not lifted by a metre"
    if distance_m > 4.0:
        hint = "current_distance is in cm"
    elif distance_m <= 0.06:
        hint = "current_distance seems to be in m or dm; it is in cm"
    return judged("lift: range", good, f"{distance_m:.2f} m at {rate_hz:.0f} Hz", wanted, hint)


def _check_pressure(data: StepData, config: PreflightConfig) -> Check:
    """Air pressure decreases by 12 Pa a metre."""
    given = data.pressure_pa > 0.0
    if not given.any():
        return absent("lift: pressure", "the vehicle sends none")
    before, after = _ends(data.imu_arrival_s[given], data.pressure_pa[given, None])
    change = float(after[0] - before[0])
    low, high = -12.0 * 1.5 * config.lift_max_m, -12.0 * 0.5 * config.lift_min_m
    hint = "pressure increases when lifted: sign" if change > 2.0 else "unit (hPa), or not lifted by a metre"
    return judged("lift: pressure", low <= change <= high, f"{change:+.1f} Pa", f"{low:.0f} to {high:.0f} Pa", hint)


def _check_pose_height(data: StepData, config: PreflightConfig) -> Check:
    """The pose's d decreases as the vehicle rises, and its zero is the floor."""
    if len(data.pose_s) < 10:
        return judged("lift: pose", False, f"{len(data.pose_s)} poses", "poses", LOST)
    before, after = _ends(data.pose_s, data.poses)
    rise_m = -float(after[2] - before[2])
    end_s = data.imu_arrival_s[-1]
    late = data.range_m[data.range_arrival_s > end_s - 2.0 * WINDOW_S]
    off_m = abs(-float(after[2]) - float(np.median(late))) if len(late) else 0.0
    rises = config.lift_min_m <= rise_m <= config.lift_max_m
    good = rises and off_m <= config.height_tolerance_m
    measured = f"rise of {rise_m:+.2f} m, {off_m:.2f} m from the ultrasonic height"
    hint = "origin of the pose is not on the floor"
    if not rises:
        hint = "third axis is up, not down (ENU or FLU?)" if rise_m < -0.2 else "unit (m), or third axis is not down"
        if abs(rise_m) > 100.0:
            hint = "position seems to be in mm, not m"
    return judged(
        "lift: pose", good, measured, f"d decreases, zero on the floor within {config.height_tolerance_m} m", hint
    )


# -- shared -----------------------------------------------------------------------------------------------------------


def _ends(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Means over the beginning and the end of a step."""
    first, last = time_s <= time_s[0] + WINDOW_S, time_s >= time_s[-1] - WINDOW_S
    return values[first].mean(axis=0), values[last].mean(axis=0)


def _tilt(data: StepData) -> float:
    """Angle between the specific forces before and after, rad."""
    before, after = _ends(data.imu_arrival_s, data.accelerometer)
    length = float(np.linalg.norm(before) * np.linalg.norm(after))
    return float(np.arccos(np.clip(float(before @ after) / max(length, 1e-9), -1.0, 1.0)))


def _turned(data: StepData) -> Array:
    """[3] rad: the gyroscope integrated over the step, without its mean at the beginning."""
    time_s = data.imu_arrival_s
    rates = data.gyroscope - data.gyroscope[time_s <= time_s[0] + WINDOW_S].mean(axis=0)
    angles: Array = np.trapezoid(rates, time_s, axis=0)
    return angles


def _pose_turn(data: StepData, order: tuple[int, int, int, int] = (0, 1, 2, 3), inverse: bool = False) -> Array:
    """[3] rad: rotation vector of the pose's turn, in the body axes before it.

    `order` picks w, x, y, z, `inverse` takes them as world to body: to find out which convention the bridge uses.
    """
    before, after = (rotation(q[list(order)]) for q in _ends(data.pose_s, data.poses[:, 3:7]))
    turn = before @ after.T if inverse else before.T @ after
    angle = float(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)))
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    rotation_vector: Array = axis * (0.5 if angle < 1e-3 else 0.5 * angle / max(float(np.sin(angle)), 1e-6))
    return rotation_vector
