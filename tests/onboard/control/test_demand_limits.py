"""Limits of the position loop's demand, and what they are worth to a vehicle with a rotor that gives little thrust."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.control import cascade
from onboard.control.demand_limits import ASTRAY_COSINE, FALL_MIN_M_S2, DemandLimits, DemandLimitsConfig, thrust_along
from protocol.conventions import GRAVITY
from tests.onboard.control.fixture import DT, Rig, shipped_controller

CONFIG = DemandLimitsConfig()
HARD = (0.0, 0.0, -30.0)
"""A climb that the limits cut."""
accelerations = st.tuples(*(st.floats(-1e3, 1e3),) * 3)


def tilt(f: tuple[float, float, float]) -> float:
    return math.atan2(math.hypot(f[0], f[1]), f[2])


@given(u=accelerations, nu_z=st.floats(-20, 20), residuals=st.lists(st.floats(-20, 20), max_size=50))
def test_tilt_and_fall_stay_within_the_limits_for_any_demand(u: tuple, nu_z: float, residuals: list[float]) -> None:
    limits = DemandLimits(CONFIG)
    for residual in residuals:
        limits.step(True, residual, DT)
    f = limits.specific_thrust(u, nu_z)
    assert f[2] >= FALL_MIN_M_S2
    assert tilt(f) <= CONFIG.tilt_max_rad + 1e-9


def test_a_demand_within_the_limits_is_met_exactly() -> None:
    assert DemandLimits(CONFIG).specific_thrust((1.0, -2.0, 0.5), 0.0) == (-1.0, 2.0, GRAVITY - 0.5)


def test_a_take_off_may_ask_for_more_until_the_laws_adapt() -> None:
    limits, hard = DemandLimits(CONFIG), (0.0, 0.0, -20.0)
    assert limits.specific_thrust(hard, 0.0)[2] == pytest.approx(GRAVITY + CONFIG.take_off_acceleration_max_m_s2)
    for adapting in (True, False):  # what it once knew it does not forget
        limits.step(adapting, 0.0, DT)
        assert limits.specific_thrust(hard, 0.0)[2] == pytest.approx(GRAVITY + CONFIG.climb_acceleration_max_m_s2)
    limits.reset()
    assert limits.specific_thrust(hard, 0.0)[2] == pytest.approx(GRAVITY + CONFIG.take_off_acceleration_max_m_s2)


def test_nu_ad_comes_on_top_of_the_vertical_limits() -> None:
    climb, limits = CONFIG.climb_acceleration_max_m_s2, DemandLimits(CONFIG)
    limits.step(True, 0.0, DT)
    assert limits.specific_thrust((0.0, 0.0, -100.0), 3.0)[2] == pytest.approx(GRAVITY + climb + 3.0)


@pytest.mark.parametrize("share", [1.0, 0.8, 0.6])
def test_a_vehicle_whose_thrust_is_weak_lifts_off_with_the_acceleration_that_the_limit_allows(share: float) -> None:
    """The motors give a share of the thrust; the floor carries what is missing to the weight."""
    limits, most, upwards = DemandLimits(CONFIG), 0.0, []
    for _ in range(600):
        most = limits.specific_thrust(HARD, 0.0)[2]
        upwards.append(max(share * most - GRAVITY, 0.0))
        limits.step(False, upwards[-1] * -1.0 - (GRAVITY - most), DT)
    assert (upwards[0] > 0.5) is (share > 0.75), "the weaker ones stay on the floor at first"
    assert upwards[-1] == pytest.approx(CONFIG.take_off_acceleration_max_m_s2, rel=0.01)


def test_the_lack_of_thrust_counts_once_and_only_while_it_lasts() -> None:
    climb, limits = CONFIG.climb_acceleration_max_m_s2, DemandLimits(CONFIG)
    for _ in range(400):
        limits.step(True, 3.0, DT)
    for nu_z, extra in ((0.0, 3.0), (1.0, 3.0), (3.0, 3.0), (4.0, 4.0), (-1.0, 2.0)):
        assert limits.specific_thrust(HARD, nu_z)[2] == pytest.approx(GRAVITY + climb + extra, abs=1e-3), nu_z
    for _ in range(400):
        limits.step(True, -3.0, DT)
    assert limits.specific_thrust(HARD, -1.0)[2] == pytest.approx(GRAVITY + climb - 1.0), "strong motors: as ever"


def axis_at(degrees: float) -> tuple[float, float, float]:
    return math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))


UP = (0.0, 0.0, GRAVITY)


@pytest.mark.parametrize("degrees", [0.0, 5.0, 16.0])
def test_near_the_wanted_direction_the_thrust_is_its_projection(degrees: float) -> None:
    assert thrust_along(UP, axis_at(degrees)) == GRAVITY * axis_at(degrees)[2]


@pytest.mark.parametrize("degrees", [26.0, 40.0, 59.0])
def test_a_vehicle_that_is_tilted_far_from_the_wanted_direction_keeps_its_height(degrees: float) -> None:
    axis = axis_at(degrees)
    assert thrust_along(UP, axis) * axis[2] == pytest.approx(GRAVITY)
    assert GRAVITY * axis[2] ** 2 < 0.82 * GRAVITY, "the projection lets it sink"


def height_while_something_rolls_it() -> float:
    """Least height, m, of a vehicle that hovers at 1 m while a moment rolls it to and fro, beyond 40 degrees."""
    rig, heights, tilts = Rig(shipped_controller("none")), [], []
    for tick in range(400):
        rig.torque[0] = 120.0 * math.sin(9.0 * tick * DT)
        rig.fly(DT)
        heights.append(-rig.position[2])
        tilts.append(rig.state.tilt_rad)
    assert math.radians(40.0) < max(tilts) < math.radians(60.0)
    return min(heights)


def test_a_vehicle_that_rolls_to_and_fro_does_not_sink(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ablation: with the projection alone, it does."""
    assert height_while_something_rolls_it() > 0.95
    monkeypatch.setattr(cascade, "thrust_along", lambda f, axis: max(float(np.dot(f, axis)), 0.0))
    assert height_while_something_rolls_it() < 0.7


