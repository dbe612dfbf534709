"""A motion capture that loses the vehicle and repeats its last pose with fresh times, in a flight with offboard."""

import pytest

from experiments.flights.lockstep_flight import LockstepOutcome, fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.flight.supervisor import FlightMode

FROZEN = "vehicle.disturbances=[{kind: sensor_fault, sensor: motion_capture, fault: frozen, onset_s: 9.0}]"


def flown() -> LockstepOutcome:
    return fly_lockstep(resolve("figure8_calm", Choices("pid", 21, 14.0, (FROZEN,))))


def test_it_counts_as_silent_and_is_reported() -> None:
    outcome = flown()
    assert outcome.crash_reason == ""
    said_ns = [when for when, process, text in outcome.events if process == "offboard" and "repeats one pose" in text]
    assert 9.0e9 < said_ns[0] < 9.2e9
    assert FlightMode.LANDED in outcome.trace.mode


def test_without_the_check_for_repeated_poses_the_vehicle_crashes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("offboard.links.pose_relay.FROZEN_POSES", 10**9)
    assert flown().crash_reason
