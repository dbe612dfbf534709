"""A resolved configuration as text: its defaults are marked, and it is read back as it was."""

import re
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from async_dmrac.command_line import main
from configs.flight_tree import Choices
from configs.loader import ConfigRecord, parse_mapping
from configs.marked_yaml import default_paths, equal_paths, marked_yaml
from configs.parts import part_names
from experiments.flights.scenario import complete, resolve
from sim_vehicle.link.radio import BlackoutConfig


class Motor(ConfigRecord):
    gain: float = 1.0
    lag_s: float = Field(default=0.02, alias="lag")


class Vehicle(ConfigRecord):
    name: str
    motor: Motor = Motor(gain=2.0)
    spare: Motor
    silences: tuple[BlackoutConfig, ...] = ()
    size_m: tuple[float, float] = (1.0, 1.0)


def test_a_value_is_a_default_of_its_own_record_or_of_the_one_around_it() -> None:
    vehicle = Vehicle(name="a", spare=Motor(gain=3.0), silences=(BlackoutConfig(start_s=1.0),))
    assert set(default_paths(vehicle)) == {"motor.gain", "motor.lag", "spare.lag", "size_m", "silences.0.end_s"}
    other = Vehicle(name="a", spare=Motor(), motor=Motor())
    assert set(default_paths(other)) == {"motor.lag", "spare.gain", "spare.lag", "size_m", "silences"}
    assert set(equal_paths({"a": {"b": 1, "c": 2}, "d": [1]}, {"a": {"b": 1, "c": 3}, "d": [1]})) == {"a.b", "d"}


def test_lines_are_short_and_marked() -> None:
    tree = {"a": {"b": 1e-5, "c": []}, "d": [{"e": 1, "f": {"g": None}}, {"e": 2}], "h": "# no", "i": {"j": 1, "k": 2}}
    assert marked_yaml(tree, {"a.b", "a.c", "d.0.e", "h", "i.k"}).splitlines() == [
        "a: {b: 1.0e-05, c: []}  # default",
        "d:",
        "  - e: 1  # default",
        "    f: {g: null}",
        "  - {e: 2}",
        "h: '# no'  # default",
        "i:",
        "  j: 1",
        "  k: 2  # default",
    ]


keys = st.text("ab_ #:", min_size=1, max_size=9)
scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
trees = st.recursive(scalars, lambda inner: st.lists(inner) | st.dictionaries(keys, inner), max_leaves=20)


@settings(deadline=None)
@given(tree=st.dictionaries(keys, trees), marked=st.booleans())
def test_every_tree_is_read_back(tree: dict[str, Any], marked: bool) -> None:
    text = marked_yaml(tree, set(equal_paths(tree, tree)) if marked else set())
    assert yaml.safe_load(text) == (tree or None)


@pytest.mark.parametrize("controller", part_names("controllers"))
@pytest.mark.parametrize("scenario", ["figure8_real", "rotor_chip"])
def test_a_resolved_flight_is_read_back(scenario: str, controller: str) -> None:
    flight = resolve(scenario, Choices(controller))
    assert complete(parse_mapping(flight.to_yaml(), "written"), "written") == flight


def test_dmrac_config_marks_what_nobody_chose(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["hover", "--controller", "mrac", "--set", "offboard.trainer.momentum=0.8", "--seed", "1"]
    assert main(["config", *words, "--set", "features.trained.scales.roll.scale=0.3"]) == 0
    text = capsys.readouterr().out
    lines = [re.sub(r"\s+", " ", line).strip() for line in text.splitlines()]
    for value in ("learning_rate: 0.005", "rbf_width: 0.6", "dropout: 0.0", "altitude_m: 1.0"):
        assert [line.removeprefix(value).strip() for line in lines if line.startswith(value)][:1] == ["# default"]
    assert all("#" not in line for line in lines if line.startswith("look_ahead_s:")), "the controller's file chose it"
    assert {"momentum: 0.8", "mass_kg: 0.063", "auto_arm: true", "period_ns: 5000000 # default"} <= set(lines)
    assert lines[lines.index("roll:") : lines.index("roll:") + 3] == ["roll:", "offset: 0.0 # default", "scale: 0.3"]
