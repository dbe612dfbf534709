"""From the simulated vehicle's MAVLink to what the firmware's structures hold.

Each 200 Hz sample becomes five of 1 kHz with a spread whose mean is zero. The flow becomes a velocity with the height
that the firmware knows: the median of its last echoes.
"""

from collections import deque
from statistics import median
from typing import Final

import numpy as np

from mambo.fake.wire import FIFO_SAMPLES, FlowCall, Sensors
from protocol.conventions import Array
from protocol.mavlink import vehicle as wire
from protocol.mavlink.frames import FrameReader

ACCELEROMETER_SPREAD: Final = 0.3
"""m/s^2, standard deviation of the five samples around their mean. C."""
GYROSCOPE_SPREAD: Final = 0.02
"""rad/s. C."""
ECHOES: Final = 3
"""That the firmware takes the median of. C."""
START_HEIGHT_M: Final = 0.44
"""Before the first echo: the least that the sensor gives."""


class FirmwareSensors:
    """The sensors as the firmware has them. key: of the vehicle's MAVLink."""

    def __init__(self, seed: int, key: bytes | None = None) -> None:
        kinds = (wire.IMU, *wire.FLOWS, wire.RANGE, wire.BATTERY_STATUS, wire.HEARTBEAT)
        self._reader = FrameReader(kinds, key, tolerance_s=None)
        self._rng = np.random.default_rng([seed, 0xF1F0])
        self._sensors = Sensors(np.zeros((FIFO_SAMPLES, 3)), np.zeros((FIFO_SAMPLES, 3)), 101325.0, 0.0, 0.0, 0)
        self._echoes: deque[float] = deque([START_HEIGHT_M], maxlen=ECHOES)
        self._flow: FlowCall | None = None

    def receive(self, datagram: bytes, now_ns: int) -> None:
        """A datagram of the simulated vehicle."""
        for frame in self._reader.read(datagram, now_ns):
            match frame.message_id:
                case wire.IMU:
                    self._receive_imu(wire.decode_imu(frame.fields))
                case wire.RANGE:
                    self._receive_range(wire.decode_range(frame.fields))
                case wire.BATTERY_STATUS:
                    battery = wire.decode_battery(frame.fields, now_ns)
                    percent = max(0, round(100.0 * battery.remaining))
                    self._sensors = self._sensors._replace(battery_v=battery.voltage_v, battery_percent=percent)
                case wire.HEARTBEAT:
                    pass
                case _:
                    self._receive_flow(wire.decode_flow(frame.fields))

    def _receive_imu(self, reading: wire.ImuReading | None) -> None:
        if reading is None:
            return
        pressure_pa = self._sensors.pressure_pa if reading.pressure_pa is None else reading.pressure_pa
        self._sensors = self._sensors._replace(
            accelerometer=self._batch(reading.accelerometer, ACCELEROMETER_SPREAD),
            gyroscope=self._batch(reading.gyroscope, GYROSCOPE_SPREAD),
            pressure_pa=pressure_pa,
        )

    def _batch(self, mean: tuple[float, float, float], spread: float) -> Array:
        """[5, 3] samples with this mean."""
        off = self._rng.standard_normal((FIFO_SAMPLES, 3)) * spread
        batch: Array = np.array(mean) + off - off.mean(axis=0)
        return batch

    def _receive_range(self, reading: wire.RangeReading | None) -> None:
        if reading is not None:
            self._echoes.append(reading.distance_m)
            self._sensors = self._sensors._replace(altitude_m=reading.distance_m)

    def _receive_flow(self, reading: wire.FlowReading | None) -> None:
        """Velocity over ground, the camera's rotation taken out: docs/conventions.md has the signs."""
        if reading is None or reading.integration_s <= 0.0:
            return
        share = median(self._echoes) / reading.integration_s
        velocity = (
            (reading.flow_y - reading.rotation_y) * share,
            -(reading.flow_x - reading.rotation_x) * share,
            0.0,
        )
        self._flow = FlowCall(velocity, int(reading.quality > 0), reading.quality / 255.0)

    def take(self) -> tuple[Sensors, FlowCall | None]:
        """The acquisition of this call, and the flow call before it, if any."""
        flow, self._flow = self._flow, None
        return self._sensors, flow
