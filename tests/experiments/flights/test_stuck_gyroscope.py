"""A gyroscope axis that is stuck in flight, with poses: the vehicle lands; undetected it is lost."""

import pytest

from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.flight.supervisor import FlightMode

FAULT_S = 5.0
GAINS = (
    "onboard.controller.settings.position.gains.natural_frequency_rad_s=[4.5,4.5,5.0]",
    "onboard.controller.settings.position.gains.damping=0.7",
    "onboard.controller.settings.attitude.gains.natural_frequency_rad_s=[12.0,12.0,5.0]",
    "onboard.controller.settings.attitude.gains.damping=1.4",
)


def flown(axis, rate="null", *assignments):
    fault = f"vehicle.disturbances=[{{kind: gyro_stuck, axis: {axis}, rate_rad_s: {rate}, onset_s: {FAULT_S}}}]"
    return fly_lockstep(resolve("hover", Choices("pid", 21, 14.0, (fault, *GAINS, *assignments))))


@pytest.mark.parametrize(("axis", "rate"), [("x", "null"), ("y", "0.0"), ("z", "0.3")])
def test_it_is_found_and_the_vehicle_lands(axis, rate):
    outcome = flown(axis, rate)
    assert outcome.crash_reason == ""
    when_ns, texts = [[one[k] for one in outcome.events if one[1] == "onboard"] for k in (0, 2)]
    found = texts.index(f"gyroscope {axis} stuck: its rate comes from the motors from now on")
    assert 0.0 < when_ns[found] * 1e-9 - FAULT_S < 0.07
    assert any(text.endswith("-> LANDING: gyroscope axis stuck") for text in texts)
    assert FlightMode.LANDED in outcome.trace.mode
    assert FlightMode.EMERGENCY not in outcome.trace.mode


def test_undetected_it_loses_the_vehicle():
    """Ablation of the test above."""
    assert flown("x", "0.1", "onboard.estimator.gyro_stuck_samples=0").crash_reason
