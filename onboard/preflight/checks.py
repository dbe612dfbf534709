"""Preflight checks at rest and of the motors. Arrays in, rows of a table out.

motion_checks.py has the checks for which a person moves the vehicle by hand. Each row has the measured value, the
expected value and, if the check failed, the most likely cause: wrong units, signs, axes and orders give typical values.
"""

from enum import Enum
from typing import Final, NamedTuple

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.estimation.config import GYRO_BIAS_MAX_RAD_S
from onboard.preflight.recorder import StepData
from protocol.conventions import GRAVITY, Array
from protocol.geometry import normalised, rotation_of

__all__ = ["Check", "MotorAnswer", "PreflightConfig", "Result", "Step", "check_motors", "check_still", "skipped"]


LOST: Final = "motion capture lost the vehicle"
VEHICLE_RECEIVED: Final = "vehicle received"
"""Name of the check without which no other check makes sense."""


class Step(Enum):
    """What the person does with the vehicle in each step."""

    STILL = "put the vehicle on level ground and do not touch it"
    NOSE_DOWN = "from level, tilt the NOSE DOWN by about 30 degrees and hold it there"
    RIGHT_DOWN = "from level, tilt the RIGHT SIDE DOWN by about 30 degrees and hold it there"
    TURN_RIGHT = "keep it level and turn it to the RIGHT (clockwise seen from above) by about 90 degrees"
    LIFT = "from the ground, LIFT it straight up by about one metre and hold it level there"
    FORWARD = "keep it level and carry it FORWARD, the way its nose points, by about one metre"


class Result(Enum):
    """Result of a check."""

    PASS = "pass"
    FAIL = "FAIL"
    SKIPPED = "not done"
    ABSENT = "absent"
    """The vehicle does not have the sensor, and can fly without it."""


class Check(NamedTuple):
    """One row of the table."""

    name: str
    result: Result
    measured: str
    wanted: str
    hint: str = ""


class PreflightConfig(ConfigRecord):
    """Limits of the checks."""

    imu_rate_hz: float = Field(default=200.0, gt=0, description="Hz")
    imu_rate_tolerance: float = Field(default=0.05, gt=0, lt=1, description="share")
    delay_p99_max_s: float = Field(
        default=0.008, gt=0, description="s delay beyond the fastest sample, for 99 % of samples"
    )
    gap_max_s: float = Field(default=0.030, gt=0, description="s between two arrivals; IMU silence stops the motors")
    clock_rate_tolerance: float = Field(default=0.005, gt=0, description="1; vehicle's clock rate against ours")
    gravity_tolerance_m_s2: float = Field(default=1.0, gt=0, description="m/s^2; the Mambo's bias is up to 0.35")
    level_tolerance_rad: float = Field(default=0.1, gt=0, description="rad; accelerometer's tilt on level ground")
    gyro_bias_max_rad_s: float = Field(default=GYRO_BIAS_MAX_RAD_S, gt=0, description="rad/s")
    gyro_sigma_max_rad_s: float = Field(default=0.1, gt=0, description="rad/s")
    battery_min_v: float = Field(default=3.7, gt=0, description="V at rest")
    battery_max_v: float = Field(default=4.45, gt=0, description="V; more is not one lithium cell in volts")
    range_rate_min_hz: float = Field(default=15.0, gt=0, description="Hz, in the air")
    flow_rate_min_hz: float = Field(default=40.0, gt=0, description="Hz")
    pose_rate_min_hz: float = Field(default=45.0, gt=0, description="Hz")
    pose_gap_max_s: float = Field(default=0.1, gt=0, description="s")
    tilt_min_rad: float = Field(default=0.2, gt=0, description="rad; less tilt cannot be judged")
    angle_tolerance: float = Field(default=0.3, gt=0, lt=1, description="share; difference of two angles")
    turn_min_rad: float = Field(default=0.6, gt=0, description="rad")
    pose_angle_tolerance_rad: float = Field(default=0.15, gt=0, description="rad; pose against accelerometer")
    lift_min_m: float = Field(default=0.4, gt=0, description="m")
    lift_max_m: float = Field(default=2.0, gt=0, description="m")
    height_tolerance_m: float = Field(default=0.2, gt=0, description="m; ultrasonic height against pose height")
    spin_fraction: float = Field(default=0.15, gt=0, le=0.3, description="of maximum thrust, one motor at a time")
    spin_s: float = Field(default=1.0, gt=0, le=3, description="s")


