"""A preflight record: what it says is what was found, and only a complete, good, fresh one of this vehicle counts."""

import argparse
import json
from pathlib import Path

import pytest

from configs.loader import ConfigError
from experiments.flights.scenario import Choices, resolve
from onboard.command import add_arguments, clearance_of
from onboard.preflight.certificate import (
    AGE_MAX_S,
    CLEAR,
    objection,
    read_record,
    record_name,
    vehicle_url,
    write_record,
)
from onboard.preflight.checks import Check, Result

VEHICLE = "192.168.3.1:14560"
SERIAL = "serial:///dev/ttyUSB0?baud=921600"
NOW = 1_800_000_000
GOOD = [Check("IMU rate", Result.PASS, "200 Hz", ""), Check("pressure", Result.ABSENT, "", "", "it sends none")]
REAL = resolve("hover", Choices("pid", real=True)).onboard
SIMULATED = resolve("hover", Choices("pid")).onboard


def found(checks=GOOD, vehicle=VEHICLE, with_pose=True, needs_pose=True, age_s=60.0, of=VEHICLE):
    record = read_record(write_record(of, NOW, with_pose, checks), "record")
    return objection(record, vehicle, needs_pose, NOW + age_s)


@pytest.mark.parametrize(
    ("case", "said"),
    [
        ({}, ""),
        ({"with_pose": False, "needs_pose": False}, ""),
        ({"age_s": AGE_MAX_S - 1.0}, ""),
        ({"age_s": AGE_MAX_S + 3600.0}, "preflight is 25 h old"),
        ({"age_s": -100.0}, ""),
        ({"age_s": -3600.0}, "date in the future"),
        ({"with_pose": False}, "without the pose"),
        ({"checks": [*GOOD, Check("motor 3", Result.FAIL, "none", "")]}, "preflight failed: motor 3"),
        ({"checks": [Check(n, Result.FAIL, "", "") for n in "abc"]}, "preflight failed: a and 2 more"),
        ({"checks": [*GOOD, Check("motor order", Result.SKIPPED, "", "")]}, "not complete: motor order"),
        ({"checks": []}, "not complete: no checks"),
        ({"vehicle": "192.168.3.7:14560"}, "preflight was of udp://192.168.3.1:14560, not of udp://192.168.3.7:14560"),
        ({"of": SERIAL, "vehicle": "serial:///dev/ttyUSB0?baud=460800"}, ""),
        ({"of": SERIAL, "vehicle": "serial:///dev/ttyUSB1"}, "preflight was of serial:///dev/ttyUSB0"),
    ],
)
def test_what_counts(case, said):
    assert said in found(**case)
    assert bool(found(**case)) == bool(said)


@pytest.mark.parametrize(
    ("key", "value"), [("vehicle", "udp://10.0.0.1:1"), ("utc_s", NOW + 1), ("with_pose", False), ("checks", [])]
)
def test_a_changed_record_does_not_count(key, value):
    tree = json.loads(write_record(VEHICLE, NOW, True, GOOD))
    tree[key] = value
    record = read_record(json.dumps(tree).encode(), "record")
    assert "changed after it was written" in objection(record, VEHICLE, True, NOW)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe", b'{"format": 2}', b'{"vehicle": 3}'])
def test_what_is_no_record_is_named(content):
    with pytest.raises(ConfigError, match=r"^some\.json: "):
        read_record(content, "some.json")


def test_names():
    assert (vehicle_url(VEHICLE), record_name(VEHICLE)) == (
        "udp://192.168.3.1:14560",
        "preflight_192.168.3.1_14560.json",
    )
    assert record_name(SERIAL) == record_name("serial:///dev/ttyUSB0") == "preflight_dev_ttyUSB0.json"


# -- what onboard makes of it -----------------------------------------------------------------------------------------


def clearance(vehicle, config, *words):
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return clearance_of(parser.parse_args(words), vehicle, config)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("onboard.command.time.time", lambda: NOW + 60.0)
    return tmp_path


def test_a_vehicle_on_this_machine_is_simulated_and_needs_none(folder):
    assert clearance("127.0.0.1:14560", SIMULATED) == clearance("localhost:14560", REAL) == CLEAR


@pytest.mark.parametrize("vehicle", [VEHICLE, SERIAL])
def test_any_other_vehicle_needs_one_by_its_name_in_this_folder(folder, vehicle):
    missing = clearance(vehicle, REAL)
    assert missing.bar == f"no {record_name(vehicle)}: run dmrac preflight --vehicle {vehicle_url(vehicle)}"
    Path(record_name(vehicle)).write_bytes(write_record(vehicle, NOW, True, GOOD))
    assert clearance(vehicle, REAL) == CLEAR
    assert "auto_arm" in clearance(vehicle, SIMULATED).bar


def test_a_record_that_is_named_is_asked_for_even_on_this_machine(folder):
    assert "no mine.json" in clearance("127.0.0.1:14560", REAL, "--preflight", "mine.json").bar
    Path("mine.json").write_bytes(write_record("127.0.0.1:14560", NOW, True, [Check("IMU rate", Result.FAIL, "", "")]))
    assert clearance("127.0.0.1:14560", REAL, "--preflight", "mine.json").bar == "preflight failed: IMU rate"


def test_it_can_be_overridden_and_that_is_said(folder):
    overridden = clearance(VEHICLE, SIMULATED, "--no-preflight")
    assert overridden.bar == ""
    assert overridden.notice.startswith("PREFLIGHT OVERRIDDEN")
    with pytest.raises(ConfigError, match="--no-preflight: not beside --preflight"):
        clearance(VEHICLE, REAL, "--no-preflight", "--preflight", "mine.json")


def test_a_file_that_is_no_record_ends_it_before_the_start(folder):
    Path("mine.json").write_text("all fine", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"mine\.json: is no preflight record"):
        clearance(VEHICLE, REAL, "--preflight", "mine.json")
    with pytest.raises(ConfigError, match=r"cannot be read: Is a directory"):
        clearance(VEHICLE, REAL, "--preflight", str(folder))
