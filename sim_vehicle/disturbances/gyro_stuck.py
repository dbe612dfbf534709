from math import isfinite
from typing import Any, Final, Literal

from pydantic import Field, field_validator

from protocol.conventions import Array
from sim_vehicle.world.interface import Condition, Disturbance

AXES: Final = "xyz"


class GyroStuck(Disturbance):
    """One axis of the gyroscope gives the same rate in every sample; the rest of the IMU works."""

    axis: Literal["x", "y", "z"]
    rate_rad_s: float | None = Field(default=None, description="rad/s, body FRD; left out: its last value")

    @field_validator("rate_rad_s")
    @classmethod
    def _is_finite(cls, rate: float | None) -> float | None:
        if rate is not None and not isfinite(rate):
            raise ValueError("allowed is a finite number, or none for the last value")
        return rate

    def change(self, condition: Condition, drawn: Array) -> None:
        """Replace the axis in the samples of the IMU, after an earlier fault of it, if there is one."""
        before, index = condition.sensor_faults.get("imu"), AXES.index(self.axis)

        def sent(sample: Any, last: Any) -> Any:
            sample = sample if before is None else before(sample, last)
            if sample is None:
                return None
            rates = list(sample.gyroscope_rad_s)
            held = last.gyroscope_rad_s[index] if last is not None else rates[index]
            rates[index] = held if self.rate_rad_s is None else self.rate_rad_s
            return sample._replace(gyroscope_rad_s=tuple(rates))

        condition.sensor_faults["imu"] = sent
