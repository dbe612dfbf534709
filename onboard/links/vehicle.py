"""The wire to the vehicle: MAVLink 2 datagrams in, readings out; motor fractions in, one datagram out.

The vehicle plays the simulator's part of PX4's interface: HIL_SENSOR, HIL_OPTICAL_FLOW, DISTANCE_SENSOR and
BATTERY_STATUS come in, HIL_ACTUATOR_CONTROLS goes out. This file is the only place where wire units and wire frames
become ours. The wire is already FRD and PX4's motor order, so nothing but units changes.

Bad input, and what happens:
  rubbish, wrong checksum, bad or missing signature   dropped, counted by reason
  NaN, infinity, a value no such sensor can give      the reading is dropped and counted, event
  frozen sensor (n bit-identical samples)             further ones are dropped, so its age grows and gates flight, event
  time goes backwards a little                        that sample is dropped (a late datagram)
  time goes backwards a lot, for three samples        the vehicle restarted: its clock is mapped anew, event
  a second vehicle on the port                        only the first one is heard, event; silent for long: released
  two vehicles with one system id                     time jumps to and fro: `conflict` is set, event
"""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Final

from pydantic import Field
from pymavlink.dialects.v20 import common as mavlink

from configs.loader import ConfigRecord
from onboard.links.health import LinkHealth, LinkHealthConfig
from onboard.links.readings import BatteryReading, FlowReading, ImuReading, RangeReading, Reading
from protocol.conventions import NEVER_NS, Array
from protocol.mavlink_frames import Frame, FrameReader, FrameWriter, SigningClock

HIL_SENSOR: Final[int] = mavlink.MAVLINK_MSG_ID_HIL_SENSOR
FLOWS: Final = (mavlink.MAVLINK_MSG_ID_HIL_OPTICAL_FLOW, mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD)
DISTANCE_SENSOR: Final[int] = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR
BATTERY_STATUS: Final[int] = mavlink.MAVLINK_MSG_ID_BATTERY_STATUS
SYS_STATUS: Final[int] = mavlink.MAVLINK_MSG_ID_SYS_STATUS
HEARTBEAT: Final[int] = mavlink.MAVLINK_MSG_ID_HEARTBEAT
ACTUATORS: Final = mavlink.MAVLink_hil_actuator_controls_message

IMU_FIELDS: Final = 0b111111
"""HIL_SENSOR.fields_updated: three accelerometers, three gyroscopes."""
PRESSURE_FIELD: Final = 1 << 9
ORIENTATION_DOWN: Final = 25
ARMED: Final = 128
"""HIL_ACTUATOR_CONTROLS.mode: MAV_MODE_FLAG_SAFETY_ARMED."""
MOTOR_COUNT: Final = 4
FROZEN: Final = {"imu": "IMU", "flow": "optical flow", "range": "ultrasonic", "pressure": "pressure"}
"""What a frozen sensor is called."""
_UNUSED: Final = (0.0,) * 12
_UNKNOWN_VOLTAGE: Final = 0xFFFF
_RESTART_SAMPLES: Final = 3
_CONFLICT_NS: Final = 5 * 10**9
_CONFLICT_COUNT: Final = 20
_MICROSECONDS_MAX: Final = 2**63 // 1000


def _clipped(fraction: float) -> float:
    return min(max(fraction, 0.0), 1.0)


