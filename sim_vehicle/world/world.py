"""The disturbances of one flight: draws their random values, fills the rows of the compiled step, and changes the
vehicle's condition when one begins or ends.
"""

from math import ceil, inf

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.physics.draws import SubstepNormals
from sim_vehicle.physics.packing import SUBSTEP_NS, pack_parameters, set_mass
from sim_vehicle.world.catalogue import acting_classes
from sim_vehicle.world.interface import Condition, Disturbance

WORLD_STREAM = 100
"""Disturbance number k draws from the stream [seed, WORLD_STREAM + k]."""
ROW_STREAM = 99
"""All rows draw from [seed, ROW_STREAM, 0] at the start, and from [seed, ROW_STREAM, 1] in each sub-step."""
NEVER_NS = 2**63 - 1


class World:
    """The disturbances of one flight, resolved from its seed."""

    def __init__(self, config: SimVehicleConfig, seed: int, bare: Array | None = None) -> None:
        """bare: what pack_parameters gives for this configuration, if it is known already."""
        self._config = config
        self._bare = pack_parameters(config) if bare is None else bare
        self.disturbances = [
            (one, one.draw(np.random.default_rng([seed, WORLD_STREAM + k])))
            for k, one in enumerate(config.disturbances)
        ]
        """Each with what it drew, in the order of the scenario."""
        acting = [one for one in config.disturbances if one.acts()]
        numbers = acting_classes(config.disturbances)
        rng = np.random.default_rng([seed, ROW_STREAM, 0])
        self.rows = _table([_row(one, numbers.index(type(one))) for one in acting])
        """[k, at.ROW_VALUES + values]: one row per disturbance that acts in every sub-step."""
        self.memories = _table([one.start(rng.standard_normal(at.NOISE_PER_ROW)) for one in acting])
        """[k, values]"""
        self.normals = SubstepNormals(np.random.default_rng([seed, ROW_STREAM, 1]), len(acting), at.NOISE_PER_ROW)
        """[sub-steps, k, NOISE_PER_ROW]"""
        self.next_event_ns = 0
        """When `apply` is due again."""
        self.condition: Condition
        """At present."""
        self.apply(0)

    def apply(self, now_ns: int) -> None:
        """Set the condition that the disturbances active at `now_ns` cause."""
        condition = self.condition = Condition(self._bare.copy())
        for one, drawn in self.disturbances:
            if _onset_ns(one) <= now_ns < _end_ns(one):
                one.change(condition, drawn)
        if condition.payloads:
            body = self._config.body
            set_mass(condition.parameters, body.mass_kg, body.inertia_kg_m2, body.centre_of_mass_m, condition.payloads)
        times = [time for one, _ in self.disturbances for time in (_onset_ns(one), _end_ns(one))]
        self.next_event_ns = min((time for time in times if time > now_ns), default=NEVER_NS)


def _row(one: Disturbance, number: int) -> tuple[float, ...]:
    return (number, one.stage, one.onset_s, inf if one.end_s is None else one.end_s, *one.values())


def _table(rows: list[tuple[float, ...]]) -> Array:
    """The rows as one array, zeros at their ends."""
    table = np.zeros((len(rows), max(map(len, rows), default=0)))
    for into, row in zip(table, rows, strict=True):
        into[: len(row)] = row
    return table


def _onset_ns(one: Disturbance) -> int:
    return ceil(round(one.onset_s * 1e9) / SUBSTEP_NS) * SUBSTEP_NS


def _end_ns(one: Disturbance) -> int:
    return NEVER_NS if one.end_s is None else ceil(round(one.end_s * 1e9) / SUBSTEP_NS) * SUBSTEP_NS
