"""The link to the vehicle: MAVLink 2 datagrams in, checked readings out; motor fractions in, one datagram out.

protocol/mavlink/ knows the messages. This file decides what is accepted:

  corrupted frame, bad or missing signature           dropped, counted by reason
  NaN, infinity, a value outside the sensor's range   the reading is dropped and counted; event
  frozen sensor (many identical readings)             further readings are dropped, so their age grows; event
  time goes backwards a little                        that sample is dropped (a late datagram)
  time stamp ahead of its cause                       that sample is dropped (a wrong stamp)
  either of them for three samples                    the vehicle's clock jumped: it is mapped again; event
  time goes backwards a lot, for three samples        the vehicle restarted: its clock is mapped again; event
  a second vehicle on the port                        only the first one counts, until it is silent for long; event
  two vehicles with one system id                     time jumps back and forth: `conflict` is set; event
"""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Final

from pydantic import Field

from configs.loader import ConfigRecord
from onboard.links.health import LinkHealth, LinkHealthConfig
from onboard.links.vehicle_clock import VehicleClock
from protocol.conventions import NEVER_NS, Array
from protocol.geometry import ZERO, Vector3
from protocol.mavlink import vehicle as wire
from protocol.mavlink.frames import Frame, FrameReader, FrameWriter
from protocol.mavlink.signing import SigningClock
from protocol.mavlink.vehicle import BatteryReading, FlowReading, ImuReading, SensorReading
from protocol.named_tuple import of_members

FROZEN: Final = {"imu": "IMU", "flow": "optical flow", "range": "ultrasonic", "pressure": "pressure"}
"""Name of each sensor in the event."""
BATTERY_MAX_V: Final = 60.0
OTHER_VEHICLE: Final = 2**24
"""Kind of the datagrams of a second vehicle: no message id is so large."""
VELOCITY_FLOW_S: Final = 1.0 / 60.0
"""Time over which a flow in m/s is taken to be measured: its message does not say it."""
_CONFLICT_NS: Final = 5 * 10**9
_CONFLICT_COUNT: Final = 20
_EVENT_PERIOD_NS: Final = 10**9

Reading = SensorReading | BatteryReading
_imu_reading: Final = of_members(ImuReading)


class VehicleLinkConfig(ConfigRecord):
    """Limits of accepted readings, and the system ids."""

    vehicle_system: int = Field(default=0, ge=0, le=255, description="MAVLink system id; 0: of the first vehicle")
    own_system: int = Field(default=1, ge=1, le=255, description="MAVLink system id of motor commands")
    own_component: int = Field(default=1, ge=1, le=255, description="MAVLink component id: autopilot")
    acceleration_max_m_s2: float = Field(default=160.0, gt=0, description="m/s^2; more is a sensor fault")
    rate_max_rad_s: float = Field(default=36.0, gt=0, description="rad/s; more is a sensor fault")
    pressure_min_pa: float = Field(default=30_000.0, gt=0, description="Pa")
    pressure_max_pa: float = Field(default=120_000.0, gt=0, description="Pa")
    distance_max_m: float = Field(default=12.0, gt=0, description="m; more is a sensor fault")
    flow_rate_max_rad_s: float = Field(default=20.0, gt=0, description="rad/s; more is a sensor fault")
    frozen_samples: int = Field(default=8, ge=0, description="identical IMU samples that mean frozen; 0: off")
    frozen_flows: int = Field(default=8, ge=0, description="identical flows, not all 0, that mean frozen; 0: off")
    frozen_ranges: int = Field(default=75, ge=0, description="identical ranges that mean frozen; 0: off")
    frozen_pressures: int = Field(default=400, ge=0, description="identical pressures that mean frozen; 0: off")
    clock_restart_s: float = Field(default=0.5, gt=0, description="s; a larger step back is a restarted vehicle")
    late_max_s: float = Field(default=0.5, gt=0, description="s; older stamps of slow sensors are replaced by arrival")
    release_s: float = Field(default=10.0, gt=0, description="s of silence after which another vehicle is accepted")
    signing_tolerance_s: float = Field(default=60.0, gt=0, description="s; vehicle's signing clock against onboard's")
    health: LinkHealthConfig = LinkHealthConfig()