class VehicleLinkConfig(ConfigRecord):
    """What is taken from the vehicle, and what is not."""

    vehicle_system: int = Field(default=0, ge=0, le=255, description="MAVLink system id; 0: the first one heard")
    own_system: int = Field(default=1, ge=1, le=255, description="MAVLink system id that motor commands carry")
    own_component: int = Field(default=1, ge=1, le=255, description="MAVLink component id: autopilot")
    acceleration_max_m_s2: float = Field(default=160.0, gt=0, description="m/s^2; more is a fault of the sensor")
    rate_max_rad_s: float = Field(default=36.0, gt=0, description="rad/s; more is a fault of the sensor")
    pressure_min_pa: float = Field(default=30_000.0, gt=0, description="Pa")
    pressure_max_pa: float = Field(default=120_000.0, gt=0, description="Pa")
    distance_max_m: float = Field(default=12.0, gt=0, description="m; more is a fault of the sensor")
    flow_rate_max_rad_s: float = Field(default=20.0, gt=0, description="rad/s; more is a fault of the sensor")
    frozen_samples: int = Field(default=8, ge=0, description="identical IMU samples in a row that mean frozen; 0: off")
    frozen_flows: int = Field(default=8, ge=0, description="identical flows, not all 0, that mean frozen; 0: off")
    frozen_ranges: int = Field(default=75, ge=0, description="identical ranges in a row that mean frozen; 0: off")
    frozen_pressures: int = Field(default=400, ge=0, description="identical pressures that mean frozen; 0: off")
    clock_drift_ppm: float = Field(default=200.0, gt=0, description="1e-6; vehicle clock against ours")
    clock_restart_s: float = Field(default=0.5, gt=0, description="s; a step back of more is a restarted vehicle")
    late_max_s: float = Field(default=0.5, gt=0, description="s; slow sensors' time stamps further off are replaced")
    release_s: float = Field(default=10.0, gt=0, description="s of silence after which another vehicle is heard")
    signing_tolerance_s: float = Field(default=60.0, gt=0, description="s; vehicle's signing clock against ours")
    health: LinkHealthConfig = LinkHealthConfig()


class Repetition:
    """Counts how often in a row a sensor gave the very same values."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._last: object = None
        self._same = 0

    def frozen(self, values: object) -> bool:
        """Takes a reading; whether it has come unchanged so often that the sensor must be stuck. Never with limit 0."""
        self._same = self._same + 1 if values == self._last else 0
        self._last = values
        return 0 < self._limit <= self._same


class VehicleClock:
    """Maps the vehicle's clock to ours: the least (arrival - stamp) seen, leaking upwards at the allowed drift.

    The least delay is the one without queueing, so the mapped time lies at most that delay after the truth.
    """

    def __init__(self, drift_ppm: float, restart_ns: int) -> None:
        self._drift = drift_ppm * 1e-6
        self._restart_ns = restart_ns
        self._newest_ns = NEVER_NS
        self._offset_ns = 0
        self._suspects = 0
        self._suspect_ns = NEVER_NS
        self.restarts = 0
        self.interleaved = 0
        """How often stamps of an older clock came between good ones."""
        self.known = False

    @property
    def newest_ns(self) -> int:
        """The newest stamp that was accepted, in the vehicle's clock."""
        return self._newest_ns

    def accept(self, stamp_ns: int, now_ns: int) -> str:
        """Takes the IMU's time stamp. Returns "" (good), "restart" (good, on a new clock) or why it is refused."""
        step_ns = stamp_ns - self._newest_ns
        if step_ns > 0:
            latency_ns = now_ns - stamp_ns
            if not self.known or latency_ns < self._offset_ns:
                self._offset_ns = latency_ns
                self.known = True
            else:
                leak_ns = int(self._drift * step_ns) + 1
                self._offset_ns = min(latency_ns, self._offset_ns + leak_ns)
            self._newest_ns = stamp_ns
            if self._suspects:
                self._suspects = 0
                self.interleaved += 1
            return ""
        if step_ns == 0:
            return "time_repeated"
        if -step_ns < self._restart_ns:
            return "time_backwards"
        self._suspects = self._suspects + 1 if stamp_ns > self._suspect_ns else 1
        self._suspect_ns = stamp_ns
        if self._suspects < _RESTART_SAMPLES:
            return "time_backwards"
        self.reset()
        self.restarts += 1
        self.accept(stamp_ns, now_ns)
        return "restart"

    def to_ours(self, stamp_ns: int) -> int:
        """Our time of a vehicle time stamp."""
        return stamp_ns + self._offset_ns

    def reset(self) -> None:
        """Forgets the mapping; the next stamp starts a new one."""
        self._newest_ns = self._suspect_ns = NEVER_NS
        self._suspects = 0
        self.known = False


