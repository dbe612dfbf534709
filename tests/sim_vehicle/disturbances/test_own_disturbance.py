"""A disturbance outside the project: the example of docs/vehicle.md flies, and bad input is refused."""

import json

import numpy as np
import pytest
import yaml

import sim_vehicle.disturbances
from configs.loader import ConfigError
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, FlightConfig, complete, resolve
from sim_vehicle.config import load_vehicle
from sim_vehicle.physics.batch import VehicleBatch
from sim_vehicle.vehicle import SimVehicle
from sim_vehicle.world.catalogue import kinds

ANCHOR, LENGTH_M, STIFFNESS_N_M, ONSET_S = np.array([1.0, 0.0, -1.0]), 0.6, 0.1, 8.0
BAD = """
from sim_vehicle.world.interface import Disturbance


class Lazy(Disturbance):
    pass


class Short(Disturbance):
    @staticmethod
    def act(v, state, effect):
        pass


class Outside(Disturbance):
    @staticmethod
    def act(v, memory, time_s, state, P, noise, effect):
        effect[0] += v[7]
"""


@pytest.fixture
def bad(tmp_path, monkeypatch):
    (tmp_path / "bad.py").write_text(BAD, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)


def with_disturbance(tree) -> FlightConfig:
    return resolve("hover", Choices("pid", 1, 12.0, (f"vehicle.disturbances=[{json.dumps(tree)}]",)))


def test_the_example_flies_and_the_truth_shows_it(tether):
    outcome = fly_lockstep(with_disturbance(tether), with_offboard=False)
    assert outcome.crash_reason == ""
    time_s, truth = outcome.trace.time_s, outcome.trace.truth
    force, position = (
        np.stack([truth[f"{name}_{axis}"] for axis in "ned"], 1) for name in ("disturbance_force", "position")
    )
    towards = ANCHOR - position
    distance = np.linalg.norm(towards, axis=1, keepdims=True)
    pull = STIFFNESS_N_M * np.maximum(0.0, 1.0 - LENGTH_M / distance) * towards
    before, after = (time_s > ONSET_S - 0.5) & (time_s < ONSET_S), time_s > ONSET_S + 0.1
    offset = np.mean(force[before], axis=0)  # drag and motors, not the tether
    assert np.abs(force[before] - offset)[:, 0].max() < 5e-3
    np.testing.assert_allclose(force[after][:100, 0] - offset[0], pull[after][:100, 0], atol=5e-3)
    assert pull[after][:100, 0].min() > 0.03


def test_a_batch_and_a_single_vehicle_move_alike(tether, motors):
    start = {"position_ned_m": [0.0, 0.0, -1.0], "hovering": True}
    config = load_vehicle("mambo", {"disturbances": [tether | {"onset_s": 0.0}], "initial": start})
    batch, single = VehicleBatch(config, [5]), SimVehicle(config, 5)
    for k in range(20):
        single.receive(motors([0.5] * 4), k * 5_000_000)
        truth = single.step((k + 1) * 5_000_000).truth
        batch.step(np.full((1, 4), 0.5))
    np.testing.assert_allclose(batch.states[0, :13], truth[:13], rtol=1e-12, atol=1e-12)
    assert truth[3] > 0.05


def test_the_resolved_configuration_holds_it(tether):
    config = with_disturbance(tether)
    again = complete(yaml.safe_load(config.to_yaml()), "config.yaml")
    assert again.vehicle == config.vehicle
    assert again.vehicle.disturbances[0].kind == "my_tether:Tether"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"kind": "no_such_module:Gust"},
            r"0\.kind: 'no_such_module:Gust': cannot be loaded: No module .*expected module",
        ),
        (
            {"kind": "my_tether:Gust"},
            r"0\.kind: 'my_tether:Gust': cannot be loaded: .*no attribute 'Gust'.*expected module",
        ),
        ({"kind": ":Gust"}, r"0\.kind: ':Gust': cannot be loaded"),
        ({"kind": "math:pi"}, r"0\.kind: 'math:pi': expected a subclass of .*Disturbance"),
        ({"kind": "bad:Lazy"}, r"0\.kind: 'bad:Lazy': has neither of the methods act and change"),
        ({"kind": "bad:Short"}, r"0\.kind: 'bad:Short': its act is act\(v, state, effect\), expected act\(v, memory, "),
        ({"kind": "tether"}, r"0\.kind: 'tether': unknown kind; allowed are battery_sag, .*wrench, or module:Class"),
        ({"kind": None}, r"0\.kind: None: missing; allowed are battery_sag"),
        ({"length": 1.0}, r"0\.length: 1\.0: unknown key; my_tether:Tether allows anchor_ned_m, .*length_m"),
        ({"length_m": -1.0}, r"0\.length_m: -1\.0: Input should be greater than 0"),
        ({"length_m": None}, r"0\.length_m: None: Input should be a valid number"),
    ],
)
def test_bad_input_is_named(tether, bad, change, message):
    with pytest.raises(ConfigError, match=r"hover\.yaml --set .*: vehicle\.disturbances\." + message):
        with_disturbance(tether | change)


def test_a_missing_setting_is_named(tether):
    del tether["length_m"]
    with pytest.raises(ConfigError, match=r"vehicle\.disturbances\.0\.length_m: missing"):
        with_disturbance(tether)


def test_an_index_out_of_range_is_an_error(bad):
    vehicle = SimVehicle(load_vehicle("mambo", {"disturbances": [{"kind": "bad:Outside"}]}), 1)
    with pytest.raises(IndexError):
        vehicle.step(5_000_000)


def test_a_new_file_in_the_package_is_found_by_its_name(tether, tmp_path, monkeypatch):
    monkeypatch.setattr(sim_vehicle.disturbances, "__path__", [*sim_vehicle.disturbances.__path__, str(tmp_path)])
    (tmp_path / "my_tether.py").rename(tmp_path / "tether.py")
    kinds.cache_clear()
    try:
        [found] = load_vehicle("mambo", {"disturbances": [tether | {"kind": "tether"}]}).disturbances
    finally:
        kinds.cache_clear()
    assert type(found).__module__ == "sim_vehicle.disturbances.tether"