class RepeatCounter:
    """Counts identical readings of one sensor in a row."""

    def __init__(self, limit: int) -> None:
        """`limit`: repeats that mean a frozen sensor; 0: never."""
        self._limit = limit
        self._last: object = None
        self._same = 0

    def frozen(self, values: object) -> bool:
        """Add a reading; whether the sensor is frozen."""
        self._same = self._same + 1 if values == self._last else 0
        self._last = values
        return 0 < self._limit <= self._same


class VehicleLink:
    """Both directions of the link to the vehicle. Bytes from the vehicle never raise."""

    def __init__(
        self, config: VehicleLinkConfig, key: bytes | None = None, signing_clock: SigningClock | None = None
    ) -> None:
        """With a `key` unsigned frames are refused, and motor commands are signed.

        Raises ValueError if the key is not 32 bytes long.
        """
        self._config = config
        self._acceleration_max_m_s2, self._rate_max_rad_s = config.acceleration_max_m_s2, config.rate_max_rad_s
        self._pressures_pa = config.pressure_min_pa, config.pressure_max_pa
        clock = signing_clock or SigningClock()
        self._decoders = {
            wire.IMU: self._imu,
            wire.FLOWS[0]: self._flow,
            wire.FLOWS[1]: self._flow,
            wire.VELOCITY_FLOW: self._velocity_flow,
            wire.RANGE: self._range,
            wire.BATTERY_STATUS: self._battery,
            wire.SYSTEM_STATUS: self._battery,
            wire.HEARTBEAT: self._heartbeat,
        }
        self._reader = FrameReader(self._decoders, key, clock, config.signing_tolerance_s)
        self._writer = FrameWriter(config.own_system, config.own_component, key, clock)
        self._clock = VehicleClock(int(config.clock_restart_s * 1e9))
        self._release_ns = int(config.release_s * 1e9)
        self._late_ns = int(config.late_max_s * 1e9)
        self._events: list[tuple[int, str]] = []
        self._reported_ns: dict[str, int] = {}
        self._restarted_ns = NEVER_NS
        self._gyroscope: Vector3 = ZERO
        """Of the newest good IMU sample, rad/s."""
        self._imus = RepeatCounter(config.frozen_samples)
        self._flows = RepeatCounter(config.frozen_flows)
        self._ranges = RepeatCounter(config.frozen_ranges)
        self._pressures = RepeatCounter(config.frozen_pressures)
        self.rejected: Counter[str] = self._reader.rejected
        """What was dropped, by reason."""
        self.received = 0
        """Number of readings returned."""
        self.health = LinkHealth(config.health)
        """Whether the inertial stream is good enough for arming."""
        self.system = config.vehicle_system
        """System id of the vehicle; 0 before its first frame."""
        self.last_received_ns = NEVER_NS
        self.last_heartbeat_ns = NEVER_NS
        self.last_flow_ns = NEVER_NS
        """Arrival of the newest valid optical flow, of any quality."""
        self.conflict = False
        """Two vehicles seem to use one system id; arming is refused."""

    @property
    def restarts(self) -> int:
        """How often the vehicle's clock restarted."""
        return self._clock.restarts

    @property
    def newest_stamp_ns(self) -> int:
        """Time stamp of the newest IMU sample, vehicle's clock."""
        return self._clock.newest_ns

    def take_events(self) -> list[tuple[int, str]]:
        """Return and clear the events since the last call: (time_ns, text). At most one a second of each kind."""
        events, self._events = self._events, []
        return events

    def receive(self, datagram: bytes, now_ns: int) -> list[Reading]:
        """The good readings of one datagram, in its order, times in the onboard clock."""
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

    def screen(self, datagram: bytes) -> int:
        """The kind of a datagram, by its first frame: message id, or OTHER_VEHICLE; -1 if it would be refused."""
        found = self._reader.screen(datagram)
        if found is None:
            return -1
        message_id, system = found
        return message_id if self.system in (0, system) else OTHER_VEHICLE

    def encode_motors(self, fractions: Array | Sequence[float], armed: bool, now_ns: int) -> bytes:
        """Motor command, fractions 0..1 in PX4 quad-X order. Zeros unless armed, and if a fraction is not finite.

        Fractions outside 0..1 are clipped. `rejected["motor_command"]` counts commands that are not finite.
        """
        controls = wire.OFF
        if armed:
            f1, f2, f3, f4 = map(float, fractions)
            if 0.0 <= f1 <= 1.0 and 0.0 <= f2 <= 1.0 and 0.0 <= f3 <= 1.0 and 0.0 <= f4 <= 1.0:
                controls = (f1, f2, f3, f4)
            elif math.isfinite(f1 + f2 + f3 + f4):
                controls = (wire.clip(f1), wire.clip(f2), wire.clip(f3), wire.clip(f4))
            else:
                self.rejected["motor_command"] += 1
                armed = False
        return self._writer.write(wire.encode_motors(now_ns // 1000, controls, armed), now_ns)

    def _is_ours(self, frame: Frame, now_ns: int) -> bool:
        """Choose the vehicle: the first one that sends, until it is silent for long."""
        fixed = self._config.vehicle_system
        if not fixed and (self.system == 0 or now_ns - self.last_received_ns > self._release_ns):
            self._report("system", f"vehicle has system id {frame.system}", now_ns)
            self.system = frame.system
            self._clock.reset()
            self.health.reset()
            return True
        self.rejected["other_vehicle"] += 1
        self._report("other", f"a second vehicle (system id {frame.system}) is on the port and is ignored", now_ns)
        return False

    def _imu(self, frame: Frame, now_ns: int) -> Reading | None:
        reading = wire.decode_imu(frame.fields)
        if reading is None:
            return self._refuse("imu_fields")
        stamp_ns, accelerometer, gyroscope, pressure_pa = reading
        x, y, z = accelerometer
        most = self._acceleration_max_m_s2
        if not (-most <= x <= most and -most <= y <= most and -most <= z <= most):  # also catches NaN
            return self._refuse_axis("accelerometer", accelerometer, most, now_ns)
        x, y, z = gyroscope
        most = self._rate_max_rad_s
        if not (-most <= x <= most and -most <= y <= most and -most <= z <= most):
            return self._refuse_axis("gyroscope", gyroscope, most, now_ns)
        fault = self._clock.accept(stamp_ns, now_ns)
        if fault and not self._handle_clock(fault, now_ns):
            return None
        inertial = accelerometer + gyroscope
        if self._imus.frozen(inertial):
            return self._refuse_frozen("imu", now_ns)
        if pressure_pa is not None:
            pressure_pa = self._checked_pressure(pressure_pa, now_ns)
        self._gyroscope = gyroscope
        time_ns = self._clock.to_onboard(stamp_ns, now_ns)
        self.health.add(stamp_ns, now_ns - time_ns, now_ns, inertial)
        return _imu_reading((time_ns, accelerometer, gyroscope, pressure_pa))

    def _checked_pressure(self, pressure_pa: float, now_ns: int) -> float | None:
        """The pressure, Pa; None if it is refused. The rest of the sample is still used."""
        least_pa, most_pa = self._pressures_pa
        if not least_pa <= pressure_pa <= most_pa:
            self._refuse_sensor("pressure", pressure_pa, now_ns)
        elif self._pressures.frozen(pressure_pa):
            self._refuse_frozen("pressure", now_ns)
        else:
            return pressure_pa
        return None

    def _handle_clock(self, fault: str, now_ns: int) -> bool:
        """React to a bad time stamp; True if the sample may still be used."""
        again = now_ns - self._restarted_ns < _CONFLICT_NS
        if self._clock.interleaved >= _CONFLICT_COUNT or (fault == "restart" and again):
            self.conflict = True
            self._report("conflict", "vehicle time jumps back and forth: two vehicles with one system id?", now_ns)
        if fault == "jump":
            self._report("jump", "vehicle's clock jumped: clock mapped again", now_ns)
            return True
        if fault != "restart":
            self.rejected[fault] += 1
            self.health.count_backwards()
            return False
        self._restarted_ns = now_ns
        self.health.reset()
        self._report("restart", "vehicle restarted (its clock went backwards): clock mapped again", now_ns)
        return True

    def _flow(self, frame: Frame, now_ns: int) -> Reading | None:
        reading = wire.decode_flow(frame.fields)
        if reading is None or not 1e-3 <= reading.integration_s <= 0.5:
            return self._refuse("flow_time")
        return self._checked_flow(reading, reading[2:6], now_ns)

    def _velocity_flow(self, frame: Frame, now_ns: int) -> Reading | None:
        """OPTICAL_FLOW: the camera's rotation has been taken out with the gyroscope, so it is put in again with it."""
        flow = wire.decode_velocity_flow(frame.fields)
        if flow is None or not flow.distance_m <= self._config.distance_max_m:
            return self._refuse("flow_distance")
        return self._checked_flow(flow.over(VELOCITY_FLOW_S, self._gyroscope), flow[1:3], now_ns)

    def _checked_flow(self, reading: FlowReading, sent: tuple[float, ...], now_ns: int) -> Reading | None:
        """The reading if its angles are within limits and the values `sent` change."""
        limit = self._config.flow_rate_max_rad_s * reading.integration_s
        angles = reading[2:6]
        for value in angles:
            if not -limit <= value <= limit:
                return self._refuse_sensor("flow", value, now_ns)
        if self._flows.frozen(sent) and any(sent):  # a camera that sees nothing gives zeros
            return self._refuse_frozen("flow", now_ns)
        self.last_flow_ns = now_ns
        return reading._replace(time_ns=self._slow_time(reading.time_ns, now_ns))

    def _range(self, frame: Frame, now_ns: int) -> Reading | None:
        reading = wire.decode_range(frame.fields)
        if reading is None:
            return self._refuse("range_orientation")
        distance_m = reading.distance_m
        if not 0.0 < distance_m <= self._config.distance_max_m:
            return self._refuse("range")
        if self._ranges.frozen(distance_m) and distance_m > reading.least_m:  # on the ground it never changes
            return self._refuse_frozen("range", now_ns)
        return reading._replace(time_ns=self._slow_time(reading.time_ns, now_ns))

    def _battery(self, frame: Frame, now_ns: int) -> Reading | None:
        decode = wire.decode_battery if frame.message_id == wire.BATTERY_STATUS else wire.decode_system_status
        reading = decode(frame.fields, now_ns)
        if not 0.0 < reading.voltage_v < BATTERY_MAX_V or reading.remaining > 1.0:
            return self._refuse("battery")
        return reading

    def _heartbeat(self, frame: Frame, now_ns: int) -> Reading | None:
        self.last_heartbeat_ns = now_ns
        return None

    def _slow_time(self, stamp_ns: int, now_ns: int) -> int:
        """Onboard time of a slow sensor's stamp; the arrival if the stamp is not plausible."""
        time_ns = self._clock.to_onboard(stamp_ns, now_ns)
        return time_ns if self._clock.known and now_ns - time_ns <= self._late_ns else now_ns

    def _refuse(self, reason: str) -> Reading | None:
        self.rejected[reason] += 1
        return None

    def _refuse_axis(self, sensor: str, values: Vector3, limit: float, now_ns: int) -> Reading | None:
        """Refuse a sample for the first of its axes that is outside plus or minus `limit`."""
        return self._refuse_sensor(sensor, next(value for value in values if not -limit <= value <= limit), now_ns)

    def _refuse_sensor(self, sensor: str, value: float, now_ns: int) -> Reading | None:
        self._report(sensor, f"{sensor} gave {value:g}: sample ignored", now_ns)
        return self._refuse(sensor)

    def _refuse_frozen(self, sensor: str, now_ns: int) -> Reading | None:
        self._report(f"{sensor}_frozen", f"{FROZEN[sensor]} frozen: identical readings are ignored", now_ns)
        return self._refuse(f"{sensor}_frozen")

    def _report(self, kind: str, text: str, now_ns: int) -> None:
        if now_ns - self._reported_ns.get(kind, NEVER_NS) >= _EVENT_PERIOD_NS:
            self._reported_ns[kind] = now_ns
            self._events.append((now_ns, text))
