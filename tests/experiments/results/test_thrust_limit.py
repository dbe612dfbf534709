"""The limit of thrust against the simulated motors and battery, which are run until they are steady."""

import json
from pathlib import Path

import numpy as np
import pytest

import sim_vehicle.physics.layout as at
from experiments.campaigns.campaign import load_campaign
from experiments.campaigns.flight_jobs import unfold
from experiments.campaigns.flight_row import empty_row
from experiments.flights.scenario import Choices, resolve
from experiments.results.campaign_data import CampaignData
from experiments.results.thrust_limit import LONG_AFTER_NS, limit_table, reserve
from protocol.conventions import GRAVITY
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.disturbances.rotor_chip import chipped_rotors
from sim_vehicle.physics.motors import drain_battery, lag_motors
from sim_vehicle.vehicle import initial_state
from sim_vehicle.world.world import World


def vehicle(factor: float) -> SimVehicleConfig:
    blocks = (
        f"{{kind: rotor_chip, rotor: random, thrust_factor: {factor}, onset_s: 5.0}}",
        "{kind: motor_gain, common: 0.95, spread: 0.05}",
    )
    large = "vehicle.battery.capacity_mah=1000000"
    return resolve("rotor_chip", Choices(None, 3, 10.0, (f"vehicle.disturbances=[{', '.join(blocks)}]", large))).vehicle


def simulated_reserve(config: SimVehicleConfig, seed: int) -> float:
    world = World(config, seed)
    world.apply(LONG_AFTER_NS)
    P, state, rotor = world.condition.parameters, initial_state(config), chipped_rotors(world.disturbances)[0] - 1
    quarter, thrust = 0.25 * config.body.mass_kg * GRAVITY, np.zeros((3, 4))
    for _ in range(60_000):
        full = config.motors.max_thrust_n * (state[at.VOLTAGE] / config.battery.rated_v) ** 2
        commands = quarter / (full * P[at.GAIN : at.GAIN + 4])
        commands[rotor] = 1.0
        lag_motors(state, commands, P, thrust)
        drain_battery(state, 0.0, P)
    return float(P[at.THRUST_FACTOR + rotor] * state[at.THRUST + rotor] / quarter - 1.0)


@pytest.mark.parametrize(("factor", "seed"), [(0.5, 3), (0.6, 4), (0.8, 5)])
def test_it_is_what_the_simulated_vehicle_has_left(factor: float, seed: int) -> None:
    config = vehicle(factor)
    assert reserve(config, seed) == pytest.approx(simulated_reserve(config, seed), abs=0.01)


def test_a_sound_vehicle_has_no_chipped_rotor() -> None:
    with pytest.raises(ValueError, match="chipped"):
        reserve(resolve("hover").vehicle, 1)


def test_survivors_are_told_apart_by_whether_they_could_hover() -> None:
    """With 0.5 none of these three vehicles can hover, with 0.65 all: one survives of the former, two of the latter."""
    campaign, _ = load_campaign("rotor_chip")
    jobs = [job for job in unfold(campaign, "rotor_chip", 3) if job.controller == "dmrac"]
    rows = tuple(
        empty_row()
        | {"case": job.case, "controller": job.controller, "seed": job.seed, "point": json.dumps(dict(job.point))}
        | {"survived": job.seed < {0.5: 1001, 0.65: 1002}.get(dict(job.point)["thrust_factor"], 9999)}
        for job in jobs
    )
    table = limit_table(CampaignData(Path(), "rotor_chip", campaign, rows), "hover", "thrust_factor")
    cells = {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}
    able = "flights that can hover without turning"
    assert (cells["0.5"][able], cells["0.5"]["dmrac"]) == ("0 of 3", "0 + 1")
    assert (cells["0.65"][able], cells["0.65"]["dmrac"]) == ("3 of 3", "2 + 0")
