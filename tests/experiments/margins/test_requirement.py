"""What a controller misses of its margins, on the nominal vehicle and at corners."""

import numpy as np
import pytest

from configs.flight_tree import Choices
from configs.loader import ConfigError
from experiments.flights.scenario import FlightConfig, resolve
from experiments.margins.linear import PredictedLoop
from experiments.margins.requirement import FROM_FAR_BELOW, Corner, MarginRequirement

S = 1j * FROM_FAR_BELOW
NEEDED = MarginRequirement(gain_margin_db=6.0, phase_margin_deg=30.0, delay_margin_ms=10.0)
DELAY_S = "vehicle.motors.command_delay_s"


def third_order(gain: float) -> PredictedLoop:
    """L = gain (s + 1)^2 / s^3: stable for gains above 0.5."""
    numerator = gain * (S + 1.0) ** 2
    return PredictedLoop(numerator / S**3, (S**3 + numerator) / (S + 1.0) ** 3)


def test_a_margin_towards_less_gain_is_asked_for_too() -> None:
    gain_alone = NEEDED.model_copy(update={"phase_margin_deg": 1e-3, "delay_margin_ms": 1e-3})
    assert gain_alone.shortfall_of(third_order(4.0)) == 0.0
    assert gain_alone.shortfall_of(third_order(0.6)) == pytest.approx(1.0 - 20.0 * np.log10(1.2) / 6.0, abs=0.02)


def test_the_shortfall_goes_on_above_1_where_the_loop_is_unstable() -> None:
    shortfalls = [NEEDED.shortfall_of(third_order(gain)) for gain in (0.7, 0.55, 0.501, 0.499, 0.4, 0.25)]
    assert shortfalls == sorted(shortfalls)
    assert shortfalls[2] < 1.0 < shortfalls[3]
    assert shortfalls[3] - shortfalls[2] < 0.05


def flight(*assignments: str) -> FlightConfig:
    return resolve(choices=Choices("none", assignments=assignments))


def corner(**at: float) -> Corner:
    return Corner(name="far", at={path.replace("__", "."): share for path, share in at.items()}, margins=NEEDED)


def test_a_corner_is_the_vehicle_at_shares_of_its_tuning_ranges() -> None:
    here = flight("vehicle.motors.lag_up_s=0.02", f"{DELAY_S}=0.005", "vehicle.body.mass_kg=0.0756")
    there = corner(motors__lag_up_s=0.0, motors__command_delay_s=0.5, body__mass_kg=1.0)
    much = MarginRequirement(gain_margin_db=20.0, phase_margin_deg=60.0, delay_margin_ms=60.0)
    there = there.model_copy(update={"margins": much})
    assert there.shortfall(flight(), "mambo") == much.shortfall(here)
    assert much.shortfall(here) != much.shortfall(flight())


def test_a_corner_of_a_value_without_a_range_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"corners: far: at: motors\.command_min: .*allowed are body\.mass_kg"):
        corner(motors__command_min=0.5).shortfall(flight(), "mambo")


@pytest.mark.parametrize("share", [-0.1, 1.1])
def test_a_share_outside_0_to_1_is_refused(share: float) -> None:
    with pytest.raises(ValueError, match=r"body\.mass_kg"):
        corner(body__mass_kg=share)
