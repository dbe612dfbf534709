"""Many vehicles of one kind at once: dynamics and disturbances, without sensors and link.

For training and for studies that need the true state only. A vehicle of the batch moves exactly like a SimVehicle with
the same seed and commands; a test compares the two. Each vehicle has its own flight time, and can start again while
the others fly on.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, TypeAlias

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
from sim_vehicle.physics.packing import SUBSTEP_NS, pack_parameters
from sim_vehicle.vehicle import initial_state
from sim_vehicle.world.world import World

NOISE_BLOCK: Final = SUBSTEPS_MAX
"""Sub-steps whose random draws are stored ahead."""
Integers = NDArray[np.int64]
Map: TypeAlias = Callable[[Callable[[tuple[Any, ...]], int], Iterable[tuple[Any, ...]]], Iterable[int]]
"""`map`, or one that works side by side, such as that of a pool of threads: compiled code lets other threads run."""


class VehicleBatch:
    """One vehicle per seed."""

    def __init__(self, config: SimVehicleConfig, seeds: Sequence[int], parts: int = 1, run: Map = map) -> None:
        """parts: of the batch, which `run` steps; the result depends on neither.

        Raises
        ------
        ValueError
            For another physics than the own one, or more parts than vehicles.
        """
        if not 1 <= parts <= len(seeds):
            raise ValueError(f"{parts} parts: allowed are 1 to {len(seeds)}, the vehicles")
        if config.physics != "own":
            raise ValueError(f"vehicle.physics: {config.physics!r}: a batch has 'own' only")
        self._bare = config, pack_parameters(config)
        n, first = len(seeds), World(config, seeds[0], self._bare[1])
        self._kinds = [type(one) for one in config.disturbances]
        self._worlds = [first] * n
        self._advance_all = for_disturbances(advance_all, config.disturbances)
        self.states: Array = np.zeros((n, at.STATE_SIZE))
        """[vehicles, STATE_SIZE], see layout.py. The first 13 are position, velocity, quaternion and rates."""
        self._parameters: Array = np.zeros((n, at.PARAMETERS_SIZE))
        self._rows: Array = np.zeros((n, *first.rows.shape))
        self._memories: Array = np.zeros((n, *first.memories.shape))
        self._noise: Array = np.zeros((n, NOISE_BLOCK, len(first.rows), at.NOISE_PER_ROW))
        self._sums: Array = np.zeros((n, at.SUMS_SIZE))
        self._limits: Array = np.zeros((n, crash_limits(config).size))
        self.crashed = np.zeros(n, dtype=np.bool_)
        """[vehicles] whether it has crashed; its motors are off from then on."""
        self._clock: Integers = np.zeros((4, n), dtype=np.int64)
        self._now_ns: Integers = self._clock[0]
        self._event_ns, self._left, self._drawn = self._clock[1:]
        self._commands: Array = np.zeros((n, 4))
        self._parts = [self._part(slice(part[0], part[-1] + 1)) for part in np.array_split(np.arange(n), parts)]
        self._run = run
        for vehicle, seed in enumerate(seeds):
            self.reset(vehicle, config, seed)

    def _part(self, rows: slice) -> tuple[Any, ...]:
        """The arguments of `advance_all` for some of the vehicles."""
        of_each = (self.states, self._commands, self._parameters, self._rows, self._memories, self._noise, self._sums)
        work: Array = np.zeros((WORK_ROWS, at.RIGID))
        views = [array[rows] for array in of_each]
        return *views, work, self._limits[rows], self.crashed[rows], self._clock[:, rows]

    @property
    def time_ns(self) -> int:
        """Flight time of the first vehicle."""
        return int(self._now_ns[0])

    @property
    def times_ns(self) -> Integers:
        """[vehicles], flight time of each; a view."""
        return self._now_ns

    def reset(self, vehicle: int, config: SimVehicleConfig, seed: int) -> None:
        """Start one vehicle again at flight time 0, in another configuration with disturbances of the same kinds.

        Raises
        ------
        ValueError
            If the disturbances are of other kinds, or the physics is not the own one.
        """
        if [type(one) for one in config.disturbances] != self._kinds or config.physics != "own":
            raise ValueError(
                "a vehicle of a batch starts again with disturbances of the same kinds and own physics only"
            )
        if config is not self._bare[0]:
            self._bare = config, pack_parameters(config)
        world = self._worlds[vehicle] = World(config, seed, self._bare[1])
        self.states[vehicle] = initial_state(config)
        self._rows[vehicle], self._memories[vehicle] = world.rows, world.memories
        self._sums[vehicle] = 0.0
        self._limits[vehicle] = crash_limits(config)
        self.crashed[vehicle] = False
        self._now_ns[vehicle], self._left[vehicle], self._drawn[vehicle] = 0, 0, NOISE_BLOCK
        self._apply(vehicle)

    def step(self, commands: Array, substeps: int = 5, still: NDArray[np.bool_] | None = None) -> None:
        """Advance all by `substeps` ms under commands[vehicles, 4] (fractions; zero is off).

        still: [vehicles], true for vehicles whose time stands still in this step; None: none.

        Raises
        ------
        ValueError
            If the commands have another shape, or there are no sub-steps or more than SUBSTEPS_MAX.
        """
        if commands.shape != (len(self._worlds), 4) or not 0 < substeps <= SUBSTEPS_MAX:
            raise ValueError(f"commands of shape {commands.shape} and {substeps} sub-steps cannot be run")
        self._left[:] = substeps
        if still is not None:
            self._left[still] = 0
        self._commands[:] = commands
        while sum(self._run(self._advance, self._parts)):
            for vehicle in np.flatnonzero(self._now_ns >= self._event_ns).tolist():
                self._apply(vehicle)
            for vehicle in np.flatnonzero(self._drawn >= NOISE_BLOCK).tolist():
                self._noise[vehicle] = self._worlds[vehicle].normals.take(NOISE_BLOCK)
                self._drawn[vehicle] = 0

    def _advance(self, part: tuple[Any, ...]) -> int:
        """Advance the vehicles of a part to their next wait; return how many wait."""
        waiting: int = self._advance_all(*part)
        return waiting

    def _apply(self, vehicle: int) -> None:
        """Begin and end the disturbances that are due."""
        world = self._worlds[vehicle]
        world.apply(int(self._now_ns[vehicle]))
        self._parameters[vehicle] = world.condition.parameters
        self._parameters[vehicle, at.SUM_SENSORS] = 0.0
        self._event_ns[vehicle] = world.next_event_ns


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
    clock: Integers,
) -> int:
    """`advance` for each vehicle. Arrays have a leading axis of vehicles, except work and clock.

    A vehicle stops at its next event, and where its draws are used up. Only `check_crash` reads the sums here. The
    others are zeroed, so that they do not grow without bound.

    Parameters
    ----------
    clock: [4, vehicles]: flight time ns, time of the next event ns, sub-steps that are left, draws that are used.

    Returns
    -------
    How many vehicles wait: for an event or for draws.
    """
    waiting = 0
    for k in range(states.shape[0]):
        before_event = (clock[1, k] - clock[0, k]) // SUBSTEP_NS
        count = min(clock[2, k], before_event, noise.shape[1] - clock[3, k])
        if count > 0:
            if crashed[k]:
                commands[k, :] = 0.0
            now_s, draws = clock[0, k] * 1e-9, noise[k, clock[3, k] :]
            advance(states[k], commands[k], parameters[k], rows[k], memories[k], draws, sums[k], work, now_s, count)
            if not crashed[k] and check_crash(states[k], sums[k], limits[k]) != NO_CRASH:
                crashed[k] = True
            sums[k, : at.TOUCH_SPEED] = 0.0
            clock[0, k] += count * SUBSTEP_NS
            clock[2, k] -= count
            clock[3, k] += count
        if clock[2, k] > 0 or clock[0, k] >= clock[1, k]:
            waiting += 1
    return waiting
