"""Preflight certificate: only a complete, good, recent and unchanged one of this vehicle allows arming."""

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
    arming_refusal,
    certificate_name,
    read_certificate,
    vehicle_url,
    write_certificate,
)
from onboard.preflight.checks import Check, Result

VEHICLE = "192.168.3.1:14560"
SERIAL = "serial:///dev/ttyUSB0?baud=921600"
NOW = 1_800_000_000
GOOD = [Check("IMU rate", Result.PASS, "200 Hz", ""), Check("pressure", Result.ABSENT, "", "", "it sends none")]
REAL = resolve("hover", Choices("pid", real=True)).onboard
SIMULATED = resolve("hover", Choices("pid")).onboard


def refusal(checks=GOOD, vehicle=VEHICLE, with_pose=True, needs_pose=True, age_s=60.0, of=VEHICLE):
    certificate = read_certificate(write_certificate(of, NOW, with_pose, checks), "file")
    return arming_refusal(certificate, vehicle, needs_pose, NOW + age_s)


@pytest.mark.parametrize(
    ("case", "expected"),
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
def test_reasons_to_refuse_arming(case, expected):
    assert expected in refusal(**case)
    assert bool(refusal(**case)) == bool(expected)


@pytest.mark.parametrize(
    ("key", "value"), [("vehicle", "udp://10.0.0.1:1"), ("utc_s", NOW + 1), ("with_pose", False), ("checks", [])]
)
def test_a_changed_certificate_is_refused(key, value):
    tree = json.loads(write_certificate(VEHICLE, NOW, True, GOOD))
    tree[key] = value
    certificate = read_certificate(json.dumps(tree).encode(), "file")
    assert "changed after it was written" in arming_refusal(certificate, VEHICLE, True, NOW)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe", b'{"format": 2}', b'{"vehicle": 3}'])
def test_a_file_that_is_not_a_certificate_is_named_in_the_error(content):
    with pytest.raises(ConfigError, match=r"^some\.json: "):
        read_certificate(content, "some.json")


def test_names():
    assert (vehicle_url(VEHICLE), certificate_name(VEHICLE)) == (
        "udp://192.168.3.1:14560",
        "preflight_192.168.3.1_14560.json",
    )
    assert certificate_name(SERIAL) == certificate_name("serial:///dev/ttyUSB0") == "preflight_dev_ttyUSB0.json"


# -- in onboard's command line -----------------------------------------------------------------------------------------


def clearance(vehicle, config, *words):
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return clearance_of(parser.parse_args(words), vehicle, config)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("onboard.command.time.time", lambda: NOW + 60.0)
    return tmp_path


def test_a_vehicle_on_this_machine_needs_no_certificate(folder):
    assert clearance("127.0.0.1:14560", SIMULATED) == clearance("localhost:14560", REAL) == CLEAR


@pytest.mark.parametrize("vehicle", [VEHICLE, SERIAL])
def test_another_vehicle_needs_a_certificate_with_its_default_name(folder, vehicle):
    missing = clearance(vehicle, REAL)
    assert missing.refusal == f"no {certificate_name(vehicle)}: run dmrac preflight --vehicle {vehicle_url(vehicle)}"
    Path(certificate_name(vehicle)).write_bytes(write_certificate(vehicle, NOW, True, GOOD))
    assert clearance(vehicle, REAL) == CLEAR
    assert "auto_arm" in clearance(vehicle, SIMULATED).refusal


def test_a_certificate_given_by_option_is_required_on_this_machine_too(folder):
    assert "no mine.json" in clearance("127.0.0.1:14560", REAL, "--preflight", "mine.json").refusal
    Path("mine.json").write_bytes(
        write_certificate("127.0.0.1:14560", NOW, True, [Check("IMU rate", Result.FAIL, "", "")])
    )
    assert clearance("127.0.0.1:14560", REAL, "--preflight", "mine.json").refusal == "preflight failed: IMU rate"


def test_the_override_is_announced(folder):
    overridden = clearance(VEHICLE, SIMULATED, "--no-preflight")
    assert overridden.refusal == ""
    assert overridden.notice.startswith("PREFLIGHT OVERRIDDEN")
    with pytest.raises(ConfigError, match="--no-preflight: cannot be used with --preflight"):
        clearance(VEHICLE, REAL, "--no-preflight", "--preflight", "mine.json")


def test_a_file_that_is_not_a_certificate_is_a_start_error(folder):
    Path("mine.json").write_text("all fine", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"mine\.json: not a preflight certificate"):
        clearance(VEHICLE, REAL, "--preflight", "mine.json")
    with pytest.raises(ConfigError, match=r"cannot be read: Is a directory"):
        clearance(VEHICLE, REAL, "--preflight", str(folder))
