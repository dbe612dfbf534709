"""The unchanged onboard process flies the vehicle over MuJoCo. Needs the `mujoco` extra."""

import numpy as np
import pytest

from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.flight.modes import FlightMode

pytest.importorskip("mujoco", reason="the mujoco extra is not installed")


@pytest.mark.parametrize(("scenario", "seconds"), [("hover", 10.0), ("figure8_wind", 16.0)])
def test_dmrac_flies_from_take_off_to_touch_down(scenario: str, seconds: float) -> None:
    """With training. The vehicle lands by itself at the end, on MuJoCo's floor."""
    outcome = fly_lockstep(resolve(scenario, Choices("dmrac", 3, seconds, ("vehicle.physics=mujoco",))))
    trace = outcome.trace
    assert outcome.crash_reason == ""
    assert FlightMode.FLYING in trace.mode
    assert np.median(np.linalg.norm(trace.position_error[trace.on_path], axis=1)) < 0.1
    assert trace.truth["airborne"][-1] == 0.0
    assert trace.truth["position_d"][-1] == pytest.approx(-0.0219, abs=5e-4)


def test_a_flight_without_training_is_nearly_that_over_the_own_physics() -> None:
    """In the air both integrate the same forces; a floor of another stiffness shifts the start by some millimetres."""
    own, other = (
        fly_lockstep(resolve("figure8_calm", Choices("pid", 3, 8.0, (f"vehicle.physics={name}",))), with_offboard=False)
        for name in ("own", "mujoco")
    )
    apart = [other.trace.truth[f"position_{axis}"] - own.trace.truth[f"position_{axis}"] for axis in "ned"]
    flying = other.trace.mode == FlightMode.FLYING
    assert np.abs(apart[0][flying]).max() < 6e-3
    assert np.abs(apart[1][flying]).max() < 6e-3
    assert np.abs(apart[2][flying]).max() < 6e-3
    assert own.trace_sha256 != other.trace_sha256
