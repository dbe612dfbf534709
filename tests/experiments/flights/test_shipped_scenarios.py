"""Every shipped scenario, flown by every shipped controller that is made for it."""

import numpy as np
import pytest

from configs.loader import CONFIG_DIRECTORY
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.flight.modes import FlightMode

SCENARIOS = sorted(path.stem for path in (CONFIG_DIRECTORY / "scenarios").glob("*.yaml"))


@pytest.mark.parametrize("controller", ["pid", "l1", "indi", "bias", "mrac", "dmrac"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_it_flies(scenario: str, controller: str) -> None:
    """The vehicle takes off, follows its path and survives. Without offboard: no training and no pose."""
    outcome = fly_lockstep(resolve(scenario, Choices(controller, 3, 16.0)), with_offboard=False)
    trace = outcome.trace
    assert outcome.crash_reason == ""
    assert FlightMode.FLYING in trace.mode
    error = np.linalg.norm(trace.position_error[trace.on_path], axis=1)
    assert np.median(error) < 0.5
