"""The world: turns a scenario's disturbances into what the compiled step reads, and changes it at onset and end.

What changes only at onset and end (damaged rotors, motor gains, payload) is written into the parameters at those
events; sensor faults are names that faults.py looks up. What acts at every sub-step (wind, jet, gusts, cloth, sag) is
a row of numbers that airflow.py reads:

    wind   velocity n e d
    jet    nozzle n e d, unit direction n e d, diameter, speed
    gusts  sigma, length scale, advection speed or -1
    cloth  mass, length, damping ratio, drag at 3 m/s, modulation, across, flapping Hz per m/s, fastening
    sag    drop, time constant
"""

from math import ceil, inf, sqrt

import numpy as np

import sim_vehicle.physics.layout as at
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.disturbances.records import (
    BatterySag,
    ClockJump,
    Cloth,
    Disturbance,
    FanJet,
    Gusts,
    MotorGain,
    Payload,
    RotorChip,
    SensorFault,
    Wind,
)
from sim_vehicle.physics.packing import SUBSTEP_NS, pack_parameters, set_mass
from sim_vehicle.records import Array

WORLD_STREAM = 100
"""Disturbance number k draws from the stream [seed, WORLD_STREAM + k]."""
GUST_STREAM = 99
"""Draws of all rows, sub-step by sub-step."""
NEVER_NS = 2**63 - 1

RAW_SHAKING = ((0.0, 0.135, 0.24, 0.33, 1.0), (0.0, 31.0, 58.0, 82.0, 250.0))
"""Thrust lost by a chip, and raw acceleration of the imbalance at hover speed, m/s^2.

The blade-element estimate for 10, 20 and 30 % of one blade's radius; carried on in proportion beyond.
"""


class World:
    """The disturbances of one flight, resolved from its seed."""

    def __init__(self, config: SimVehicleConfig, seed: int) -> None:
        self._config = config
        self._blocks = config.disturbances
        self._draws = [_draw(block, seed, k) for k, block in enumerate(self._blocks)]
        self.parameters: Array = pack_parameters(config)
        """[PARAMETERS_SIZE] in force."""
        rows = [row for row in map(_row, self._blocks) if row is not None]
        self.rows: Array = np.array(rows, dtype=np.float64).reshape(len(rows), at.ROW_SIZE)
        """[k, ROW_SIZE]"""
        self.row_state: Array = np.zeros((len(rows), at.ROW_STATE_SIZE))
        """[k, ROW_STATE_SIZE]"""
        self._start_rows(seed)
        self.shaking: Array = np.zeros((4, 2))
        """[4, 2] what reaches accelerometer (m/s^2) and gyro (rad/s) of each rotor's imbalance, at hover speed."""
        self.faults: dict[str, str] = {}
        """What ails each sensor at present, by its name."""
        self.clock_jump_ns = 0
        """By how much the vehicle's clock is off."""
        self.next_event_ns = 0
        """When `apply` is due again."""

    def apply(self, now_ns: int) -> None:
        """Bring the parameters to what acts at `now_ns`."""
        active = [(block, draw) for block, draw in zip(self._blocks, self._draws, strict=True) if _acts(block, now_ns)]
        P = self.parameters
        self._set_gains([draw for block, draw in active if isinstance(block, MotorGain)])
        self._set_damage([(block, int(draw[0])) for block, draw in active if isinstance(block, RotorChip)])
        payloads = tuple((block.mass_kg, block.offset_m) for block, _ in active if isinstance(block, Payload))
        body = self._config.body
        set_mass(P, body.mass_kg, body.inertia_kg_m2, body.centre_of_mass_m, payloads)
        self.faults = {block.sensor: block.fault for block, _ in active if isinstance(block, SensorFault)}
        self.clock_jump_ns = round(1e9 * sum(block.jump_s for block, _ in active if isinstance(block, ClockJump)))
        times = [time for block in self._blocks for time in (_onset_ns(block), _end_ns(block))]
        self.next_event_ns = min((time for time in times if time > now_ns), default=NEVER_NS)

    def chipped_rotors(self) -> tuple[int, ...]:
        """PX4 numbers of the rotors that the scenario damages, in the order of its blocks."""
        return tuple(
            int(draw[0]) + 1
            for block, draw in zip(self._blocks, self._draws, strict=True)
            if isinstance(block, RotorChip)
        )

    def _start_rows(self, seed: int) -> None:
        """Gusts start in their stationary distribution, a cloth's flapping at any phase."""
        rng = np.random.default_rng([seed, GUST_STREAM, 0])
        for row, state in zip(self.rows, self.row_state, strict=True):
            draws = rng.standard_normal(3)
            if row[at.ROW_KIND] == at.KIND_GUSTS:
                state[:3] = row[at.ROW_VALUES] * draws
            elif row[at.ROW_KIND] == at.KIND_CLOTH:
                state[4] = abs(draws[0])

    def _set_gains(self, gains: list[Array]) -> None:
        gain = np.array(self._config.motors.gain)
        for factor in gains:
            gain = gain * factor
        self.parameters[at.GAIN : at.GAIN + 4] = gain

    def _set_damage(self, chips: list[tuple[RotorChip, int]]) -> None:
        P = self.parameters
        P[at.THRUST_FACTOR : at.THRUST_FACTOR + 8] = 1.0
        self.shaking[:] = 0.0
        for chip, rotor in chips:
            torque_factor = chip.thrust_factor**1.1 if chip.torque_factor is None else chip.torque_factor
            P[at.THRUST_FACTOR + rotor] *= chip.thrust_factor
            P[at.TORQUE_FACTOR + rotor] *= torque_factor
            raw = float(np.interp(1.0 - chip.thrust_factor, *RAW_SHAKING))
            self.shaking[rotor] += raw * chip.mount_transmission, raw * chip.gyroscope_rad_s_per_m_s2


