"""Computes how much thrust a chipped rotor must keep so that the vehicle can hover without turning.

To hover level without turning, every rotor must give a quarter of the weight. If one gives less, the opposite rotor
must give less too, and yaw cannot be held (a slow turn makes up for about a hundredth). The chipped rotor gives at most

    f g (V / V_rated)^2 T_max        f: thrust factor, g: gain of its motor.

The voltage V falls with the power of all four motors, as in the simulated battery (sim_vehicle/physics/motors.py):
V = V_open - (R + R_slow)(I_idle + k sum(T^1.5) / V), where T is the thrust of an undamaged rotor. The rest is the
reserve, which holds the attitude.
"""

import json
from collections.abc import Sequence
from math import sqrt
from statistics import median
from typing import Any

from experiments.campaigns.flight_jobs import unfold
from experiments.results.campaign_data import CampaignData
from experiments.results.tables import Table
from protocol.conventions import GRAVITY
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.disturbances.rotor_chip import chipped_rotors
from sim_vehicle.physics import layout as at
from sim_vehicle.world.world import World

LONG_AFTER_NS = 10**15
"""A time at which every fault of the scenario is present."""


def reserve(vehicle: SimVehicleConfig, seed: int) -> float:
    """Return the thrust of the chipped rotor above a quarter of the weight, as a share of it; negative: it must turn.

    Parameters
    ----------
    vehicle: its disturbances include one chipped rotor.
    seed: of the flight; determines the rotor and the gains of the motors.

    Raises
    ------
    ValueError
        If the vehicle has no chipped rotor.
    """
    world = World(vehicle, seed)
    world.apply(LONG_AFTER_NS)
    chipped = chipped_rotors(world.disturbances)
    if not chipped:
        raise ValueError("no rotor of this vehicle is chipped")
    P = world.condition.parameters
    rotor = chipped[0] - 1
    factor, gain = float(P[at.THRUST_FACTOR + rotor]), float(P[at.GAIN + rotor])
    quarter = 0.25 * vehicle.body.mass_kg * GRAVITY
    most = vehicle.motors.max_thrust_n * gain
    volts = vehicle.battery.full_v
    for _ in range(100):  # a contraction: the drop is a tenth of the voltage
        full = most * (volts / vehicle.battery.rated_v) ** 2
        volts = loaded_voltage(vehicle, [quarter] * 3 + [full], volts)
    return factor * full / quarter - 1.0


def loaded_voltage(vehicle: SimVehicleConfig, thrusts: Sequence[float], volts: float) -> float:
    """Return the voltage of a full battery under four thrusts of undamaged rotors [N]; one step of the iteration."""
    battery = vehicle.battery
    amperes = battery.idle_a + battery.power_w_n15 * sum(thrust * sqrt(thrust) for thrust in thrusts) / volts
    open_circuit = battery.full_v + (battery.empty_v - battery.full_v) * battery.charge_used
    return open_circuit - (battery.resistance_ohm + battery.polarisation_ohm) * amperes


def limit_table(data: CampaignData, case: str, sweep: str) -> Table:
    """Return for each step of the sweep how many seeds can hover without turning, and how many survive."""
    reserves: dict[Any, dict[int, float]] = {}
    seeds = len({row["seed"] for row in data.rows})
    first = data.controllers[0]
    for job in unfold(data.config, data.name, seeds):
        if job.case != case or job.controller != first:
            continue
        flight = job.configuration()
        step: Any = dict(job.point)[sweep]
        reserves.setdefault(step, {})[flight.seed] = reserve(flight.vehicle, flight.seed)
    rows = []
    for step, found in reserves.items():
        able = {seed for seed, one in found.items() if one >= 0.0}
        groups = data.select(case, point={sweep: step})
        survivors = {group.controller: {row["seed"] for row in group.survivors} for group in groups}
        shares = [survivors.get(name, set()) for name in data.controllers]
        rows.append(
            (
                json.dumps(step),
                f"{len(able)} of {len(found)}",
                f"{100 * median(found.values()):+.0f} %",
                *(f"{len(alive & able)} + {len(alive - able)}" for alive in shares),
            )
        )
    label = next(one.label or one.name for one in data.config.sweeps if one.name == sweep)
    caption = (
        "The limit of thrust. Reserve: thrust of the chipped rotor at full command beyond the quarter of the weight "
        "that hovering without turning takes (fully charged battery under that load). Below each controller its "
        "survivors: of the flights that can hover without turning + of those that cannot"
    )
    header = (label, "flights that can hover without turning", "reserve, median", *data.controllers)
    return Table(caption, header, tuple(rows))
