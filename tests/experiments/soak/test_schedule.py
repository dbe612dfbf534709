import pytest

from configs.flight_tree import Choices
from experiments.flights.scenario import resolve
from experiments.link.flood import PORTS
from experiments.soak.schedule import BEGIN_S, CHOICES, END_BEFORE_S, LIVES_SHARE, Action, blackouts, draw

HALF_HOUR_S = 1800.0


def test_a_seed_draws_the_same_and_another_one_something_else() -> None:
    assert draw(1, HALF_HOUR_S, True) == draw(1, HALF_HOUR_S, True)
    assert draw(1, HALF_HOUR_S, True) != draw(2, HALF_HOUR_S, True)
    assert blackouts(1, HALF_HOUR_S) == blackouts(1, HALF_HOUR_S)


def test_half_an_hour_has_everything() -> None:
    found = draw(1, HALF_HOUR_S, True)
    assert {(one.action, one.target) for one in found} == {(action, target) for _, action, target, _ in CHOICES}
    assert {one.target for one in found if one.action is Action.FLOOD} == set(PORTS)
    assert 200 < len(found) < 500
    assert all(BEGIN_S <= one.at_s <= HALF_HOUR_S - END_BEFORE_S for one in found)


@pytest.mark.parametrize("seed", range(20))
def test_nothing_is_drawn_that_costs_a_vehicle_by_its_nature(seed: int) -> None:
    timeout_s = resolve("hover").vehicle.motors.command_timeout_s
    for one in draw(seed, HALF_HOUR_S, True):
        assert one.target != "sim"
        if one.target == "onboard" and one.action is not Action.FLOOD:
            assert one.action is Action.STOP
            assert one.seconds <= timeout_s / 2
        if one.target == "offboard" and one.action in (Action.KILL, Action.RESTART):
            assert one.at_s < LIVES_SHARE * HALF_HOUR_S


def test_without_root_no_port_is_flooded() -> None:
    assert all(one.action is not Action.FLOOD for one in draw(1, HALF_HOUR_S, False))


def test_the_windows_of_the_link_are_a_configuration() -> None:
    config = resolve("figure8_wind", Choices(duration_s=HALF_HOUR_S, assignments=tuple(blackouts(3, HALF_HOUR_S))))
    for direction in (config.radio.up, config.radio.down):
        assert len(direction.blackouts) > 20
        assert all(one.end_s is not None and one.end_s - one.start_s <= 8.0 for one in direction.blackouts)
    assert config.radio.up != config.radio.down
