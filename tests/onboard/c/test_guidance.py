"""Paths, path clock and guidance: the C core against numpy's."""

import ctypes
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.estimation.state import VehicleState
from onboard.flight.guidance import Guidance, GuidanceConfig
from onboard.flight.path_turn import STEP_S, path_turn
from onboard.flight.trajectory import (
    Circle,
    Figure8,
    Hover,
    Lissajous,
    Path,
    PathClock,
    PathPoint,
    TrajectoryConfig,
    Waypoints,
    smooth_step,
    swings,
)
from tests.onboard.c.parity import SETTINGS, array, call, configured, filled, numbers, same, vectors, view
from tests.onboard.control.fixture import DT

PATHS = {
    "hover": Hover(kind="hover"),
    "figure8": Figure8(kind="figure8", length_m=2.0, width_m=1.0, period_s=6.0),
    "figure8_from_the_tip": Figure8(kind="figure8", length_m=2.0, width_m=1.0, period_s=6.0, start_phase=0.25),
    "lissajous": Lissajous(kind="lissajous", length_m=2.0, width_m=1.0, period_s=6.0, seed=3),
    "circle": Circle(kind="circle", radius_m=1.0, period_s=5.0),
    "circle_from_the_far_end": Circle(kind="circle", radius_m=1.0, period_s=5.0, start_phase=0.5),
    "waypoints": Waypoints(
        kind="waypoints", points_m=((1.0, 0.0, -0.2), (1.0, 0.0, -0.2), (0.0, 2.0, 0.0)), speed_m_s=0.7, wait_s=0.5
    ),
}
OFF_CENTRE = ("lissajous", "figure8_from_the_tip", "circle_from_the_far_end")


def trajectory(name: str, ramp_s: float = 3.0) -> TrajectoryConfig:
    given = {"altitude_m": 1.0, "takeoff_s": 2.5, "settle_s": 1.0, "landing_speed_m_s": 0.4, "yaw_rad": 0.3}
    return TrajectoryConfig(path=PATHS[name], ramp_s=ramp_s, **given)


def drawn(core: Core, config: TrajectoryConfig) -> Any:
    """The motions of a Lissajous path, as the image of the configuration holds them."""
    motions = (core.Swing * 2)()
    if isinstance(config.path, Lissajous):
        for target, source in zip(motions, swings(config.path), strict=True):
            target.amplitude_m, target.omega_rad_s, target.phase_rad = source
    return motions


def same_point(ours: Any, theirs: PathPoint) -> None:
    for name in PathPoint._fields:
        same(getattr(ours, name), getattr(theirs, name), scale=1.0)


@SETTINGS
@given(s=numbers(1.5, -0.5))
def test_smooth_step(core: Core, s: float) -> None:
    same(call(core, "smooth_step", s, out=3), smooth_step(s), scale=1.0)


@pytest.mark.parametrize("name", PATHS)
@SETTINGS
@given(t=st.one_of(st.floats(0.0, 12.0), st.floats(12.0, 400.0)), ramp_s=st.sampled_from([0.0, 3.0]))
def test_path(core: Core, name: str, t: float, ramp_s: float) -> None:
    config = trajectory(name, 3.0 if name in OFF_CENTRE else ramp_s)
    ours, theirs = core.Path(), Path(config)
    core.path_init(ours, configured(core, config), drawn(core, config))
    point = core.PathPoint()
    core.path_at(ours, t, point)
    same_point(point, theirs.at(t))
    assert core.path_lap_s(ours) == theirs.lap_s
    assert core.path_laps_from_s(ours) == theirs.laps_from_s()
    assert core.path_lap_phase(ours, t) == pytest.approx(theirs.lap_phase(t), abs=1e-12)


def test_the_last_moment_of_a_lap_is_in_that_lap(core: Core, core32: Core) -> None:
    """A float rounds such a phase to 1, which is the place where the next lap begins."""
    config = trajectory("figure8")
    for one in (core, core32):
        ours = one.Path()
        one.path_init(ours, configured(one, config), drawn(one, config))
        end_s = Path(config).laps_from_s() + 6.0
        assert 0.999999 < one.path_lap_phase(ours, end_s - 1e-9) < 1.0
        assert one.path_lap_phase(ours, end_s) == 0.0


def test_a_long_flight_in_float_keeps_its_place(core32: Core) -> None:
    """An hour on the figure-8: the phase is not lost, since path time is a double."""
    config = trajectory("figure8")
    ours, point = core32.Path(), core32.PathPoint()
    core32.path_init(ours, configured(core32, config), drawn(core32, config))
    for t in (3599.0, 3600.37):
        core32.path_at(ours, t, point)
        np.testing.assert_allclose(view(point.position), Path(config).at(t).position, atol=2e-3)


