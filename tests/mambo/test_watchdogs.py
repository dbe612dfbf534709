"""Watchdogs in flight: each fault of the firmware's calls, and what the vehicle does."""

from collections.abc import Callable

import pytest

from experiments.flights.lockstep_flight import LockstepOutcome
from mambo.build import Built
from mambo.fake.wire import Answer, Calls
from tests.mambo.flying import fly_with, modes, texts, with_calls, with_duration, with_time

FAULT_NS = 7_500_000_000
"""In flight: pose wait 4 s, half a second of good sensors, take-off."""
PERIOD_NS = 5_000_000
STOP = 2
AS_PLANNED = ["BOOT", "READY", "ARMED", "TAKE_OFF", "FLYING", "LANDING"]
"""The flight plan lands a second before its end."""


@pytest.fixture(autouse=True)
def _library(native: Built) -> None:
    """Every test flies the library on this machine."""


def from_fault(change: Callable[[int, bytes], list[bytes]]) -> Callable[[int, bytes], list[bytes]]:
    return lambda now_ns, request: change(now_ns, request) if now_ns >= FAULT_NS else [request]


def assert_as_planned(outcome: LockstepOutcome) -> None:
    assert modes(outcome) == AS_PLANNED
    assert "landing:" not in texts(outcome)


def motors_off(answers: list[Answer]) -> bool:
    return answers[-1].word == STOP and answers[-1].speeds == (0, 0, 0, 0)


def test_without_a_fault_the_same_flight_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    outcome, answers = fly_with(monkeypatch, from_fault(lambda _, request: [request]), 9.0)
    assert_as_planned(outcome)
    assert [one.word for one in answers if one.word != STOP][:2] == [1, 3]  # START once, then RUN
    assert answers[0].ultrasound == 16
    assert answers[1].ultrasound == 0


def test_a_call_that_comes_twice_is_one_call(monkeypatch: pytest.MonkeyPatch) -> None:
    twice = from_fault(lambda _, request: [with_calls(request, Calls.TWICE)])
    _, answers = fly_with(monkeypatch, twice, 9.0)
    _, once = fly_with(monkeypatch, lambda _, request: [request], 9.0)
    assert answers[-1].view["twice"] > 200
    assert answers[-1].view["calls"] == once[-1].view["calls"]
    assert [one.speeds for one in answers] == [one.speeds for one in once]


def late(seconds: float) -> Callable[[int, bytes], list[bytes]]:
    """The firmware does not call for so long, once."""
    end_ns = FAULT_NS + int(seconds * 1e9)
    return lambda now_ns, request: [] if FAULT_NS <= now_ns < end_ns else [request]


def test_a_short_gap_is_flown_over(monkeypatch: pytest.MonkeyPatch) -> None:
    outcome, answers = fly_with(monkeypatch, late(0.02), 9.0)
    assert_as_planned(outcome)
    assert answers[-1].view["missed"] in (3, 4)


def test_a_late_call_lands(monkeypatch: pytest.MonkeyPatch) -> None:
    outcome, answers = fly_with(monkeypatch, late(0.045), 9.0)
    assert "landing: the firmware called late" in texts(outcome)
    assert modes(outcome)[-1] == "LANDING"
    assert answers[-1].view["late"] == 1


def test_a_call_that_comes_far_too_late_stops_the_motors(monkeypatch: pytest.MonkeyPatch) -> None:
    outcome, answers = fly_with(monkeypatch, late(0.2), 8.5)
    assert "motors off: the firmware called far too late" in texts(outcome)
    assert modes(outcome)[-1] == "TERMINATED"
    assert motors_off(answers)


def test_a_frozen_acquisition_stops_the_motors(monkeypatch: pytest.MonkeyPatch) -> None:
    frozen = from_fault(lambda _, request: [with_calls(request, Calls.FREEZES)])
    outcome, answers = fly_with(monkeypatch, frozen, 8.5)
    assert "the acquisition repeats" in texts(outcome)
    assert modes(outcome)[-1] == "EMERGENCY"
    assert motors_off(answers)


def test_a_firmware_that_slows_to_100_hz_lands(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = from_fault(lambda now_ns, request: [request] if now_ns // PERIOD_NS % 2 == 0 else [])
    outcome, _ = fly_with(monkeypatch, slow, 11.0)
    assert "landing: the firmware calls at a wrong rate" in texts(outcome)
    assert "LANDING" in modes(outcome)


def test_a_firmware_of_100_hz_is_never_armed(monkeypatch: pytest.MonkeyPatch) -> None:
    half = iter(range(10**9))
    outcome, answers = fly_with(monkeypatch, lambda _, request: [request] if next(half) % 2 == 0 else [], 8.0)
    assert set(modes(outcome)) == {"BOOT"}
    assert "the firmware calls at a wrong rate" in texts(outcome)
    assert {one.word for one in answers} == {STOP}


def test_the_firmwares_own_stop_ends_the_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    stop = from_fault(lambda _, request: [with_calls(request, Calls.STOPS_MOTORS)])
    outcome, answers = fly_with(monkeypatch, stop, 8.5)
    assert "motors off: the firmware stopped them" in texts(outcome)
    assert modes(outcome)[-1] == "TERMINATED"
    assert motors_off(answers)


def test_a_library_that_is_too_slow_leaves_out_work_and_then_lands(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = from_fault(lambda _, request: [with_duration(request, 4_000_000)])
    outcome, answers = fly_with(monkeypatch, slow, 12.0)
    stages = [one.view["stage"] for one in answers]
    assert [stage for index, stage in enumerate(stages) if index == 0 or stage != stages[index - 1]] == [0, 1, 2, 3]
    said = texts(outcome)
    assert said.index("without training") < said.index("without offboard") < said.index("takes too long")
    assert "LANDING" in modes(outcome)


def test_a_few_slow_calls_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = iter(range(10**9))
    slow = from_fault(lambda _, request: [with_duration(request, 4_000_000 if next(calls) % 20 == 0 else 0)])
    outcome, answers = fly_with(monkeypatch, slow, 9.0)
    assert answers[-1].view["over_budget"] > 10
    assert answers[-1].view["stage"] == 0
    assert_as_planned(outcome)


def test_jitter_of_the_scheduler_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    delays = iter(1_500_000 if index % 7 == 3 else 0 for index in range(10**9))
    outcome, _ = fly_with(monkeypatch, lambda now_ns, request: [with_time(request, now_ns + next(delays))], 9.0)
    assert_as_planned(outcome)
