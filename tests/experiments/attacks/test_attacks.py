"""Bad learners in flight: with the guard nothing is lost, and without it the same attack costs the vehicle."""

import pytest

from experiments.attacks.attack_flight import fly_attack
from experiments.attacks.cases import CASES

GUARD = "onboard.controller.settings.guard"
OFF = tuple(
    f"{GUARD}.{one}"
    for one in (
        *("room.enabled=false", "test.enabled=false", "watch.enabled=false"),
        *("swaps_per_s_max=1000.0", "jumps_max=1000.0"),
    )
)
JET = ("vehicle.disturbances.0.speed_m_s=8.0",)
STEEP = (
    *JET,
    *(
        f"onboard.controller.settings.{channel}.augmentation.law.slope.{kind}=100000.0"
        for channel in ("position", "attitude")
        for kind in ("place", "motion", "turn")
    ),
)
"""Without the limits of a map's slope, which stand before the guard."""
ERROR_MAX_M = 0.13
"""RMS from the beginning of the attack on. Without a learner: 0.09 to 0.12."""


def test_a_cliff_beside_the_states_of_the_last_second_is_refused():
    """By its test, or on probation."""
    outcome = fly_attack("steep", 1, assignments=JET)
    assert not outcome.lost
    assert outcome.refused
    assert set(outcome.refused.values()) <= {"reach", "slope", "misfit", "probation"}
    assert outcome.error_m < ERROR_MAX_M


@pytest.mark.full
def test_without_the_guard_cliffs_cost_the_vehicle():
    outcome = fly_attack("steep_again", 1, duration_s=20.0, assignments=(*STEEP, *OFF))
    assert outcome.swaps > 0
    assert outcome.lost


@pytest.mark.parametrize("seed", [2, 6])
def test_room_probation_and_test_are_needed_against_cliffs(seed):
    """Nothing; the room alone; room and probation; all."""
    parts = (OFF, OFF[1:], (OFF[1], *OFF[3:]), ())
    flights = [fly_attack("steep_again", seed, duration_s=20.0, assignments=(*STEEP, *off)) for off in parts]
    _, room, probation, all_on = flights
    assert [bool(flight.lost) for flight in flights] == [True, True, False, False]
    assert min(room.swaps, probation.swaps) > all_on.swaps == 1, "the test refuses the others"
    assert all_on.error_m < ERROR_MAX_M < probation.error_m


def test_probation_is_needed_against_a_wrong_map():
    """One version, the honest map with the other sign: without the test it flies, and the room alone lets it."""
    room, probation = (
        fly_attack("flipped", 3, duration_s=20.0, assignments=(*STEEP, *off)) for off in (OFF[1:], (OFF[1], *OFF[3:]))
    )
    assert room.error_m > 1.5 * probation.error_m
    assert probation.refused[1] == "probation"


def test_a_cliff_that_is_out_of_reach_on_arrival_is_found_before_it_is_reached():
    """While such a version is prepared it comes into reach, and the test refuses it."""
    outcome = fly_attack("far_cliff", 2, assignments=JET)
    assert not outcome.lost
    assert outcome.refused[1] == "swap_jump"
    assert "reach" in outcome.refused.values()
    assert outcome.error_m < ERROR_MAX_M


@pytest.mark.full
@pytest.mark.parametrize("jet", ["0.0", "8.0"])
@pytest.mark.parametrize("case", sorted(CASES))
def test_no_bad_learner_costs_the_vehicle(case, jet):
    outcome = fly_attack(case, 2, assignments=(f"vehicle.disturbances.0.speed_m_s={jet}",))
    assert not outcome.lost
    assert outcome.error_m < ERROR_MAX_M