def row_count(blocks: tuple[Disturbance, ...]) -> int:
    """How many of them act at every sub-step."""
    return sum(_row(block) is not None for block in blocks)


def _draw(block: Disturbance, seed: int, number: int) -> Array:
    """What is random in a block: the rotor's index, or four motor gains."""
    rng = np.random.default_rng([seed, WORLD_STREAM + number])
    if isinstance(block, RotorChip):
        drawn = int(rng.integers(4))
        return np.array([float(drawn if block.rotor == "random" else block.rotor - 1)])
    if isinstance(block, MotorGain):
        return block.common * (1.0 + rng.uniform(-block.spread, block.spread, 4))
    return np.zeros(0)


def _row(block: Disturbance) -> list[float] | None:
    """The row of a block that acts at every sub-step, else None."""
    values: tuple[float, ...]
    if isinstance(block, Wind):
        kind, values = at.KIND_WIND, block.velocity_ned_m_s
    elif isinstance(block, FanJet):
        length = sqrt(sum(x * x for x in block.direction_ned))
        unit = tuple(x / length for x in block.direction_ned)
        kind, values = at.KIND_JET, (*block.origin_ned_m, *unit, block.diameter_m, block.speed_m_s)
    elif isinstance(block, Gusts):
        advection = -1.0 if block.advection_m_s is None else block.advection_m_s
        kind, values = at.KIND_GUSTS, (block.sigma_m_s, block.length_scale_m, advection)
    elif isinstance(block, Cloth):
        kind, values = (
            at.KIND_CLOTH,
            (
                block.mass_kg,
                block.length_m,
                block.damping_ratio,
                block.drag_at_3_m_s_n,
                block.modulation,
                block.across,
                block.flapping_hz_per_m_s,
                block.fastening_m,
            ),
        )
    elif isinstance(block, BatterySag):
        kind, values = at.KIND_SAG, (block.drop_v, block.time_constant_s)
    else:
        return None
    row = [float(kind), block.onset_s, inf if block.end_s is None else block.end_s, *values]
    return row + [0.0] * (at.ROW_SIZE - len(row))


def _onset_ns(block: Disturbance) -> int:
    return ceil(round(block.onset_s * 1e9) / SUBSTEP_NS) * SUBSTEP_NS


def _end_ns(block: Disturbance) -> int:
    return NEVER_NS if block.end_s is None else ceil(round(block.end_s * 1e9) / SUBSTEP_NS) * SUBSTEP_NS


def _acts(block: Disturbance, now_ns: int) -> bool:
    return _onset_ns(block) <= now_ns < _end_ns(block)
