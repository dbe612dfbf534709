from collections.abc import Callable
from math import isfinite
from typing import Any, Final, Literal

from pydantic import Field, field_validator

from protocol.conventions import Array
from sim_vehicle.world.interface import Condition, Disturbance

AXES: Final = "xyz"


class GyroStuck(Disturbance):
    """One axis of the gyroscope gives the same rate in every sample, also to the optical flow; the others work."""

    axis: Literal["x", "y", "z"]
    rate_rad_s: float | None = Field(default=None, description="rad/s, body FRD; left out: its last value")

    @field_validator("rate_rad_s")
    @classmethod
    def _is_finite(cls, rate: float | None) -> float | None:
        if rate is not None and not isfinite(rate):
            raise ValueError("allowed is a finite number, or none for the last value")
        return rate

    def change(self, condition: Condition, drawn: Array) -> None:
        """Replace the axis in the samples of the IMU, and its integral in those of the flow, after earlier faults."""
        self._stick(condition, "imu", "gyroscope_rad_s", lambda sample: 1.0)
        self._stick(condition, "flow", "gyroscope_rad", lambda sample: float(sample.time_s))

    def _stick(self, condition: Condition, sensor: str, name: str, duration: Callable[[Any], float]) -> None:
        """duration: of a sample's integral, s; 1 for a rate."""
        before, index = condition.sensor_faults.get(sensor), AXES.index(self.axis)

        def sent(sample: Any, last: Any) -> Any:
            sample = sample if before is None else before(sample, last)
            if sample is None:
                return None
            values, from_ = list(getattr(sample, name)), sample if last is None else last
            rate = getattr(from_, name)[index] / duration(from_) if self.rate_rad_s is None else self.rate_rad_s
            values[index] = rate * duration(sample)
            return sample._replace(**{name: tuple(values)})

        condition.sensor_faults[sensor] = sent
