"""A motion capture that loses the vehicle and repeats its last pose with fresh times, in a flight with offboard."""

import pytest

from experiments.flights.lockstep_flight import LockstepOutcome, fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.flight.supervisor import FlightMode

FROZEN = "vehicle.disturbances=[{kind: sensor_fault, sensor: motion_capture, fault: frozen, onset_s: 9.0}]"


def flown(*assignments: str) -> LockstepOutcome:
    return fly_lockstep(resolve("figure8_calm", Choices("pid", 21, 14.0, (FROZEN, *assignments))))


def test_it_counts_as_silent_and_is_reported() -> None:
    outcome = flown()
    assert outcome.crash_reason == ""
    said_ns = [when for when, process, text in outcome.events if process == "offboard" and "repeats one pose" in text]
    assert 9.0e9 < said_ns[0] < 9.2e9
    assert FlightMode.LANDED in outcome.trace.mode


def test_without_the_check_for_repeated_poses_onboard_refuses_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """They contradict the flow (docs/safety.md). Without either check the vehicle crashes."""
    monkeypatch.setattr("offboard.links.pose_relay.FROZEN_POSES", 10**9)
    outcome = flown()
    assert outcome.crash_reason == ""
    assert outcome.onboard["estimator"]["pose_implausible"] > 0
    believed = (f"onboard.estimator.{name}=1000" for name in ("pose_drift_m", "pose_jump_m", "pose_turn_max_rad"))
    assert flown(*believed).crash_reason
