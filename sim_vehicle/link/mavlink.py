"""The vehicle's end of the MAVLink 2 link: sensors become frames, frames become motor commands.

protocol.mavlink_frames packs and unpacks; this file decides what is accepted. Battery goes out as BATTERY_STATUS (one
cell, in mV), because SYS_STATUS would mix it with an autopilot's health bits. Fields stand in wire order, which is
that of their size; extensions that are not used are left out.
"""

import hmac
from collections import Counter
from math import isfinite
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from protocol.mavlink_frames import FrameWriter, SigningClock, checked_fields, layout_of, signature
from sim_vehicle.physics.parameters import LinkConfig, MotionCaptureConfig, UltrasonicConfig
from sim_vehicle.sensors.battery import BatterySample
from sim_vehicle.sensors.flow import FlowSample
from sim_vehicle.sensors.imu import ImuSample
from sim_vehicle.sensors.motion_capture import PoseSample

MOTORS: Final = layout_of(mavlink.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS)
HEADER: Final = 10
"""Bytes of a MAVLink 2 header."""
CHECKSUM: Final = 2
SIGNATURE: Final = 13
MAGIC: Final = 0xFD
SIGNED: Final = 0x01
MOTION_CAPTURE_COMPONENT: Final = mavlink.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
UPDATED: Final = 0b111_111 | mavlink.HIL_SENSOR_UPDATED_ABS_PRESSURE | mavlink.HIL_SENSOR_UPDATED_TEMPERATURE
"""HIL_SENSOR's fields that carry a measurement: no magnetometer, no air speed."""
TEMPERATURE_C: Final = 25.0
TEMPERATURE_CENTI_C: Final = 2500
POSE_KIND: Final = (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD, 0, mavlink.MAV_ESTIMATOR_TYPE_MOCAP, 100)
"""ODOMETRY's last fields: frames, resets, estimator, quality in per cent."""
NO_CELL: Final = 0xFFFF
LARGEST_DATAGRAM: Final = 1500


