from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from configs.loader import ConfigError, ConfigRecord, fill, load, merge, parse_yaml, read_tree, set_path


class MotorConfig(ConfigRecord):
    gain: float = Field(gt=0, description="1")
    lags_s: tuple[float, float] = (0.02, 0.04)


class VehicleConfig(ConfigRecord):
    name: str
    mass_kg: float = Field(gt=0.01, le=1.0, description="kg")
    rotors: int = Field(ge=1)
    motor: MotorConfig
    armed: bool = False


GOOD = """
name: no
mass_kg: 68e-3
rotors: 4
motor: {gain: 1, lags_s: [0.01, 2e-2]}
"""


def config_file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "vehicle.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_yaml_fills_the_record(tmp_path: Path) -> None:
    config = load(VehicleConfig, config_file(tmp_path, GOOD))
    assert config == VehicleConfig(
        name="no", mass_kg=0.068, rotors=4, motor=MotorConfig(gain=1.0, lags_s=(0.01, 0.02)), armed=False
    )


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-4", 1e-4),
        ("-2.5E+3", -2500.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("-0", 0),
        ("no", "no"),
        ("on", "on"),
        ("true", True),
        ("12:30", "12:30"),
        ("012", "012"),
        ("1_000", "1_000"),
        ("2026-01-01", "2026-01-01"),
        ("null", None),
        ("[1, 2.0]", [1, 2.0]),
    ],
)
def test_scalars_are_what_people_expect(text: str, value: object) -> None:
    read = parse_yaml(text, "x")
    assert read == value
    assert type(read) is type(value)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_float_survives_its_text(value: float) -> None:
    assert parse_yaml(repr(value), "x") == value


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rotors: 4", "rotors: 4\nwings: 2", "wings: unknown key; allowed are armed, mass_kg, motor, name, rotors"),
        ("gain: 1,", "gian: 1, gain: 1,", "vehicle.yaml: motor.gian: unknown key; allowed are gain, lags_s"),
        ("name: no", "", "vehicle.yaml: name: missing"),
        ("gain: 1,", "gain: -1,", "vehicle.yaml: motor.gain: -1: Input should be greater than 0"),
        ("68e-3", "true", "vehicle.yaml: mass_kg: True"),
        ("68e-3", "68", "less than or equal to 1"),
        ("68e-3", "'0.068'", "mass_kg: '0.068'"),
        ("rotors: 4", "rotors: 4.5", "rotors: 4.5"),
        ("rotors: 4", "rotors: 4\narmed: yes", "armed: 'yes'"),
        ("2e-2]", "2e-2, 3e-2]", "motor.lags_s"),
        ("rotors: 4", "rotors: 4\nrotors: 5", "'rotors' is written twice"),
        ("rotors: 4", "rotors: [", "vehicle.yaml: "),
        ("68e-3", ".nan", "mass_kg: '.nan'"),
    ],
)
def test_a_fault_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = config_file(tmp_path, GOOD.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        load(VehicleConfig, path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_all_faults_are_named_at_once(tmp_path: Path) -> None:
    path = config_file(tmp_path, "mass_kg: 7\nrotors: 0\nwings: 1\nmotor: {gain: 1}")
    with pytest.raises(ConfigError) as caught:
        load(VehicleConfig, path)
    assert len(str(caught.value).splitlines()) == 4


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing\.yaml: cannot be read: No such file"):
        read_tree(tmp_path / "missing.yaml")
    with pytest.raises(ConfigError, match="expected a mapping"):
        read_tree(config_file(tmp_path, "- 1"))
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not UTF-8"):
        read_tree(binary)


def test_the_path_within_the_file_stands_before_the_key() -> None:
    with pytest.raises(ConfigError, match=r"fly\.yaml: vehicle\.motor\.gain: missing"):
        fill(MotorConfig, {}, "fly.yaml", at="vehicle.motor.")


def test_records_are_frozen() -> None:
    config = MotorConfig(gain=1.0)
    with pytest.raises(ValueError, match="frozen"):
        setattr(config, "gain", 2.0)  # noqa: B010 (the type checker need not see it)


def test_merge_lays_mappings_over_and_replaces_the_rest() -> None:
    base = {"a": {"b": 1, "c": [1, 2]}, "d": 4}
    assert merge(base, {"a": {"c": [3]}, "d": {"e": 5}}) == {"a": {"b": 1, "c": [3]}, "d": {"e": 5}}
    assert base == {"a": {"b": 1, "c": [1, 2]}, "d": 4}


def test_an_assigned_mapping_of_another_kind_replaces() -> None:
    base = {"law": {"kind": "slow", "gain": 1.0, "own": 2}}
    assert set_path(base, "law={kind: fast, gain: 3.0}") == {"law": {"kind": "fast", "gain": 3.0}}
    assert set_path(base, "law={kind: slow, gain: 3.0}")["law"] == {"kind": "slow", "gain": 3.0, "own": 2}
    assert set_path(base, "law={gain: 3.0}")["law"] == {"kind": "slow", "gain": 3.0, "own": 2}


def test_set_path_assigns_one_value() -> None:
    tree = {"a": {"b": 1}}
    assert set_path(tree, "a.b=1e-3") == {"a": {"b": 0.001}}
    assert set_path(tree, "x.y=[1, no]") == {"a": {"b": 1}, "x": {"y": [1, "no"]}}
    assert set_path({"a": None}, "a.b=1") == {"a": {"b": 1}}
    for wrong, message in (("a.b", "expected path"), ("=1", "expected path"), ("a.b.c=1", "a.b holds no keys")):
        with pytest.raises(ConfigError, match=message):
            set_path(tree, wrong)


def test_a_tree_is_its_readers_own() -> None:
    parse_yaml(GOOD, "one")["motor"]["lags_s"].append(3.0)
    assert parse_yaml(GOOD, "another")["motor"] == {"gain": 1, "lags_s": [0.01, 0.02]}
