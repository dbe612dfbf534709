"""Many vehicles of one kind at once: dynamics and disturbances, without sensors and link.

For training and for studies that need the true state only. A vehicle of the batch moves exactly like a SimVehicle with
the same seed and commands; a test compares the two.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.physics.advance import WORK_ROWS, advance
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.crash import NO_CRASH, check_crash, crash_limits
from sim_vehicle.physics.disturb import for_disturbances
from sim_vehicle.physics.draws import SUBSTEPS_MAX
from sim_vehicle.physics.packing import SUBSTEP_NS
from sim_vehicle.vehicle import initial_state
from sim_vehicle.world.world import World


class VehicleBatch:
    """One configuration, one vehicle per seed. Raises ValueError for another physics than the own one."""

    def __init__(self, config: SimVehicleConfig, seeds: Sequence[int]) -> None:
        if config.physics != "own":
            raise ValueError(f"vehicle.physics: {config.physics!r}: a batch has 'own' only")
        self._config = config
        self._worlds = [World(config, seed) for seed in seeds]
        self._advance_all = for_disturbances(advance_all, config.disturbances)
        first = self._worlds[0]
        self.states: Array = np.tile(initial_state(config), (len(seeds), 1))
        """[vehicles, STATE_SIZE], see layout.py. The first 13 are position, velocity, quaternion and rates."""
        self._parameters: Array = np.zeros((len(seeds), at.PARAMETERS_SIZE))
        self._rows: Array = first.rows
        self._memories: Array = np.stack([world.memories for world in self._worlds])
        self._sums: Array = np.zeros((len(seeds), at.SUMS_SIZE))
        self._work: Array = np.zeros((WORK_ROWS, at.RIGID))
        self._limits: Array = crash_limits(config)
        self.crashed = np.zeros(len(seeds), dtype=np.bool_)
        """[vehicles] whether it has crashed; its motors are off from then on."""
        self.time_ns = 0
        """Flight time."""
        self._apply_worlds()

    def step(self, commands: Array, substeps: int = 5) -> None:
        """Advance all by `substeps` ms under commands[vehicles, 4] (fractions; zero is off).

        Raises
        ------
        ValueError
            If the commands have another shape, or there are no sub-steps or more than SUBSTEPS_MAX.
        """
        if commands.shape != (len(self._worlds), 4) or not 0 < substeps <= SUBSTEPS_MAX:
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
                self.crashed,
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
    crashed: NDArray[np.bool_],
    time_s: float,
    count: int,
) -> None:
    """`advance` for each vehicle. Arrays have a leading axis of vehicles, except rows, work and limits.

    Only `check_crash` reads the sums here. The others are zeroed, so that they do not grow without bound.
    """
    for k in range(states.shape[0]):
        if crashed[k]:
            commands[k, :] = 0.0
        advance(states[k], commands[k], parameters[k], rows, memories[k], noise[k], sums[k], work, time_s, count)
        if not crashed[k] and check_crash(states[k], sums[k], limits) != NO_CRASH:
            crashed[k] = True
        sums[k, : at.TOUCH_SPEED] = 0.0