class VehicleLink:
    """Both directions of the vehicle's wire. Never raises on what the vehicle sends."""

    def __init__(
        self, config: VehicleLinkConfig, key: bytes | None = None, signing_clock: SigningClock | None = None
    ) -> None:
        """With a `key` only signed frames count, and motor commands are signed.

        Raises ValueError if it is not 32 bytes long.
        """
        self._config = config
        clock = signing_clock or SigningClock()
        ids = (HIL_SENSOR, *FLOWS, DISTANCE_SENSOR, BATTERY_STATUS, SYS_STATUS, HEARTBEAT)
        self._reader = FrameReader(ids, key, clock, config.signing_tolerance_s)
        self._writer = FrameWriter(config.own_system, config.own_component, key, clock)
        self._clock = VehicleClock(config.clock_drift_ppm, int(config.clock_restart_s * 1e9))
        self._release_ns = int(config.release_s * 1e9)
        self._late_ns = int(config.late_max_s * 1e9)
        self._decoders = {
            HIL_SENSOR: self._imu,
            FLOWS[0]: self._flow,
            FLOWS[1]: self._flow,
            DISTANCE_SENSOR: self._range,
            BATTERY_STATUS: self._battery,
            SYS_STATUS: self._system_status,
            HEARTBEAT: self._heartbeat,
        }
        self._events: list[tuple[int, str]] = []
        self._said_ns: dict[str, int] = {}
        self._restarted_ns = NEVER_NS
        self._imus = Repetition(config.frozen_samples)
        self._flows = Repetition(config.frozen_flows)
        self._ranges = Repetition(config.frozen_ranges)
        self._pressures = Repetition(config.frozen_pressures)
        self.rejected: Counter[str] = self._reader.rejected
        """What was dropped, by reason."""
        self.received = 0
        """Readings given out."""
        self.health = LinkHealth(config.health)
        """Whether what comes is good enough to fly on."""
        self.system = config.vehicle_system
        """System id that is listened to; 0 while none was heard."""
        self.last_received_ns = NEVER_NS
        self.last_heartbeat_ns = NEVER_NS
        self.last_flow_ns = NEVER_NS
        """When a sound frame of optical flow came, whatever its quality."""
        self.conflict = False
        """Two vehicles seem to speak with one system id; flight must not start."""

    @property
    def restarts(self) -> int:
        """How often the vehicle's clock started anew."""
        return self._clock.restarts

    @property
    def newest_stamp_ns(self) -> int:
        """The vehicle's own clock at its newest IMU sample."""
        return self._clock.newest_ns

    def take_events(self) -> list[tuple[int, str]]:
        """What happened since the last call: (time_ns, text). At most one a second of each kind."""
        events, self._events = self._events, []
        return events

    def receive(self, datagram: bytes, now_ns: int) -> list[Reading]:
        """The good readings of one datagram, in its order."""
        readings: list[Reading] = []
        for frame in self._reader.read(datagram, now_ns):
            if frame.system != self.system and not self._is_ours(frame, now_ns):
                continue
            self.last_received_ns = now_ns
            reading = self._decoders[frame.message_id](frame, now_ns)
            if reading is not None:
                readings.append(reading)
        self.received += len(readings)
        return readings

    def encode_motors(self, fractions: Array | Sequence[float], armed: bool, now_ns: int) -> bytes:
        """Motor command, fractions 0..1 in PX4 quad-X order. Zeros unless armed, and when a fraction is not finite.

        Fractions outside 0..1 are clipped. `rejected["motor_command"]` counts unusable commands, our own fault.
        """
        controls, mode = (0.0, 0.0, 0.0, 0.0), 0
        if armed:
            f1, f2, f3, f4 = map(float, fractions)
            if 0.0 <= f1 <= 1.0 and 0.0 <= f2 <= 1.0 and 0.0 <= f3 <= 1.0 and 0.0 <= f4 <= 1.0:
                controls, mode = (f1, f2, f3, f4), ARMED
            elif math.isfinite(f1 + f2 + f3 + f4):
                controls, mode = (_clipped(f1), _clipped(f2), _clipped(f3), _clipped(f4)), ARMED
            else:
                self.rejected["motor_command"] += 1
        return self._writer.write(ACTUATORS, (now_ns // 1000, 0, *controls, *_UNUSED, mode), now_ns)

    def _is_ours(self, frame: Frame, now_ns: int) -> bool:
        """Settles which vehicle is listened to: the first one heard, until it is silent for long."""
        fixed = self._config.vehicle_system
        if not fixed and (self.system == 0 or now_ns - self.last_received_ns > self._release_ns):
            self._say("system", f"listening to vehicle with system id {frame.system}", now_ns)
            self.system = frame.system
            self._clock.reset()
            self.health.reset()
            return True
        self.rejected["other_vehicle"] += 1
        self._say("other", f"a second vehicle (system id {frame.system}) is on the port and is ignored", now_ns)
        return False

    def _imu(self, frame: Frame, now_ns: int) -> Reading | None:
        f = frame.fields  # time_usec, acc 3, gyro 3, mag 3, abs_pressure, ..., fields_updated, id
        if f[14] & IMU_FIELDS != IMU_FIELDS or f[15] or f[0] > _MICROSECONDS_MAX:
            return self._refuse("imu_fields")
        accelerometer = f[1:4]
        gyroscope = f[4:7]
        config = self._config
        limit = config.acceleration_max_m_s2
        for value in accelerometer:
            if not -limit <= value <= limit:  # also catches NaN
                return self._refuse_sensor("accelerometer", value, now_ns)
        limit = config.rate_max_rad_s
        for value in gyroscope:
            if not -limit <= value <= limit:
                return self._refuse_sensor("gyroscope", value, now_ns)
        stamp_ns = f[0] * 1000
        fault = self._clock.accept(stamp_ns, now_ns)
        if fault and not self._handle_clock(fault, now_ns):
            return None
        felt = f[1:7]
        if self._imus.frozen(felt):
            return self._refuse_frozen("imu", now_ns)
        pressure_pa = self._pressure(f[10] * 100.0, now_ns) if f[14] & PRESSURE_FIELD else 0.0
        time_ns = self._clock.to_ours(stamp_ns)
        self.health.add(stamp_ns, now_ns - time_ns, now_ns, felt)
        return ImuReading(time_ns, accelerometer, gyroscope, pressure_pa)

    def _pressure(self, pressure_pa: float, now_ns: int) -> float:
        """The pressure, Pa; 0 where it is not to be believed."""
        if not self._config.pressure_min_pa <= pressure_pa <= self._config.pressure_max_pa:
            self._refuse_sensor("pressure", pressure_pa, now_ns)
        elif self._pressures.frozen(pressure_pa):
            self._refuse_frozen("pressure", now_ns)
        else:
            return pressure_pa
        return 0.0

    def _handle_clock(self, fault: str, now_ns: int) -> bool:
        """Reacts to a bad time stamp; True when the sample may be used all the same."""
        again = now_ns - self._restarted_ns < _CONFLICT_NS
        if self._clock.interleaved >= _CONFLICT_COUNT or (fault == "restart" and again):
            self.conflict = True
            self._say("conflict", "the vehicle's time jumps to and fro: two vehicles with one system id?", now_ns)
        if fault != "restart":
            self.rejected[fault] += 1
            self.health.count_backwards()
            return False
        self._restarted_ns = now_ns
        self.health.reset()
        self._say("restart", "vehicle clock went backwards: vehicle restarted, its time is mapped anew", now_ns)
        return True

    def _flow(self, frame: Frame, now_ns: int) -> Reading | None:
        f = frame.fields  # time_usec, integration_time_us, x, y, xgyro, ygyro, zgyro, ..., sensor_id, quality
        integration_s = f[1] * 1e-6
        if not 1e-3 <= integration_s <= 0.5 or f[0] > _MICROSECONDS_MAX:
            return self._refuse("flow_time")
        limit = self._config.flow_rate_max_rad_s * integration_s
        for value in f[2:6]:
            if not -limit <= value <= limit:
                return self._refuse_sensor("flow", value, now_ns)
        if self._flows.frozen(f[2:6]) and any(f[2:6]):  # a camera that sees nothing gives noughts
            return self._refuse_frozen("flow", now_ns)
        self.last_flow_ns = now_ns
        return FlowReading(self._slow_time(f[0] * 1000, now_ns), integration_s, f[2], f[3], f[4], f[5], f[11])

    def _range(self, frame: Frame, now_ns: int) -> Reading | None:
        f = frame.fields  # time_boot_ms, min, max, current (cm), type, id, orientation, ...
        if f[6] != ORIENTATION_DOWN:
            return self._refuse("range_orientation")
        distance_m = f[3] * 0.01
        if not 0.0 < distance_m <= self._config.distance_max_m:
            return self._refuse("range")
        if self._ranges.frozen(f[3]) and f[3] > f[1]:  # at its least distance a sound sensor never changes
            return self._refuse_frozen("range", now_ns)
        return RangeReading(self._slow_time(f[0] * 1_000_000, now_ns), distance_m)

    def _battery(self, frame: Frame, now_ns: int) -> Reading | None:
        f = frame.fields  # current_consumed, energy_consumed, temperature, voltages 10 (mV), ..., remaining (%)
        millivolts = [cell for cell in f[3:13] if cell != _UNKNOWN_VOLTAGE]
        return self._battery_reading(sum(millivolts), f[17], now_ns)

    def _system_status(self, frame: Frame, now_ns: int) -> Reading | None:
        f = frame.fields  # three sensor masks, load, voltage (mV), current, six counters, remaining (%)
        return self._battery_reading(0 if f[4] == _UNKNOWN_VOLTAGE else f[4], f[12], now_ns)

    def _battery_reading(self, millivolts: int, percent: int, now_ns: int) -> Reading | None:
        if not 0 < millivolts < 60_000 or percent > 100:
            return self._refuse("battery")
        return BatteryReading(now_ns, millivolts * 1e-3, percent * 0.01 if percent >= 0 else -1.0)

    def _heartbeat(self, frame: Frame, now_ns: int) -> Reading | None:
        self.last_heartbeat_ns = now_ns
        return None

    def _slow_time(self, stamp_ns: int, now_ns: int) -> int:
        """Our time of a slow sensor's stamp; the arrival when that makes no sense."""
        ours_ns = self._clock.to_ours(stamp_ns)
        return ours_ns if self._clock.known and 0 <= now_ns - ours_ns <= self._late_ns else now_ns

    def _refuse(self, reason: str) -> Reading | None:
        self.rejected[reason] += 1
        return None

    def _refuse_sensor(self, sensor: str, value: float, now_ns: int) -> Reading | None:
        self._say(sensor, f"{sensor} gave {value:g}: sample ignored", now_ns)
        return self._refuse(sensor)

    def _refuse_frozen(self, sensor: str, now_ns: int) -> Reading | None:
        self._say(f"{sensor}_frozen", f"{FROZEN[sensor]} frozen: identical readings are ignored", now_ns)
        return self._refuse(f"{sensor}_frozen")

    def _say(self, kind: str, text: str, now_ns: int) -> None:
        if now_ns - self._said_ns.get(kind, NEVER_NS) >= 10**9:
            self._said_ns[kind] = now_ns
            self._events.append((now_ns, text))
