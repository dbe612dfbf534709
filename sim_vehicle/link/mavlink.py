"""The vehicle's end of the MAVLink 2 link: sensor samples become frames, frames become motor commands.

protocol/mavlink/ knows the messages; this file decides which motor commands are accepted. The battery is sent as
BATTERY_STATUS, because SYS_STATUS would mix it with the health bits of an autopilot.
"""

from collections import Counter
from math import isfinite
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from protocol.mavlink import vehicle as wire
from protocol.mavlink.frames import Fields, FrameReader, FrameWriter
from protocol.mavlink.motion_capture import encode_odometry, odometry_covariances
from protocol.mavlink.signing import SigningClock
from protocol.mavlink.vehicle import Fractions, clip
from sim_vehicle.physics.parameters import LinkConfig, MotionCaptureConfig, UltrasonicConfig
from sim_vehicle.sensors.battery import BatterySample
from sim_vehicle.sensors.flow import FlowSample
from sim_vehicle.sensors.imu import ImuSample
from sim_vehicle.sensors.motion_capture import PoseSample

MOTION_CAPTURE_COMPONENT: Final = mavlink.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
DATAGRAM_BYTES_MAX: Final = 1500
ROUNDING: Final = 1e-6
"""A fraction outside 0..1 by no more than this is clipped."""


class VehicleCodec:
    """Encodes the sensors and decodes the motor commands of one vehicle and its motion capture."""

    def __init__(
        self,
        config: LinkConfig,
        ultrasonic: UltrasonicConfig,
        capture: MotionCaptureConfig,
        key: bytes | None = None,
        capture_key: bytes | None = None,
    ) -> None:
        """With a `key` (32 bytes) sent frames are signed, and unsigned commands are refused.

        `capture_key` signs the poses.
        """
        self._clock = SigningClock()
        self._signed = key is not None
        self._sensors = FrameWriter(config.system_id, config.component_id, key, self._clock)
        self._capture_identity = config.system_id, MOTION_CAPTURE_COMPONENT, capture_key
        self.start_capture(0)
        self._reader = FrameReader([wire.MOTORS], key, tolerance_s=None)
        self._range = (ultrasonic.least_m, ultrasonic.greatest_m), ultrasonic.noise_m
        position, attitude = capture.position_noise_m**2, capture.attitude_noise_rad**2
        self._covariances = odometry_covariances(position, attitude, 2.0 * position * capture.rate_hz**2)

    @property
    def rejected(self) -> Counter[str]:
        """Frames dropped, by reason."""
        return self._reader.rejected

    def start_capture(self, utc_ns: int) -> None:
        """Begin the flight at `utc_ns`: the motion capture signs with the time of the day."""
        self._capture = FrameWriter(*self._capture_identity, SigningClock(utc_ns))

    def imu(self, sample: ImuSample, time_us: int) -> bytes:
        """HIL_SENSOR."""
        return self._sensors.write(wire.encode_imu(time_us, *sample), 0)

    def flow(self, sample: FlowSample, time_us: int) -> bytes:
        """HIL_OPTICAL_FLOW."""
        return self._sensors.write(wire.encode_flow(time_us, *sample), 0)

    def distance(self, distance_m: float, time_us: int) -> bytes:
        """DISTANCE_SENSOR."""
        return self._sensors.write(wire.encode_range(time_us, distance_m, *self._range), 0)

    def battery(self, sample: BatterySample) -> bytes:
        """BATTERY_STATUS."""
        sample = sample._replace(remaining=max(0.0, sample.remaining))
        return self._sensors.write(wire.encode_battery(*sample), 0)

    def heartbeat(self, armed: bool) -> bytes:
        """HEARTBEAT of a quadrotor's hardware without an autopilot of its own."""
        state = mavlink.MAV_STATE_ACTIVE if armed else mavlink.MAV_STATE_STANDBY
        mode = mavlink.MAV_MODE_FLAG_HIL_ENABLED
        return self._sensors.write(wire.encode_heartbeat(0, mavlink.MAV_AUTOPILOT_INVALID, mode, armed, state), 0)

    def pose(self, sample: PoseSample, time_us: int) -> bytes:
        """ODOMETRY."""
        return self._capture.write(encode_odometry(time_us, *sample, self._covariances), time_us * 1000)

    def motor_command(self, datagram: bytes) -> tuple[Fractions, bool] | None:
        """The newest motor command in a datagram: fractions, and whether armed. None if there is none."""
        if len(datagram) > DATAGRAM_BYTES_MAX:
            self.rejected["too_long"] += 1
            return None
        command = None
        for frame in self._reader.read(datagram, 0):
            command = self._checked(frame.fields) or command
        if self._signed:  # the vehicle has no clock of its own: it adopts onboard's time
            self._clock.catch_up(self._reader.newest_signature_time)
        return command

    def _checked(self, fields: Fields) -> tuple[Fractions, bool] | None:
        fractions, armed = wire.decode_motors(fields)
        f1, f2, f3, f4 = fractions
        if 0.0 <= f1 <= 1.0 and 0.0 <= f2 <= 1.0 and 0.0 <= f3 <= 1.0 and 0.0 <= f4 <= 1.0:
            return fractions, armed
        if not isfinite(sum(fractions)):
            self.rejected["not_finite"] += 1
            return None
        if min(fractions) < -ROUNDING or max(fractions) > 1.0 + ROUNDING:
            self.rejected["out_of_range"] += 1
            return None
        return (clip(f1), clip(f2), clip(f3), clip(f4)), armed
