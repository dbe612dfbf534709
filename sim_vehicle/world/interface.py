"""The interface of a disturbance.

A disturbance is a configuration record with methods. It acts in one or both of these ways:

- `change` changes the vehicle's `Condition` when the disturbance begins. The change ends with it.
- `act` runs in every 1 ms sub-step. It is a static function that numba can compile, where numba is installed.

To add one, put a file into sim_vehicle/disturbances: `kind: fan_jet` is the class FanJet of fan_jet.py. No other file
changes. A disturbance outside the project is named by its class, `kind: my_module:MyGust` or
`kind: my_file.py:MyGust` (docs/vehicle.md).

Several disturbances of the same kind add up; factors multiply. All random values come from the flight's seed.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.random import Generator
from pydantic import Field, model_validator

import sim_vehicle.physics.layout as at
from configs.loader import ConfigRecord
from protocol.conventions import Array
from protocol.geometry import Vector3

SensorFunction: TypeAlias = Callable[[Any, Any], Any]
"""From a sensor's sample (or None) and its last sample without a fault (or None) to what is sent (None: nothing)."""


@dataclass
class Condition:
    """What `change` may change."""

    parameters: Array
    """[PARAMETERS_SIZE], see sim_vehicle.physics.layout."""
    payloads: list[tuple[float, Vector3]] = field(default_factory=list)
    """Point masses on the frame: kg, and m from the reference point, body FRD."""
    shaking: Array = field(default_factory=lambda: np.zeros((4, 2)))
    """[4, 2] effect of each rotor's imbalance at hover speed on accelerometer (m/s^2) and gyro (rad/s)."""
    sensor_faults: dict[str, SensorFunction] = field(default_factory=dict)
    """By sensor: imu, flow, ultrasonic, battery, motion_capture."""
    clock_jump_ns: int = 0
    """Error of the vehicle's clock."""


class Disturbance(ConfigRecord):
    """Base of every disturbance. Times are flight time; 0 is the start."""

    onset_s: float = Field(default=0.0, ge=0.0, description="s, flight time")
    end_s: float | None = Field(default=None, gt=0.0, description="s, flight time; left out: until the flight ends")
    kind: str = Field(
        default="", description="name of a file in sim_vehicle/disturbances, module:Class or file.py:Class"
    )
    """Needed in a file; a record that is built in Python gets it by its class (catalogue.kind_of)."""

    stage: ClassVar[int] = at.LOAD
    """When `act` runs: at.MEAN_AIR, at.TURBULENCE (effect[AIR_SPEED] is known) or at.LOAD (state[WIND] is known)."""

    @model_validator(mode="after")
    def _ends_after_onset(self) -> "Disturbance":
        if self.end_s is not None and self.end_s <= self.onset_s:
            raise ValueError(f"end_s {self.end_s} is not after onset_s {self.onset_s}")
        return self

    def draw(self, rng: Generator) -> Array:
        """Values that are random but constant in a flight. `rng` belongs to this disturbance alone."""
        return np.zeros(0)

    def change(self, condition: Condition, drawn: Array) -> None:
        """Change the condition. drawn: from `draw`."""

    def values(self) -> tuple[float, ...]:
        """Settings that `act` reads."""
        return ()

    def start(self, normals: Array) -> tuple[float, ...]:
        """Initial memory of `act`. normals: [3] unit normal draws."""
        return ()

    @staticmethod
    def act(v: Array, memory: Array, time_s: float, state: Array, P: Array, noise: Array, effect: Array) -> None:
        """Add to `effect`, in every sub-step.

        Parameters
        ----------
        v: from `values`. memory: from `start`, kept between sub-steps. time_s: s since the onset.
        state: [STATE_SIZE] of the vehicle. P: [PARAMETERS_SIZE]. noise: [3] unit normal draws of this sub-step.
        effect: [EFFECT_SIZE] air velocity NED m/s, force NED N, torque about the reference point N m body FRD, drop
        of the battery voltage V. Indices into state, P and effect: sim_vehicle.physics.layout.
        """

    @classmethod
    def acts(cls) -> bool:
        """Whether the class has an `act`."""
        return cls.act is not Disturbance.act
