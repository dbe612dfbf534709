"""The vehicle that stands for the real one, weaker, slower and noisier than onboard believes, can be flown."""

import pytest

from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.flight.modes import FlightMode


@pytest.mark.parametrize("controller", ["pid", "mrac"])
def test_it_takes_off(controller: str) -> None:
    """Its motors give 17 % less than nominal and it weighs 11 % more; nothing compensates that before it flies."""
    outcome = fly_lockstep(resolve("figure8_real", Choices(controller, 11, 9.0)), with_offboard=False)
    assert FlightMode.FLYING in outcome.trace.mode


@pytest.mark.full
@pytest.mark.parametrize("seed", [11, 12])
@pytest.mark.parametrize("controller", ["pid", "mrac"])
def test_the_shipped_gains_fly_it(controller: str, seed: int) -> None:
    outcome = fly_lockstep(resolve("figure8_real", Choices(controller, seed, 20.0)), with_offboard=False)
    assert outcome.crash_reason == ""
    assert outcome.trace.mode[-1] == FlightMode.LANDING  # as planned, a second before the end