def skipped(name: str, why: str) -> Check:
    """A check that was not done."""
    return Check(name, Result.SKIPPED, "", "", why)


def absent(name: str, why: str) -> Check:
    """A check of a sensor that the vehicle does not have."""
    return Check(name, Result.ABSENT, "", "", why)


def judged(name: str, good: bool, measured: str, wanted: str, hint: str = "") -> Check:
    """A row; with the hint only if the check failed."""
    return Check(name, Result.PASS if good else Result.FAIL, measured, wanted, "" if good else hint)


# -- at rest ----------------------------------------------------------------------------------------------------------


def check_still(data: StepData, config: PreflightConfig, with_pose: bool) -> list[Check]:
    """The checks of a vehicle that stands on level ground."""
    if len(data.imu_arrival_s) < 20:
        dropped = ", ".join(f"{count} {reason}" for reason, count in data.rejected.most_common(3))
        hint = f"all frames were dropped: {dropped}" if dropped else "wrong address, or the vehicle sends nothing"
        return [judged(VEHICLE_RECEIVED, False, f"{len(data.imu_arrival_s)} IMU samples", "HIL_SENSOR", hint)]
    checks = [*_stream(data, config), _accelerometer(data, config), _gyroscope(data, config)]
    checks += [_pressure(data), _battery(data, config), _heartbeat(data), _flow_rate(data, config)]
    if with_pose:
        checks += _pose_stream(data, config)
    return checks


def _stream(data: StepData, config: PreflightConfig) -> list[Check]:
    """Rate, jitter and time base of the IMU samples."""
    arrival, stamp = data.imu_arrival_s, data.imu_stamp_s
    span_s = max(arrival[-1] - arrival[0], 1e-9)
    rate_hz = (len(arrival) - 1) / span_s
    low, high = (config.imu_rate_hz * (1.0 + sign * config.imu_rate_tolerance) for sign in (-1, 1))
    late_s, gap_s = float(np.quantile(data.imu_delay_s, 0.99)), float(np.diff(arrival).max())
    clock = float(stamp[-1] - stamp[0]) / span_s
    backwards = data.rejected["time_backwards"] + data.rejected["time_repeated"] + data.restarts
    steady = abs(clock - 1.0) <= config.clock_rate_tolerance and not backwards
    jitter_good = late_s <= config.delay_p99_max_s and gap_s <= config.gap_max_s
    single = not data.conflict and not data.rejected["other_vehicle"]
    lost = "samples are lost or dropped: " + ", ".join(f"{n} {reason}" for reason, n in data.rejected.items())
    return [
        judged("IMU rate", low <= rate_hz <= high, f"{rate_hz:.1f} Hz", f"{low:.0f} to {high:.0f} Hz", lost),
        judged(
            "IMU jitter",
            jitter_good,
            f"99 % within {late_s * 1e3:.1f} ms, longest gap {gap_s * 1e3:.1f} ms",
            f"within {config.delay_p99_max_s * 1e3:.0f} ms, no gap beyond {config.gap_max_s * 1e3:.0f} ms",
            "a radio or a busy bridge between; the IMU needs a cable or the same machine",
        ),
        judged(
            "time base",
            steady,
            f"vehicle clock runs at {clock:.4g} times ours, {backwards} steps back",
            "time_usec in microseconds, never backwards",
            _clock_hint(clock, backwards),
        ),
        judged("one vehicle", single, "one" if single else "two", "one", "two vehicles send to this port"),
    ]


def _clock_hint(clock: float, backwards: int) -> str:
    for factor, unit in ((1e-3, "milliseconds"), (1e3, "nanoseconds"), (1e-6, "seconds")):
        if abs(clock / factor - 1.0) < 0.1:
            return f"time_usec seems to be in {unit}"
    return "two senders, or a clock that is set while it runs" if backwards else "the vehicle's clock has a wrong rate"