class VehicleCodec:
    """Frames out, motor commands in, for one vehicle and its motion capture."""

    def __init__(
        self,
        config: LinkConfig,
        ultrasonic: UltrasonicConfig,
        capture: MotionCaptureConfig,
        key: bytes | None = None,
    ) -> None:
        """With a `key` (32 bytes) what goes out is signed, and only signed commands count."""
        self._key = key
        self._clocks = (SigningClock(), SigningClock())
        self._sensors = FrameWriter(config.system_id, config.component_id, self._key, self._clocks[0])
        self._capture = FrameWriter(config.system_id, MOTION_CAPTURE_COMPONENT, self._key, self._clocks[1])
        self._signed_until: dict[tuple[int, int, int], int] = {}
        kind = (mavlink.MAV_DISTANCE_SENSOR_ULTRASOUND, 0, mavlink.MAV_SENSOR_ROTATION_PITCH_270)
        variance_cm2 = min(254, round((ultrasonic.noise_m * 100) ** 2))
        self._range_cm = (round(ultrasonic.least_m * 100), round(ultrasonic.greatest_m * 100))
        self._range_kind = (*kind, variance_cm2)
        position, attitude = capture.position_noise_m**2, capture.attitude_noise_rad**2
        velocity = 2.0 * position * capture.rate_hz**2
        self._covariances = (
            *_diagonal((position,) * 3 + (attitude,) * 3),
            *_diagonal((velocity,) * 3 + (UNKNOWN_RATE_VARIANCE,) * 3),
        )
        self.rejected: Counter[str] = Counter()
        """Frames dropped, by reason."""

    def imu(self, sample: ImuSample, time_us: int) -> bytes:
        """HIL_SENSOR."""
        felt = (*sample.accelerometer_m_s2, *sample.gyroscope_rad_s)
        air = (sample.pressure_pa * 0.01, 0.0, 0.0, TEMPERATURE_C)
        fields = (time_us, *felt, 0.0, 0.0, 0.0, *air, UPDATED)
        return self._sensors.write(mavlink.MAVLink_hil_sensor_message, fields, 0)

    def flow(self, sample: FlowSample, time_us: int) -> bytes:
        """HIL_OPTICAL_FLOW; it measures no distance, so that field is -1 (unknown)."""
        angles = (*sample.flow_rad, *sample.gyroscope_rad)
        fields = (time_us, round(sample.time_s * 1e6), *angles, 0, -1.0, TEMPERATURE_CENTI_C, 0, sample.quality)
        return self._sensors.write(mavlink.MAVLink_hil_optical_flow_message, fields, 0)

    def distance(self, distance_m: float, time_us: int) -> bytes:
        """DISTANCE_SENSOR: whole cm, orientation 25 (down), ultrasound."""
        fields = (time_us // 1000 & 0xFFFFFFFF, *self._range_cm, round(distance_m * 100), *self._range_kind)
        return self._sensors.write(mavlink.MAVLink_distance_sensor_message, fields, 0)

    def battery(self, sample: BatterySample) -> bytes:
        """BATTERY_STATUS of one cell."""
        cells_mv = (max(0, min(NO_CELL - 1, round(sample.voltage_v * 1000))), *(NO_CELL,) * 9)
        used = (round(sample.used_mah), -1)
        kind = (0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO)
        percent = round(100 * max(0.0, min(1.0, sample.remaining)))
        current_ca = min(32767, round(sample.current_a * 100))
        fields = (*used, TEMPERATURE_CENTI_C, *cells_mv, current_ca, *kind, percent)
        return self._sensors.write(mavlink.MAVLink_battery_status_message, fields, 0)

    def heartbeat(self, armed: bool) -> bytes:
        """HEARTBEAT of a quadrotor's hardware without an autopilot of its own."""
        mode = mavlink.MAV_MODE_FLAG_HIL_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
        state = mavlink.MAV_STATE_ACTIVE if armed else mavlink.MAV_STATE_STANDBY
        fields = (0, mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_INVALID, mode, state, 3)
        return self._sensors.write(mavlink.MAVLink_heartbeat_message, fields, 0)

    def pose(self, sample: PoseSample, time_us: int) -> bytes:
        """ODOMETRY: pose in LOCAL_FRD (here the same as NED), velocity in BODY_FRD, estimator MOCAP; no rates."""
        motion = (*sample.position_m, *sample.quaternion, *sample.velocity_m_s, 0.0, 0.0, 0.0)
        fields = (time_us, *motion, *self._covariances, *POSE_KIND)
        return self._capture.write(mavlink.MAVLink_odometry_message, fields, 0)

    def motor_command(self, datagram: bytes) -> tuple[tuple[float, float, float, float], bool] | None:
        """The newest motor command in a datagram: fractions, and whether armed. None, and counted, if there is none."""
        command = None
        if len(datagram) > LARGEST_DATAGRAM:
            self.rejected["too long"] += 1
            return None
        start = 0
        while start < len(datagram):
            frame = datagram[start : start + _frame_length(datagram, start)]
            start += max(len(frame), 1)
            reason = self._refusal(frame)
            if reason:
                self.rejected[reason] += 1
                if reason == "not a frame":
                    return command
                continue
            command = self._read(frame) or command
        return command

    def _refusal(self, frame: bytes) -> str:
        """Why a frame is not taken before it is decoded, or ""."""
        if len(frame) < HEADER + CHECKSUM or frame[0] != MAGIC or frame[2] & ~SIGNED:
            return "not a frame"
        if int.from_bytes(frame[7:10], "little") != mavlink.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS:
            return "not a motor command"
        if self._key is None:
            return ""
        return "signature" if not frame[2] & SIGNED else self._signature_fault(frame, self._key)

    def _signature_fault(self, frame: bytes, key: bytes) -> str:
        """Verify first, and only then remember the time: a forged frame must not shut out the true sender."""
        if not hmac.compare_digest(signature(key, frame[:-6]), frame[-6:]):
            return "signature"
        stream = (frame[-SIGNATURE], frame[5], frame[6])
        stamp = int.from_bytes(frame[-12:-6], "little")
        if stamp <= self._signed_until.get(stream, -1):
            return "replay"
        self._signed_until[stream] = stamp
        for clock in self._clocks:  # a vehicle without a clock of its own takes over its master's
            clock.catch_up(stamp)
        return ""

    def _read(self, frame: bytes) -> tuple[tuple[float, float, float, float], bool] | None:
        fields = checked_fields(frame, MOTORS)
        if fields is None:
            self.rejected["checksum"] += 1
            return None
        f1, f2, f3, f4 = fields[2:6]  # after time and flags
        armed = bool(fields[-1] & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if 0.0 <= f1 <= 1.0 and 0.0 <= f2 <= 1.0 and 0.0 <= f3 <= 1.0 and 0.0 <= f4 <= 1.0:
            return (f1, f2, f3, f4), armed
        if not isfinite(f1 + f2 + f3 + f4):
            self.rejected["not finite"] += 1
            return None
        if min(f1, f2, f3, f4) < -1e-6 or max(f1, f2, f3, f4) > 1.0 + 1e-6:
            self.rejected["out of range"] += 1
            return None
        fractions = (_clipped(f1), _clipped(f2), _clipped(f3), _clipped(f4))
        return fractions, armed


UNKNOWN_RATE_VARIANCE: Final = 1.0e4
"""(rad/s)^2: motion capture reports no rates."""


def _clipped(fraction: float) -> float:
    return max(0.0, min(1.0, fraction))


def _frame_length(datagram: bytes, start: int) -> int:
    if len(datagram) - start < HEADER:
        return len(datagram) - start
    signature = SIGNATURE if datagram[start + 2] & SIGNED else 0
    return HEADER + datagram[start + 1] + CHECKSUM + signature


def _diagonal(values: tuple[float, ...]) -> list[float]:
    """[21] upper triangle, row by row, of a diagonal 6 x 6 matrix."""
    triangle = [0.0] * 21
    place = 0
    for row, value in enumerate(values):
        triangle[place] = value
        place += 6 - row
    return triangle
