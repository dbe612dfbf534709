"""The limit of thrust against the simulated motors and battery, which are run until they are steady."""

import numpy as np
import pytest

import sim_vehicle.layout as at
from experiments.flights.scenario import Choices, resolve
from experiments.results.thrust_limit import LONG_AFTER_NS, reserve
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.motors import drain_battery, lag_motors
from sim_vehicle.packing import GRAVITY
from sim_vehicle.vehicle import initial_state
from sim_vehicle.world import World


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
    P, state, rotor = world.parameters, initial_state(config), world.chipped_rotors()[0] - 1
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
