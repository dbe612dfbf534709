"""Faults of the sensors: what of a reading leaves the vehicle."""

from math import nan
from typing import Any, Final, TypeVar

from sim_vehicle.disturbances.world import World

SampleT = TypeVar("SampleT")

NOT_FINITE: Final[dict[str, dict[str, Any]]] = {
    "imu": {"accelerometer_m_s2": (nan, nan, nan), "gyroscope_rad_s": (nan, nan, nan)},
    "flow": {"flow_rad": (nan, nan)},
    "motion_capture": {"position_m": (nan, nan, nan)},
}
"""What of each sensor's reading becomes NaN."""


class SensorFaults:
    """Applies the faults that the world says are present."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._last: dict[str, Any] = {}

    def passed(self, sensor: str, sample: SampleT | None) -> SampleT | None:
        """The reading that is sent instead of `sample`; None: nothing is sent."""
        fault = self._world.faults.get(sensor)
        if fault is None:
            if sample is not None:
                self._last[sensor] = sample
            return sample
        if fault == "frozen":
            return self._last.get(sensor)
        if fault == "not_finite" and sample is not None:
            spoilt: SampleT = sample._replace(**NOT_FINITE[sensor])  # type: ignore[attr-defined]
            return spoilt
        return None
