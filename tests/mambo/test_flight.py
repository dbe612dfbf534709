"""Whole flights through the drone's library: the whole system flies, and both processors give the same bits."""

from pathlib import Path

import numpy as np
import pytest

from experiments.flights.lockstep_flight import LockstepOutcome, fly_lockstep
from experiments.flights.scenario import Choices, resolve
from mambo.build import Built, build, zig_target
from mambo.vehicles import RADIO
from onboard.flight.modes import FlightMode
from protocol.keys import write_key
from tests.mambo.flying import modes

SHORT_S = 9.0
"""Calibration, arming, take-off and the first metre of the path."""


def flown(vehicle: str, duration_s: float, with_offboard: bool = True, controller: str = "dmrac") -> LockstepOutcome:
    choices = Choices(controller, duration_s=duration_s, radio=RADIO)
    return fly_lockstep(resolve("figure8_wind", choices), with_offboard=with_offboard, core=vehicle)


def assert_the_same(one: LockstepOutcome, other: LockstepOutcome) -> None:
    """The hash is of every datagram that any side sent: sensors, motor commands, samples, poses, features."""
    assert np.array_equal(one.trace.tick.rows, other.trace.tick.rows)
    assert one.trace_sha256 == other.trace_sha256


def test_both_processors_fly_the_same_bits(native: Built, qemu: Built) -> None:
    on_drone, here = (flown(vehicle, SHORT_S, with_offboard=False) for vehicle in ("mambo-qemu", "mambo-native"))
    assert "FLYING" in modes(on_drone)
    assert on_drone.crash_reason == ""
    assert_the_same(on_drone, here)


def test_with_a_key_the_unchanged_offboard_is_understood(native: Built, tmp_path: Path) -> None:
    write_key(tmp_path / "flight.key")
    assignments = (f"network.key_file={tmp_path / 'flight.key'}",)
    choices = Choices("pid", duration_s=9.0, assignments=assignments, radio=RADIO)
    outcome = fly_lockstep(resolve("figure8_calm", choices), core="mambo-native")
    assert outcome.onboard["rejected"] == {}
    assert "FLYING" in modes(outcome)
    flying = outcome.trace.mode == FlightMode.FLYING
    assert outcome.trace.tick["pose_age"][flying].max() < 0.3  # poses of the motion capture, over Bluetooth
    assert outcome.radio["up"]["delivered"] > 50


def test_a_silent_link_holds_and_lands(native: Built) -> None:
    hold = "onboard.supervisor.on_pose_stale=hold", "onboard.supervisor.hold_max_s=2.0"
    silent = "radio.down.blackouts=[{start_s: 6.0}]", *hold
    choices = Choices("pid", duration_s=14.0, assignments=silent, radio=RADIO)
    outcome = fly_lockstep(resolve("hover", choices), core="mambo-native")
    assert outcome.crash_reason == ""
    flown = modes(outcome)
    assert flown[flown.index("FLYING") :][:4] == ["FLYING", "HOLD", "LANDING", "LANDED"]


@pytest.mark.full
def test_both_processors_fly_the_same_bits_for_a_minute(native: Built, qemu: Built) -> None:
    on_drone, here = (flown(vehicle, 60.0) for vehicle in ("mambo-qemu", "mambo-native"))
    assert on_drone.onboard["features"]["swaps"] > 0
    assert on_drone.crash_reason == ""
    flying = on_drone.trace.mode == FlightMode.FLYING
    assert on_drone.trace.tick["position_sigma"][flying].min() > 0.0  # in float, rounding once made it negative
    assert_the_same(on_drone, here)


@pytest.mark.full
def test_the_library_that_ziglang_builds_flies_the_same_bits(
    native: Built, qemu: Built, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ziglang")
    monkeypatch.setattr("mambo.build.arm_target", zig_target)
    assert build("arm").library != qemu.library
    on_drone, here = (flown(vehicle, SHORT_S, with_offboard=False) for vehicle in ("mambo-qemu", "mambo-native"))
    assert_the_same(on_drone, here)


@pytest.mark.full
def test_in_the_jet_it_flies_as_well_as_the_laptops_core(native: Built) -> None:
    from experiments.flights.metrics import flight_metrics

    errors_m = {}
    for core in ("mambo-native", "c"):
        outcome = flown(core, 60.0)
        trajectory = resolve("figure8_wind").onboard.guidance.trajectory
        errors_m[core] = flight_metrics(outcome.trace, trajectory).position_rmse_m
    assert errors_m["mambo-native"] <= 1.1 * errors_m["c"]
