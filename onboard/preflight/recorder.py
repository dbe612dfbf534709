"""Records the readings of a vehicle and a motion capture during one step of the preflight check, as arrays."""

from collections import Counter
from typing import Final, NamedTuple, TypeVar

import numpy as np

from onboard.links.vehicle import VehicleLink, VehicleLinkConfig
from protocol.conventions import Array
from protocol.mavlink.signing import SigningClock
from protocol.mavlink.vehicle import BatteryReading, FlowReading, ImuReading, RangeReading

RowT = TypeVar("RowT")

IMU_MAX: Final = 20_000
OTHERS_MAX: Final = 5_000
"""Most readings of a kind in one step."""
ANY_UNIT: Final = {"acceleration_max_m_s2": 40_000.0, "rate_max_rad_s": 3_000.0}
"""Limits so wide that readings in milli-g or degrees per second are recorded and recognised."""


class PoseSample(NamedTuple):
    """A pose of the motion capture."""

    time_ns: int
    position: tuple[float, float, float]
    """m, world NED."""
    quaternion: tuple[float, float, float, float]
    """wxyz, body to world."""


class StepData(NamedTuple):
    """The readings of one step. Times are in seconds of our clock, except `imu_stamp_s`."""

    imu_arrival_s: Array
    imu_stamp_s: Array
    """[n], the vehicle's clock."""
    imu_delay_s: Array
    """[n], delay beyond that of the fastest sample."""
    accelerometer: Array
    """[n, 3]."""
    gyroscope: Array
    """[n, 3]."""
    pressure_pa: Array
    """[n], 0 in samples without pressure."""
    flow: Array
    """[m, 6]: flow x, y, rotation x, y [rad], integration time [s], quality."""
    flow_arrival_s: Array
    range_m: Array
    range_arrival_s: Array
    battery_v: Array
    poses: Array
    """[k, 7]: position NED [m], quaternion wxyz."""
    pose_s: Array
    heartbeats: int
    rejected: Counter[str]
    """What the vehicle link dropped, by reason."""
    restarts: int
    conflict: bool


class StepRecorder:
    """A vehicle link that records. `begin` starts a step, `end` returns its readings."""

    def __init__(
        self, config: VehicleLinkConfig, key: bytes | None = None, signing_clock: SigningClock | None = None
    ) -> None:
        self.link = VehicleLink(config.model_copy(update=ANY_UNIT), key, signing_clock)
        self.begin()

    def begin(self) -> None:
        """Start a step with nothing recorded."""
        self._imu: list[tuple[float, ...]] = []
        self._flow: list[tuple[float, ...]] = []
        self._range: list[tuple[float, ...]] = []
        self._battery: list[float] = []
        self._poses: list[tuple[float, ...]] = []
        self._heartbeats = 0
        self._before = self.link.rejected.copy()
        self._restarts_before = self.link.restarts

    def receive(self, datagram: bytes, now_ns: int) -> None:
        """Record a datagram of the vehicle."""
        now_s = now_ns * 1e-9
        heartbeat_ns = self.link.last_heartbeat_ns
        for reading in self.link.receive(datagram, now_ns):
            if isinstance(reading, ImuReading):
                delay_s = (now_ns - reading.time_ns) * 1e-9
                stamp_s = self.link.newest_stamp_ns * 1e-9
                row = (now_s, stamp_s, delay_s, *reading.accelerometer, *reading.gyroscope, reading.pressure_pa or 0.0)
                _append(self._imu, row, IMU_MAX)
            elif isinstance(reading, FlowReading):
                _append(self._flow, (*reading[2:6], reading.integration_s, reading.quality, now_s), OTHERS_MAX)
            elif isinstance(reading, RangeReading):
                _append(self._range, (reading.distance_m, now_s), OTHERS_MAX)
            elif isinstance(reading, BatteryReading):
                _append(self._battery, reading.voltage_v, OTHERS_MAX)
        self._heartbeats += self.link.last_heartbeat_ns != heartbeat_ns

    def receive_pose(self, pose: PoseSample) -> None:
        """Record a pose of the motion capture."""
        _append(self._poses, (*pose.position, *pose.quaternion, pose.time_ns * 1e-9), OTHERS_MAX)

    def end(self) -> StepData:
        """The readings since `begin`."""
        imu = np.array(self._imu, dtype=np.float64).reshape(-1, 10)
        flow = np.array(self._flow, dtype=np.float64).reshape(-1, 7)
        ranges = np.array(self._range, dtype=np.float64).reshape(-1, 2)
        poses = np.array(self._poses, dtype=np.float64).reshape(-1, 8)
        if len(poses):  # q and -q are the same rotation; a mean needs one sign
            poses[:, 3:7] *= np.where(poses[:, 3:7] @ poses[0, 3:7] < 0.0, -1.0, 1.0)[:, None]
        return StepData(
            imu_arrival_s=imu[:, 0],
            imu_stamp_s=imu[:, 1],
            imu_delay_s=imu[:, 2],
            accelerometer=imu[:, 3:6],
            gyroscope=imu[:, 6:9],
            pressure_pa=imu[:, 9],
            flow=flow[:, :6],
            flow_arrival_s=flow[:, 6],
            range_m=ranges[:, 0],
            range_arrival_s=ranges[:, 1],
            battery_v=np.array(self._battery, dtype=np.float64),
            poses=poses[:, :7],
            pose_s=poses[:, 7],
            heartbeats=self._heartbeats,
            rejected=self.link.rejected - self._before,
            restarts=self.link.restarts - self._restarts_before,
            conflict=self.link.conflict,
        )


def _append(rows: list[RowT], row: RowT, most: int) -> None:
    if len(rows) < most:
        rows.append(row)
