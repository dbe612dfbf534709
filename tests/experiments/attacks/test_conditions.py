"""Still air, jets and a chip, set in a scenario."""

import pytest

from configs.loader import ConfigError
from experiments.attacks.conditions import CHIP_ONSET_S, condition_assignments
from experiments.flights.scenario import Choices, resolve


def disturbances(condition):
    assignments = condition_assignments(condition, "figure8_wind")
    return resolve("figure8_wind", Choices(assignments=assignments)).vehicle.disturbances


def test_the_scenario_as_it_is():
    assert disturbances("scenario") == resolve("figure8_wind").vehicle.disturbances


def test_calm_has_no_disturbance_at_all():
    assert disturbances("calm") == ()


@pytest.mark.parametrize(("condition", "speed"), [("jet_4", 4.0), ("jet_8", 8.0), ("chip", 8.0)])
def test_the_jet_has_its_speed_and_the_gusts_stay(condition, speed):
    found = {one.kind: one for one in disturbances(condition)}
    assert found["fan_jet"].speed_m_s == speed
    assert found["gusts"].sigma_m_s == 0.1
    assert ("rotor_chip" in found) is (condition == "chip")


def test_the_chip_comes_in_flight():
    chip = next(one for one in disturbances("chip") if one.kind == "rotor_chip")
    assert (chip.thrust_factor, chip.onset_s) == (0.75, CHIP_ONSET_S)


def test_what_is_not_possible_is_a_plain_error():
    with pytest.raises(ConfigError, match=r"'storm' unknown; allowed are scenario, calm, jet_4, jet_8, chip"):
        condition_assignments("storm", "figure8_wind")
    with pytest.raises(ConfigError, match=r"scenario hover has none"):
        condition_assignments("jet_8", "hover")
