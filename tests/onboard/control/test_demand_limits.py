"""Limits of the position loop's demand, and what they are worth to a vehicle with a rotor that gives little thrust."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.control.demand_limits import FALL_MIN_M_S2, DemandLimits, DemandLimitsConfig
from protocol.conventions import GRAVITY

CONFIG = DemandLimitsConfig()
accelerations = st.tuples(*(st.floats(-1e3, 1e3),) * 3)


def tilt(f: tuple[float, float, float]) -> float:
    return math.atan2(math.hypot(f[0], f[1]), f[2])


@given(u=accelerations, nu_z=st.floats(-20, 20), ticks=st.lists(st.booleans(), max_size=50))
def test_tilt_and_fall_stay_within_the_limits_for_any_demand(u: tuple, nu_z: float, ticks: list[bool]) -> None:
    limits = DemandLimits(CONFIG)
    for saturated in ticks:
        limits.step(saturated, True, 0.005)
        assert 0.0 <= limits.shortage <= 1.0
    f = limits.specific_thrust(u, nu_z)
    assert f[2] >= FALL_MIN_M_S2
    assert tilt(f) <= CONFIG.tilt_max_rad + 1e-9


def test_a_demand_within_the_limits_is_met_exactly() -> None:
    assert DemandLimits(CONFIG).specific_thrust((1.0, -2.0, 0.5), 0.0) == (-1.0, 2.0, GRAVITY - 0.5)


def test_a_take_off_may_ask_for_more_until_the_laws_adapt() -> None:
    limits, hard = DemandLimits(CONFIG), (0.0, 0.0, -20.0)
    assert limits.specific_thrust(hard, 0.0)[2] == pytest.approx(GRAVITY + CONFIG.take_off_acceleration_max_m_s2)
    for adapting in (True, False):  # what it once knew it does not forget
        limits.step(False, adapting, 0.005)
        assert limits.specific_thrust(hard, 0.0)[2] == pytest.approx(GRAVITY + CONFIG.climb_acceleration_max_m_s2)
    limits.reset()
    assert limits.specific_thrust(hard, 0.0)[2] == pytest.approx(GRAVITY + CONFIG.take_off_acceleration_max_m_s2)


def test_nu_ad_comes_on_top_of_the_vertical_limits() -> None:
    climb, limits = CONFIG.climb_acceleration_max_m_s2, DemandLimits(CONFIG)
    limits.step(False, True, 0.005)
    assert limits.specific_thrust((0.0, 0.0, -100.0), 3.0)[2] == pytest.approx(GRAVITY + climb + 3.0)


def test_while_the_motors_fall_short_little_is_asked_for_and_the_limits_come_back() -> None:
    limits, wide, hard = DemandLimits(CONFIG), (20.0, 0.0, 0.0), (0.0, 0.0, -20.0)
    assert tilt(limits.specific_thrust(wide, 0.0)) == pytest.approx(CONFIG.tilt_max_rad)
    limits.step(True, True, 0.005)  # one tick of noise costs little
    assert tilt(limits.specific_thrust(wide, 0.0)) > 0.9 * CONFIG.tilt_max_rad
    for _ in range(100):
        limits.step(True, True, 0.005)
    assert tilt(limits.specific_thrust(wide, 0.0)) == pytest.approx(CONFIG.short_tilt_max_rad, rel=1e-2)
    climb = limits.specific_thrust(hard, 0.0)[2] - GRAVITY
    assert climb == pytest.approx(CONFIG.short_climb_max_m_s2, rel=1e-2)
    for _ in range(1000):
        limits.step(False, True, 0.005)
    assert tilt(limits.specific_thrust(wide, 0.0)) == pytest.approx(CONFIG.tilt_max_rad, rel=1e-2)


def test_short_limits_wider_than_the_others_change_nothing() -> None:
    limits = DemandLimits(DemandLimitsConfig(short_tilt_max_rad=1.2, short_climb_max_m_s2=20.0))
    for _ in range(100):
        limits.step(True, True, 0.005)
    assert tilt(limits.specific_thrust((20.0, 0.0, 0.0), 0.0)) == pytest.approx(CONFIG.tilt_max_rad)


WEAK = (
    "vehicle.disturbances=[{kind: rotor_chip, rotor: random, thrust_factor: 0.65, onset_s: 7.0},"
    " {kind: motor_gain, common: 0.95, spread: 0.05}]"
)
WITHOUT = tuple(
    f"onboard.controller.settings.limits.{key}={value}"
    for key, value in (("short_tilt_max_rad", 1.2), ("climb_acceleration_max_m_s2", 5), ("short_climb_max_m_s2", 5))
)


def survivors(*assignments: str) -> int:
    flights = (resolve("rotor_chip", Choices("mrac", seed, 11.0, (WEAK, *assignments))) for seed in range(7))
    return sum(not fly_lockstep(flight, with_offboard=False).crash_reason for flight in flights)


@pytest.mark.full
def test_they_save_a_vehicle_that_has_little_thrust_to_spare() -> None:
    """The ablation too: with wide limits all the while, more are lost (2 of these 7 flights, measured)."""
    assert survivors() >= survivors(*WITHOUT) + 2
