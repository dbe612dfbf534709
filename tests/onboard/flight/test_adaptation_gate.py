"""When the laws may adapt."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from onboard.flight.adaptation_gate import ADAPT_CLIMB_M, ADAPT_HEIGHT_M, VELOCITY_AID_MAX_S, AdaptationGate
from onboard.flight.modes import AIRBORNE, FlightMode

STEP_M = 0.01


def state(height_m: float, aided_ns: int = 0) -> Any:
    return SimpleNamespace(position=np.array([0.0, 0.0, -height_m]), last_velocity_aid_ns=aided_ns)


@pytest.mark.parametrize("stood_at_m", [0.0, 0.5, -0.3])
def test_a_take_off_adapts_once_it_is_clear_of_where_it_stood(stood_at_m: float) -> None:
    gate = AdaptationGate()
    gate.take_off(state(stood_at_m))
    for climbed_m, adapts in ((0.0, False), (ADAPT_CLIMB_M - STEP_M, False), (ADAPT_CLIMB_M + STEP_M, True)):
        assert gate.allows(state(stood_at_m + climbed_m), FlightMode.TAKE_OFF, 0) is adapts


@pytest.mark.parametrize("mode", sorted(AIRBORNE - {FlightMode.TAKE_OFF}))
def test_all_other_modes_adapt_above_the_ground_effect(mode: FlightMode) -> None:
    gate = AdaptationGate()
    assert not gate.allows(state(ADAPT_HEIGHT_M - STEP_M), mode, 0)
    assert gate.allows(state(ADAPT_HEIGHT_M + STEP_M), mode, 0)


def test_a_second_take_off_is_from_where_the_vehicle_stands_then() -> None:
    gate = AdaptationGate()
    for stood_at_m in (0.0, 0.7):
        gate.take_off(state(stood_at_m))
    assert not gate.allows(state(0.72), FlightMode.TAKE_OFF, 0)


def test_nothing_adapts_on_the_ground_or_without_an_aid_of_velocity() -> None:
    gate = AdaptationGate()
    assert not any(gate.allows(state(1.0), mode, 0) for mode in set(FlightMode) - AIRBORNE)
    silent_ns = int(VELOCITY_AID_MAX_S * 1e9)
    assert gate.allows(state(1.0), FlightMode.FLYING, silent_ns - 1)
    assert not gate.allows(state(1.0), FlightMode.FLYING, silent_ns + 1)