def _accelerometer(data: StepData, config: PreflightConfig) -> Check:
    """At rest and level: (0, 0, -9.81) m/s^2."""
    mean = data.accelerometer.mean(axis=0)
    norm = float(np.linalg.norm(mean))
    tilt = float(np.hypot(mean[0], mean[1])) / max(norm, 1e-9)
    good = abs(norm - GRAVITY) <= config.gravity_tolerance_m_s2
    good = good and mean[2] < 0.0 and tilt <= config.level_tolerance_rad
    return judged(
        "accelerometer at rest", good, f"{vector(mean)} m/s^2", "(0, 0, -9.8) m/s^2", _rest_hint(mean, norm, tilt)
    )


def _rest_hint(mean: Array, norm: float, tilt: float) -> str:
    for factor, unit in ((1.0, "g"), (1000.0, "milli-g"), (32.174, "ft/s^2")):
        if abs(norm / factor - 1.0) < 0.12:
            return f"acceleration seems to be in {unit}, not m/s^2"
    if tilt > 0.8:
        return f"gravity is on axis {'xy'[int(np.argmax(np.abs(mean[:2])))]}: the axes are swapped"
    if mean[2] > 0.0:
        return "sign of z: axes are forward-right-down, and z reads -9.8 at rest"
    return "ground not level, or accelerometer not calibrated" if tilt > 0.05 else "scale of the accelerometer"


def _gyroscope(data: StepData, config: PreflightConfig) -> Check:
    mean, sigma = data.gyroscope.mean(axis=0), data.gyroscope.std(axis=0)
    alive = bool((sigma > 0.0).all())
    quiet = np.abs(mean).max() <= config.gyro_bias_max_rad_s and sigma.max() <= config.gyro_sigma_max_rad_s
    hint = "the vehicle was moved, or rates are in degrees per second" if alive else "an axis is stuck"
    return judged(
        "gyroscope at rest",
        bool(alive and quiet),
        f"mean {vector(mean)}, sigma {vector(sigma)} rad/s",
        f"mean below {config.gyro_bias_max_rad_s}, sigma below {config.gyro_sigma_max_rad_s}, not stuck",
        hint,
    )


def _pressure(data: StepData) -> Check:
    given = data.pressure_pa[data.pressure_pa > 0.0]
    refused = data.rejected["pressure"]
    if not len(given) and not refused:
        return absent("pressure", "the vehicle sends none; height then comes from ultrasound and pose")
    mean = f"{given.mean():.0f} Pa" if len(given) else "not plausible"
    hint = "abs_pressure is in hPa (1013 at sea level)"
    return judged("pressure", bool(len(given)) and not refused, mean, "300 to 1200 hPa", hint)


def _battery(data: StepData, config: PreflightConfig) -> Check:
    wanted = f"{config.battery_min_v} to {config.battery_max_v} V"
    if not len(data.battery_v):
        hint = "voltages are in mV, unused cells 65535" if data.rejected["battery"] else "no BATTERY_STATUS"
        return judged("battery", False, "no report", wanted, hint)
    volt = float(data.battery_v[-1])
    hint = "charge it" if 2.5 < volt < config.battery_min_v else "voltages[0] is one cell in mV"
    return judged("battery", config.battery_min_v <= volt <= config.battery_max_v, f"{volt:.2f} V", wanted, hint)


def _heartbeat(data: StepData) -> Check:
    return judged("heartbeat", data.heartbeats > 0, f"{data.heartbeats}", "about one a second", "no HEARTBEAT")


def _flow_rate(data: StepData, config: PreflightConfig) -> Check:
    """On the ground a camera may see nothing, but it must send frames."""
    rate_hz = frequency(data.flow_arrival_s)
    hint = "no HIL_OPTICAL_FLOW: without a pose the vehicle could only level and descend"
    if data.rejected["flow"] or data.rejected["flow_time"]:
        hint = "flow is in rad over integration_time_us"
    return judged(
        "flow rate", rate_hz >= config.flow_rate_min_hz, f"{rate_hz:.0f} Hz", f"{config.flow_rate_min_hz:.0f} Hz", hint
    )


