"""Paths compared with finite differences, the smooth step, and the path clock."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.loader import ConfigError, fill
from onboard.flight.trajectory import Path, PathClock, TrajectoryConfig, smooth_step

COMMON = {
    "altitude_m": 1.2,
    "takeoff_s": 2.5,
    "settle_s": 1.0,
    "ramp_s": 3.0,
    "landing_speed_m_s": 0.4,
    "yaw_rad": 0.0,
}
PATHS = {
    "hover": {"kind": "hover"},
    "figure8": {"kind": "figure8", "length_m": 2.0, "width_m": 1.0, "period_s": 6.0},
    "figure8 from elsewhere": {
        "kind": "figure8",
        "length_m": 2.0,
        "width_m": 1.0,
        "period_s": 6.0,
        "start_phase": 0.3,
    },
    "circle from elsewhere": {"kind": "circle", "radius_m": 0.8, "period_s": 5.0, "start_phase": 0.6},
    "lissajous": {"kind": "lissajous", "length_m": 2.0, "width_m": 1.0, "period_s": 6.0, "seed": 7},
    "circle": {"kind": "circle", "radius_m": 0.8, "period_s": 5.0},
    "waypoints": {
        "kind": "waypoints",
        "points_m": ((1.0, 0.0, -0.5), (1.0, 1.0, 0.0), (1.0, 1.0, 0.0), (0.0, 0.0, 0.0)),
        "speed_m_s": 0.5,
        "wait_s": 0.7,
    },
}


def path(kind, **over):
    return Path(fill(TrajectoryConfig, {**COMMON, "path": PATHS[kind], **over}, "test"))


@pytest.mark.parametrize("kind", PATHS)
@pytest.mark.parametrize("ramp_s", [0.0, 3.0])
def test_derivatives_equal_finite_differences(kind, ramp_s):
    flown = path(kind, ramp_s=ramp_s or (0.5 if kind == "lissajous" or "start_phase" in PATHS[kind] else 0.0))
    h = 1e-5
    for t in np.random.default_rng(1).uniform(0.01, 25.0, 300):
        if abs(t - flown.start_s) < 0.01:
            continue  # without a ramp the velocity jumps here, as configured
        before, here, after = flown.at(t - h), flown.at(t), flown.at(t + h)
        velocity = (np.array(after.position) - before.position) / (2 * h)
        acceleration = (np.array(after.velocity) - before.velocity) / (2 * h)
        np.testing.assert_allclose(here.velocity, velocity, atol=2e-6)
        np.testing.assert_allclose(here.acceleration, acceleration, atol=2e-4)


@pytest.mark.parametrize("kind", PATHS)
def test_a_path_with_a_ramp_has_no_jump(kind):
    """Position, velocity and acceleration are continuous from take-off on."""
    flown = path(kind)
    times = np.arange(0.0, 25.0, 0.002)
    points = np.array([flown.at(t) for t in times])
    steps = np.abs(np.diff(points, axis=0)).max(axis=(0, 2))
    assert steps[0] < 0.004
    assert steps[1] < 0.01
    assert steps[2] < 0.1


def test_take_off_begins_and_ends_at_rest():
    flown = path("hover")
    assert flown.at(0.0) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert flown.at(10.0).position == (0.0, 0.0, -1.2)
    assert flown.at(10.0).velocity == (0.0, 0.0, 0.0)
    heights = [flown.at(t).position[2] for t in np.linspace(0, 2.5, 50)]
    assert heights == sorted(heights, reverse=True)


def test_laps_repeat_and_have_the_stated_size():
    flown = path("figure8")
    start = flown.laps_from_s()
    assert flown.lap_s == 6.0
    np.testing.assert_allclose(flown.at(start + 2.0).position, flown.at(start + 8.0).position, atol=1e-12)
    points = np.array([flown.at(start + t).position for t in np.linspace(0, 6, 1201)])
    np.testing.assert_allclose(np.ptp(points, axis=0), (2.0, 1.0, 0.0), atol=1e-4)
    assert path("hover").lap_s == 0.0


def lissajous(seed):
    return path("lissajous", path={**PATHS["lissajous"], "seed": seed})


def test_a_lissajous_path_is_drawn_by_its_seed_within_the_figure_8s_size_and_as_fast():
    times = np.arange(0.0, 600.0, 0.05)
    reference = path("figure8")
    speed = rms_speed(reference, times)
    for seed in range(8):
        flown = lissajous(seed)
        points = np.array([flown.at(flown.laps_from_s() + t).position for t in times])
        assert np.abs(points[:, :2]).max(axis=0) == pytest.approx((1.0, 0.5), abs=0.01)
        assert rms_speed(flown, times) == pytest.approx(speed, rel=0.01)
    assert lissajous(3).at(9.0) == lissajous(3).at(9.0)
    assert lissajous(3).at(9.0) != lissajous(4).at(9.0)


def rms_speed(flown, times):
    velocity = np.array([flown.at(flown.laps_from_s() + t).velocity for t in times])
    return float(np.sqrt((velocity**2).sum(axis=1).mean()))


def test_a_lissajous_path_does_not_come_back_with_the_figure_8s_lap():
    """A lap later the target is somewhere else, and there is no phase to learn by."""
    for seed in range(8):
        flown = lissajous(seed)
        times = flown.laps_from_s() + np.arange(0.0, 18.0, 0.05)
        apart = np.array([np.subtract(flown.at(t + 6.0).position, flown.at(t).position) for t in times])
        assert np.sqrt((apart**2).sum(axis=1).mean()) > 0.15
        assert flown.lap_s == 0.0
        assert flown.window_s == 6.0
        assert flown.lap_phase(20.0) == -1.0


def test_a_lissajous_path_needs_a_ramp():
    with pytest.raises(ConfigError, match="ramp_s"):
        path("lissajous", ramp_s=0.0)


def test_the_lap_phase_runs_from_the_first_lap_at_full_speed():
    flown = path("figure8")
    start = flown.laps_from_s()
    assert flown.lap_phase(start - 0.01) == -1.0
    assert flown.lap_phase(start) == 0.0
    assert flown.lap_phase(start + 7.5) == pytest.approx(0.25)
    assert path("hover").lap_phase(20.0) == -1.0


def starting(kind, start_phase, **over):
    return path(kind, path={**PATHS[kind], "start_phase": start_phase}, **over)


@pytest.mark.parametrize("kind", ["figure8", "circle"])
def test_without_a_start_phase_a_path_is_the_same_to_the_bit(kind):
    without, zero = path(kind), starting(kind, 0.0)
    assert [zero.at(t) for t in np.arange(0.0, 20.0, 0.05)] == [without.at(t) for t in np.arange(0.0, 20.0, 0.05)]


@pytest.mark.parametrize("kind", ["figure8", "circle"])
@pytest.mark.parametrize("start_phase", [0.05, 0.25, 0.5, 0.9])
def test_a_start_phase_moves_the_laps_in_time_and_leaves_their_shape(kind, start_phase):
    """It starts at rest where it took off; at full speed it is as far ahead of the other as the phase says."""
    flown, other = starting(kind, start_phase), path(kind)
    assert flown.at(flown.start_s + 1e-9).position == pytest.approx((0.0, 0.0, -1.2), abs=1e-6)
    assert flown.at(flown.start_s + 1e-9).velocity == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert (flown.laps_from_s(), flown.lap_s) == (other.laps_from_s(), other.lap_s)
    for t in flown.laps_from_s() + np.arange(0.0, 12.0, 0.1):
        later = other.at(t + start_phase * other.lap_s)
        for one, two in zip(flown.at(t), later, strict=True):
            assert one == pytest.approx(two, abs=1e-9)
        assert flown.lap_phase(t) == other.lap_phase(t)


@pytest.mark.parametrize("kind", ["figure8", "circle"])
def test_the_way_to_a_start_phase_asks_for_no_more_than_twice_the_laps(kind):
    flown = path(kind)
    laps = largest(flown, flown.laps_from_s(), flown.lap_s)
    for start_phase in np.arange(0.05, 1.0, 0.1):
        speed, acceleration = largest(starting(kind, float(start_phase)), flown.start_s, 3.0)
        assert speed < 1.4 * laps[0]
        assert acceleration < 2.0 * laps[1]


def largest(flown, since_s, length_s):
    points = [flown.at(t) for t in np.arange(since_s, since_s + length_s, 0.02)]
    return [max(np.linalg.norm(point[order]) for point in points) for order in (1, 2)]


@pytest.mark.parametrize(
    ("over", "said"),
    [({"ramp_s": 0.0}, "ramp_s 0: expected more than 0, because a path with a start_phase"), ({}, "start_phase")],
)
def test_a_start_phase_needs_a_ramp_and_lies_within_a_lap(over, said):
    with pytest.raises(ConfigError, match=said):
        starting("figure8", 0.5 if over else 1.1, **over)


def test_the_circle_keeps_its_radius():
    flown = path("circle")
    for t in np.linspace(0, 20, 100):
        north, east, _ = flown.at(flown.start_s + t).position
        assert math.hypot(north - 0.8, east) == pytest.approx(0.8)


def test_the_path_rests_at_each_waypoint():
    flown = path("waypoints")
    points = np.array([flown.at(flown.start_s + t).position for t in np.arange(0.0, 20.0, 0.01)])
    for target in PATHS["waypoints"]["points_m"]:
        distance = np.linalg.norm(points - np.array([target[0], target[1], target[2] - 1.2]), axis=1)
        assert (distance < 1e-9).sum() >= 60
    assert flown.at(1e4).position == pytest.approx((0.0, 0.0, -1.2))


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.floats(-1.0, 2.0))
def test_smooth_step_is_monotonic_symmetric_and_bounded(s):
    value, first, _ = smooth_step(s)
    assert 0.0 <= value <= 1.0 + 1e-12
    assert first >= 0.0
    assert smooth_step(1.0 - s)[0] == pytest.approx(1.0 - value, abs=1e-9)


def test_smooth_step_ends_at_rest():
    for edge in (1e-9, 1.0 - 1e-9):
        _, first, second = smooth_step(edge)
        assert first == pytest.approx(0.0, abs=1e-7)
        assert second == pytest.approx(0.0, abs=1e-6)


def run_clock(flown, demands, dt=0.001):
    """Target in real time under a sequence of (run, seconds)."""
    clock, points = PathClock(), []
    for run, seconds in demands:
        for _ in range(round(seconds / dt)):
            clock.step(run, dt)
            points.append(clock.ahead(flown.at(clock.time_s)))
    return clock, points


@pytest.mark.parametrize(
    "demands",
    [
        [(True, 9.0), (False, 2.0), (True, 3.0)],
        [(True, 9.0), (False, 0.4), (True, 0.3), (False, 0.2), (True, 2.0)],
    ],
    ids=["full stop", "changes its mind"],
)
def test_a_held_path_has_no_jump_of_velocity_and_its_derivatives_are_those_of_real_time(demands):
    dt = 0.001
    _, points = run_clock(path("figure8"), demands, dt)
    position, velocity, acceleration = (np.array([point[i] for point in points]) for i in range(3))
    np.testing.assert_allclose(np.diff(position, axis=0) / dt, 0.5 * (velocity[1:] + velocity[:-1]), atol=3e-3)
    assert np.abs(np.diff(velocity, axis=0)).max() < 5.0 * dt
    change = np.abs(np.diff(velocity, axis=0) / dt - 0.5 * (acceleration[1:] + acceleration[:-1])).max(axis=1)
    assert np.quantile(change, 0.99) < 0.02  # the acceleration itself may jump when the demand does


def test_a_held_path_stops_and_goes_on_from_there():
    flown = path("circle")
    clock, points = run_clock(flown, [(True, 9.0), (False, 3.0)])
    assert clock.rate == 0.0
    assert points[-1].velocity == (0.0, 0.0, 0.0)
    assert points[-1].position == points[-500].position
    held = clock.time_s
    clock.step(True, 0.001)
    assert clock.time_s == pytest.approx(held, abs=1e-3)


def test_the_clock_runs_at_full_rate_without_holds():
    clock, _ = run_clock(path("hover"), [(True, 5.0)])
    assert clock.time_s == pytest.approx(5.0)


def test_bad_values_are_refused_and_named():
    with pytest.raises(ConfigError, match=r"altitude_m"):
        path("hover", altitude_m=-1.0)
    with pytest.raises(ConfigError, match=r"path"):
        path("hover", path={"kind": "spiral"})