def test_the_thrust_is_continuous_in_the_attitude_and_never_negative() -> None:
    lean = (-3.0, 1.0, 9.0)
    thrusts = [thrust_along(lean, axis_at(0.01 * step)) for step in range(-18000, 18000)]
    assert max(abs(b - a) for a, b in pairwise(thrusts)) < 0.02
    assert min(thrusts) == 0.0
    assert ASTRAY_COSINE[0] > ASTRAY_COSINE[1]


def test_a_residual_that_is_no_number_leaves_no_trace() -> None:
    limits = DemandLimits(CONFIG)
    limits.step(True, math.nan, DT)
    assert limits.lack == 0.0


def test_the_tilt_is_limited() -> None:
    assert tilt(DemandLimits(CONFIG).specific_thrust((20.0, 0.0, 0.0), 0.0)) == pytest.approx(CONFIG.tilt_max_rad)


SHORT_OF_THRUST = (
    "vehicle.motors.gain=[0.70, 0.70, 0.70, 0.70]",
    "vehicle.body.mass_kg=0.080",
    "onboard.controller.settings.limits.lack_filter_s=",
)
"""Full thrust is 1.17 times the weight at the rated voltage."""


@pytest.mark.parametrize("controller", ["l1", "pid"])
def test_a_vehicle_with_a_sixth_of_thrust_to_spare_takes_off_and_hovers(controller: str) -> None:
    """The ablation: if the lack is measured too slowly to matter, it hardly leaves the floor."""
    heights = []
    for filter_s in ("0.2", "10"):
        assignments = (*SHORT_OF_THRUST[:2], SHORT_OF_THRUST[2] + filter_s)
        flight = fly_lockstep(resolve("hover", Choices(controller, 3, 5.0, assignments)))
        assert not flight.crash_reason
        heights.append(-float(flight.trace.truth["position_d"].min()))
    assert heights[0] == pytest.approx(1.0, abs=0.15)
    assert heights[1] < 0.5


WEAK = (
    "vehicle.motors.gain=[0.70, 0.70, 0.70, 0.70]",
    "vehicle.body.mass_kg=0.0744",
    "vehicle.motors.lag_up_s=0.05",
    "vehicle.motors.command_delay_s=0.01",
    "vehicle.disturbances.0.origin_ned_m=[0.6, -2.0, -1.0]",
    "vehicle.disturbances.0.speed_m_s=4",
)


def test_a_vehicle_at_the_limit_of_its_thrust_flies_through_the_jet() -> None:
    """Its motors saturate for much of the time; the limits do not depend on it."""
    flight = fly_lockstep(resolve("figure8_wind", Choices("l1", 3, 16.0, WEAK)))
    assert not flight.crash_reason
    assert flight.trace.tick["saturated"].mean() > 0.05
    on_path = flight.trace.on_path
    assert np.linalg.norm(flight.trace.position_error[on_path], axis=1).max() < 0.5
