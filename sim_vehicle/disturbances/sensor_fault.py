from math import nan
from typing import Any, Final, Literal

from pydantic import model_validator

from protocol.conventions import Array
from sim_vehicle.world.interface import Condition, Disturbance

NOT_FINITE: Final[dict[str, dict[str, Any]]] = {
    "imu": {"accelerometer_m_s2": (nan, nan, nan), "gyroscope_rad_s": (nan, nan, nan)},
    "flow": {"flow_rad": (nan, nan)},
    "motion_capture": {"position_m": (nan, nan, nan)},
}
"""The fields of each sensor's sample that become NaN. Ultrasonic and battery send whole numbers."""


class SensorFault(Disturbance):
    """A sensor sends nothing, repeats its last sample with fresh time stamps, or sends NaN."""

    sensor: Literal["imu", "flow", "ultrasonic", "battery", "motion_capture"]
    fault: Literal["silent", "frozen", "not_finite"]

    @model_validator(mode="after")
    def _can_be_sent(self) -> "SensorFault":
        if self.fault == "not_finite" and self.sensor not in NOT_FINITE:
            raise ValueError(f"{self.sensor} sends whole numbers, which are always finite")
        return self

    def change(self, condition: Condition, drawn: Array) -> None:
        """Replace the samples of the sensor."""
        condition.sensor_faults[self.sensor] = self._sent

    def _sent(self, sample: Any, last: Any) -> Any:
        if self.fault == "frozen":
            return last
        if self.fault == "not_finite" and sample is not None:
            return sample._replace(**NOT_FINITE[self.sensor])
        return None