def _pose_stream(data: StepData, config: PreflightConfig) -> list[Check]:
    """Rate of the motion capture, and its upright against the accelerometer's."""
    wanted = f"{config.pose_rate_min_hz:.0f} Hz, no gap beyond {config.pose_gap_max_s * 1e3:.0f} ms"
    if len(data.pose_s) < 5:
        return [judged("pose rate", False, f"{len(data.pose_s)} poses", wanted, "no ODOMETRY arrived at --pose")]
    rate_hz, gap_s = frequency(data.pose_s), float(np.diff(data.pose_s).max())
    good = rate_hz >= config.pose_rate_min_hz and gap_s <= config.pose_gap_max_s
    up = rotation(data.poses[:, 3:7].mean(axis=0))[2]  # world down in the body
    force = -data.accelerometer.mean(axis=0)
    cosine = float(up @ force) / max(float(np.linalg.norm(force)), 1e-9)
    angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    rate = judged("pose rate", good, f"{rate_hz:.0f} Hz, longest gap {gap_s * 1e3:.0f} ms", wanted, LOST)
    hint = "upright of pose and IMU differ: needs world NED, body FRD, quaternion w first, body to world"
    return [
        rate,
        judged(
            "pose upright",
            angle <= config.pose_angle_tolerance_rad,
            f"{np.degrees(angle):.0f} deg from the accelerometer's",
            f"within {np.degrees(config.pose_angle_tolerance_rad):.0f} deg",
            hint,
        ),
    ]


# -- motors -----------------------------------------------------------------------------------------------------------


class MotorAnswer(NamedTuple):
    """What the person saw when one motor turned."""

    place: str
    """"front right", "rear left", "front left", "rear right" or "none"."""
    spin: str
    """"ccw" or "cw", seen from above."""


MOTORS: Final[dict[int, MotorAnswer]] = {
    1: MotorAnswer("front right", "ccw"),
    2: MotorAnswer("rear left", "ccw"),
    3: MotorAnswer("front left", "cw"),
    4: MotorAnswer("rear right", "cw"),
}
"""PX4's quad-X order."""
MAMBO_PLACES: Final = ("front left", "front right", "rear right", "rear left")
"""Places of the Mambo's own motors 1 to 4."""


def check_motors(answers: dict[int, MotorAnswer], stopped: bool) -> list[Check]:
    """Rows from the person's answers: place and direction of each motor, and the stop without commands."""
    places = tuple(answers[motor].place for motor in MOTORS)
    unmapped = places == MAMBO_PLACES
    checks = []
    for motor, expected in MOTORS.items():
        seen = answers[motor]
        hint = (
            "the Mambo's own order: PX4 [1, 2, 3, 4] = Mambo [2, 4, 1, 3]" if unmapped else "motor order of the bridge"
        )
        if seen.place == expected.place:
            hint = "propeller or wiring: it turns the other way"
        elif seen.place == "none":
            hint = "the motor did not turn: controls[0..3], mode with bit 128"
        checks.append(
            judged(f"motor {motor}", seen == expected, " ".join(seen).strip(), " ".join(expected), hint),
        )
    hint = "the bridge must stop the motors 100 ms after the last command"
    checks.append(judged("motors stop by themselves", stopped, "yes" if stopped else "no", "yes", hint))
    return checks


# -- shared -----------------------------------------------------------------------------------------------------------


def vector(values: Array) -> str:
    """Three numbers for a table."""
    return "(" + ", ".join(f"{value:.2g}" if abs(value) < 1 else f"{value:.1f}" for value in values) + ")"


def frequency(times_s: Array) -> float:
    """Events a second; 0 for fewer than two."""
    if len(times_s) < 2 or times_s[-1] <= times_s[0]:
        return 0.0
    return float((len(times_s) - 1) / (times_s[-1] - times_s[0]))


def rotation(quaternion: Array) -> Array:
    """[3, 3] body to world, of a quaternion wxyz whose length may differ from 1."""
    w, x, y, z = quaternion.tolist()
    return np.reshape(rotation_of(normalised((w, x, y, z))), (3, 3))
