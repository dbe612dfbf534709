"""The unchanged onboard process flies the vehicle of RotorPy. Needs the `rotorpy` extra."""

import numpy as np
import pytest

from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.flight.modes import FlightMode

pytest.importorskip("rotorpy", reason="the rotorpy extra is not installed")

TUNNEL = "{kind: rotorpy_tunnel, origin_ned_m: [0.6, 0, -1], direction_ned: [0, 1, 0], radius_m: 0.3, speed_m_s: 4}"


@pytest.mark.parametrize(
    ("scenario", "seconds", "more"), [("hover", 8.0, ()), ("figure8_calm", 14.0, (f"vehicle.disturbances=[{TUNNEL}]",))]
)
def test_dmrac_flies_from_take_off_to_touch_down(scenario: str, seconds: float, more: tuple[str, ...]) -> None:
    """With training. The vehicle lands by itself at the end."""
    choices = Choices("dmrac", 3, seconds, ("vehicle.physics=rotorpy", *more))
    outcome = fly_lockstep(resolve(scenario, choices))
    trace = outcome.trace
    assert outcome.crash_reason == ""
    assert FlightMode.FLYING in trace.mode
    assert np.median(np.linalg.norm(trace.position_error[trace.on_path], axis=1)) < 0.1
    assert trace.truth["airborne"][-1] == 0.0
    assert trace.truth["position_d"][-1] == pytest.approx(-0.021, abs=5e-4)
    blown = trace.truth["wind_e"][trace.on_path]
    assert set(blown) == ({0.0, 4.0} if more else {0.0})
