"""A batch moves like single vehicles."""

import numpy as np
import pytest

from sim_vehicle.config import load_vehicle
from sim_vehicle.physics.batch import VehicleBatch
from sim_vehicle.vehicle import SimVehicle

OVER = {
    "initial": {"position_ned_m": [0, 0, -4], "hovering": True},
    "disturbances": [
        {"kind": "gusts", "sigma_m_s": 0.5, "length_scale_m": 0.4},
        {"kind": "motor_gain", "common": 0.9, "spread": 0.02},
        {"kind": "cloth"},
        {"kind": "rotor_chip", "thrust_factor": 0.9, "onset_s": 0.083},
    ],
}


@pytest.mark.parametrize("parts", [1, 2])
def test_batch_equals_single_vehicles(motors, parts):
    config, seeds = load_vehicle("mambo", OVER), (3, 9, 27)
    batch, singles = VehicleBatch(config, seeds, parts), [SimVehicle(config, seed) for seed in seeds]
    commands = np.array([[0.5, 0.5, 0.5, 0.5], [0.52, 0.5, 0.5, 0.5], [0.5, 0.5, 0.53, 0.5]], dtype=np.float32)
    for k in range(60):
        batch.step(commands.astype(np.float64))
        for row, single in zip(commands, singles, strict=True):
            single.receive(motors(row), k * 5_000_000)
        truths = [single.step((k + 1) * 5_000_000).truth for single in singles]
    np.testing.assert_allclose(batch.states[:, :13], np.array(truths)[:, :13], rtol=1e-12, atol=1e-12)
    assert batch.time_ns == 300_000_000
    assert not batch.crashed.any()


def test_a_crashed_vehicle_stops_only_its_own_motors():
    batch = VehicleBatch(load_vehicle("mambo", OVER | {"disturbances": []}), range(2))
    commands = np.array([[0.5, 0.5, 0.5, 0.5], [0.9, 0.2, 0.2, 0.9]])
    for _ in range(100):
        batch.step(commands.copy())
    assert batch.crashed.tolist() == [False, True]
    assert batch.states[1, 13:17].max() < 0.02
    assert batch.states[0, 13:17].min() > 0.1


def test_a_batch_refuses_bad_commands():
    batch = VehicleBatch(load_vehicle("mambo"), range(2))
    with pytest.raises(ValueError, match="shape"):
        batch.step(np.zeros((3, 4)))
    with pytest.raises(ValueError, match="5 parts: allowed are 1 to 2"):
        VehicleBatch(load_vehicle("mambo"), range(2), parts=5)
    with pytest.raises(ValueError, match="sub-steps"):
        batch.step(np.zeros((2, 4)), substeps=1000)


def test_a_vehicle_that_starts_again_flies_like_a_new_one_while_the_others_fly_on():
    config, other = load_vehicle("mambo", OVER), load_vehicle("mambo", OVER | {"body": {"mass_kg": 0.066}})
    commands = np.array([[0.5, 0.5, 0.5, 0.5], [0.52, 0.5, 0.5, 0.5]])
    batch, alone = VehicleBatch(config, (3, 9)), VehicleBatch(config, (3,))
    for _ in range(13):
        batch.step(commands.copy())
    batch.reset(1, other, 27)
    assert batch.times_ns.tolist() == [65_000_000, 0]
    for _ in range(100):  # beyond the draws that are stored ahead
        batch.step(commands.copy())
    for _ in range(113):
        alone.step(commands[:1].copy())
    fresh = VehicleBatch(other, (27,))
    for _ in range(100):
        fresh.step(commands[1:].copy())
    assert (batch.states[0] == alone.states[0]).all()
    assert (batch.states[1] == fresh.states[0]).all()
    assert (batch.states[0] != batch.states[1]).any()


def test_time_stands_still_for_a_vehicle_that_is_named():
    batch = VehicleBatch(load_vehicle("mambo", OVER), (3, 9))
    before = batch.states.copy()
    batch.step(np.full((2, 4), 0.5), still=np.array([False, True]))
    assert batch.times_ns.tolist() == [5_000_000, 0]
    assert (batch.states[1] == before[1]).all()
    assert (batch.states[0] != before[0]).any()


def test_a_batch_starts_again_with_the_same_kinds_only():
    batch = VehicleBatch(load_vehicle("mambo", OVER), (3, 9))
    with pytest.raises(ValueError, match="same kinds"):
        batch.reset(0, load_vehicle("mambo", OVER | {"disturbances": []}), 1)