@SETTINGS
@given(runs=st.lists(st.tuples(st.booleans(), st.integers(1, 90)), min_size=1, max_size=4), seed=st.integers(0, 999))
def test_path_clock(core: Core, runs: list[tuple[bool, int]], seed: int) -> None:
    ours, theirs = core.PathClock(), PathClock()
    core.path_clock_init(ours)
    for run, count in runs:
        for _ in range(count):
            core.path_clock_step(ours, run, DT)
            theirs.step(run, DT)
    same([ours.time_s, ours.rate, ours.rate_change], [theirs.time_s, theirs.rate, theirs.rate_change], scale=1.0)
    assert core.path_clock_steady(ours) == theirs.steady
    values = np.random.default_rng(seed).normal(size=(3, 3))
    point = PathPoint(*(tuple(row) for row in values.tolist()))
    c_point = filled(core.PathPoint, point)
    core.path_clock_ahead(ours, c_point)
    same_point(c_point, theirs.ahead(point))


@SETTINGS
@given(before=vectors(3, 8.0), now=vectors(3, 8.0), after=vectors(3, 8.0))
def test_path_turn(core: Core, before: list[float], now: list[float], after: list[float]) -> None:
    turn, expected = core.PathTurn(), path_turn((*before,), (*now,), (*after,))
    core.path_turn(array(core, before), array(core, now), array(core, after), turn)
    same(turn.rate, expected.rate, scale=1.0 / STEP_S)
    same(turn.acceleration, expected.acceleration, scale=1.0 / STEP_S**2)


def guidance_config(name: str) -> GuidanceConfig:
    return GuidanceConfig(
        trajectory=trajectory(name),
        land_after_s=5.0,
        feed_forward_lead_s=0.05,
        look_ahead_s=0.14,
        attitude_look_ahead_s=0.05,
    )


EVENTS = st.sampled_from(["start", "jump", "first pose", "two jumps", "place", "rest", "none"])


@pytest.mark.parametrize("name", PATHS)
@SETTINGS
@given(
    events=st.lists(
        st.tuples(EVENTS, vectors(3, 0.6), *[st.booleans()] * 3, st.integers(1, 60)), min_size=1, max_size=6
    )
)
def test_guidance(core: Core, name: str, events: list[Any]) -> None:
    config = guidance_config(name)
    ours, theirs, state, posed = core.Guidance(), Guidance(config), VehicleState(), False
    core.guidance_init(ours, configured(core, config), drawn(core, config.trajectory))
    for event, where, run, landing, climbing, count in events:
        posed = posed or event == "first pose"
        _happen(core, ours, theirs, state, event, where)
        core.guidance_follow_jump(ours, filled(core.VehicleState, state), posed)
        theirs.follow_jump(state, posed)
        for _ in range(count):
            target, expected = core.Target(), theirs.step(run, landing, DT, climbing)
            core.guidance_step(ours, run, landing, DT, climbing, target)
        for point in ("now", "ahead", "attitude_ahead", "path"):
            same_point(getattr(target, point), getattr(expected, point))
        same(target.feed_forward, expected.feed_forward, scale=1.0)
        same(target.turn.rate, expected.turn.rate, scale=1.0 / STEP_S)
        same(target.turn.acceleration, expected.turn.acceleration, scale=1.0 / STEP_S**2)
        rest = [target.yaw_rad, target.lap_phase, target.lap_s]
        same(rest, [expected.yaw_rad, expected.lap_phase, expected.lap_s], scale=1.0)
        assert core.guidance_finished(ours) == theirs.finished


def _happen(core: Core, ours: Any, theirs: Guidance, state: VehicleState, event: str, where: list[float]) -> None:
    if event in ("jump", "first pose", "two jumps"):
        state.position_reset_count += 2 if event == "two jumps" else 1
        state.position_jump[:] = where
    elif event == "start":
        state.position[:] = where
        theirs.start(state)
        core.guidance_start(ours, filled(core.VehicleState, state))
    elif event in ("place", "rest"):
        getattr(theirs, event)((*where,))
        getattr(core, f"guidance_{event}")(ours, array(core, where))


def test_the_way_back_after_a_jump_ends(core: Core) -> None:
    """The offset reaches exactly zero in both, and from then on the target is the path."""
    config = guidance_config("hover")
    ours, theirs, state = core.Guidance(), Guidance(config), VehicleState()
    core.guidance_init(ours, configured(core, config), drawn(core, config.trajectory))
    state.position_reset_count, state.position_jump[:] = 1, (0.1, -0.05, 0.0)
    theirs.follow_jump(state, False)
    core.guidance_follow_jump(ours, filled(core.VehicleState, state), False)
    target = core.Target()
    for _ in range(200):
        expected = theirs.step(True, False, DT)
        core.guidance_step(ours, True, False, DT, False, target)
        same_point(target.now, expected.now)
    assert list(ours.offset) == [0.0, 0.0, 0.0]
    assert math.dist(target.now.position, target.path.position) == 0.0


def test_pointers_in_structures_are_pointers(core: Core) -> None:
    state = core.VehicleState()
    inputs = core.ControlInputs(state=ctypes.pointer(state))
    state.time_ns = 7
    assert inputs.state.contents.time_ns == 7
