"""Many vehicles of one kind at once: dynamics and world, without sensors and link.

For training and for studies that need the true state only. A vehicle of the batch moves exactly as a SimVehicle of the
same seed under the same commands; the test of that is what keeps the two together.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

import sim_vehicle.physics.layout as at
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.physics.advance import SOUND, WORK_ROWS, advance, verdict
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.disturb import knowing
from sim_vehicle.physics.limits import flight_limits
from sim_vehicle.physics.packing import SUBSTEP_NS
from sim_vehicle.records import Array
from sim_vehicle.vehicle import initial_state
from sim_vehicle.world.world import World

LONGEST_STEP: Final = 400
"""Sub-steps in one call of `step`."""


class VehicleBatch:
    """One configuration, one vehicle per seed."""

    def __init__(self, config: SimVehicleConfig, seeds: Sequence[int]) -> None:
        self._config = config
        self._worlds = [World(config, seed) for seed in seeds]
        self._advance_all = knowing(advance_all, config.disturbances)
        first = self._worlds[0]
        self.states: Array = np.tile(initial_state(config), (len(seeds), 1))
        """[vehicles, STATE_SIZE], see layout.py; position, velocity, quaternion and rates are the first 13."""
        self._parameters: Array = np.zeros((len(seeds), at.PARAMETERS_SIZE))
        self._rows: Array = first.rows
        self._memories: Array = np.stack([world.memories for world in self._worlds])
        self._sums: Array = np.zeros((len(seeds), at.SUMS_SIZE))
        self._work: Array = np.zeros((WORK_ROWS, at.RIGID))
        self._limits: Array = flight_limits(config)
        self.lost = np.zeros(len(seeds), dtype=np.bool_)
        """[vehicles] whether a flight is lost; its motors are off from then on."""
        self.time_ns = 0
        """Flight time."""
        self._apply_worlds()

    def step(self, commands: Array, substeps: int = 5) -> None:
        """Advance all by `substeps` ms under commands[vehicles, 4] (fractions; zero is off).

        Raises
        ------
        ValueError
            If the commands have another shape, or the step is longer than LONGEST_STEP.
        """
        if commands.shape != (len(self._worlds), 4) or not 0 < substeps <= LONGEST_STEP:
            raise ValueError(f"commands of shape {commands.shape} and {substeps} sub-steps cannot be run")
        end_ns = self.time_ns + substeps * SUBSTEP_NS
        while self.time_ns < end_ns:
            count = (min(end_ns, self._worlds[0].next_event_ns) - self.time_ns) // SUBSTEP_NS
            self._advance_all(
                self.states,
                np.ascontiguousarray(commands, dtype=np.float64),
                self._parameters,
                self._rows,
                self._memories,
                self._noise(count),
                self._sums,
                self._work,
                self._limits,
                self.lost,
                self.time_ns * 1e-9,
                count,
            )
            self.time_ns += count * SUBSTEP_NS
            if self.time_ns >= self._worlds[0].next_event_ns:
                self._apply_worlds()

    def _apply_worlds(self) -> None:
        for world, parameters in zip(self._worlds, self._parameters, strict=True):
            world.apply(self.time_ns)
            parameters[:] = world.condition.parameters

    def _noise(self, count: int) -> Array:
        if len(self._rows) == 0:
            return np.zeros((len(self._worlds), count, 0, at.NOISE_PER_ROW))
        return np.stack([world.normals.take(count) for world in self._worlds])


@compiled
def advance_all(
    states: Array,
    commands: Array,
    parameters: Array,
    rows: Array,
    memories: Array,
    noise: Array,
    sums: Array,
    work: Array,
    limits: Array,
    lost: NDArray[np.bool_],
    time_s: float,
    count: int,
) -> None:
    """`advance` for each vehicle; arrays have a leading vehicle axis, except rows, work and limits.

    The clearing of `sums` keeps the sums of long batches from growing; nothing here reads them but the verdict.
    """
    for k in range(states.shape[0]):
        if lost[k]:
            commands[k, :] = 0.0
        advance(states[k], commands[k], parameters[k], rows, memories[k], noise[k], sums[k], work, time_s, count)
        if not lost[k] and verdict(states[k], sums[k], limits) != SOUND:
            lost[k] = True
        sums[k, : at.TOUCH_SPEED] = 0.0
