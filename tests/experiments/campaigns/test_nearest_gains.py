"""Gains with the margins near gains without: found, near, and None where there are none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.campaigns.nearest_gains import nearest, shortened

SHARE = st.floats(0.0, 1.0)


def outside_a_ball(point: list[float]) -> float:
    """What a point misses to be within 0.2 of (0.3, 0.3) in the first two coordinates; the third does not matter."""
    return max(0.0, float(np.hypot(point[0] - 0.3, point[1] - 0.3)) - 0.2)


@given(start=st.tuples(SHARE, SHARE, SHARE), seed=st.integers(0, 100))
def test_the_point_has_what_is_asked_and_keeps_what_does_not_matter(start: tuple[float, ...], seed: int) -> None:
    """The first two coordinates enter the ball; the third stays."""
    found = nearest(list(start), outside_a_ball, np.random.default_rng(seed))
    assert found is not None
    assert outside_a_ball(list(found)) == 0.0
    assert found[2] == pytest.approx(start[2])


def test_a_point_that_misses_nothing_stays() -> None:
    """No step is made."""
    assert nearest([0.3, 0.4, 0.9], outside_a_ball, np.random.default_rng(0)) == [0.3, 0.4, 0.9]


def test_the_way_back_shortens_the_change() -> None:
    """Along one axis the point ends close to the ball's edge, not somewhere inside."""
    found = nearest([0.9, 0.3, 0.5], outside_a_ball, np.random.default_rng(3))
    assert found is not None
    assert np.hypot(found[0] - 0.3, found[1] - 0.3) > 0.1


def test_none_where_nothing_has_the_margins() -> None:
    """The search away ends."""
    assert nearest([0.5], lambda point: 1.0, np.random.default_rng(0)) is None


def test_a_step_is_halved_until_it_misses_nothing() -> None:
    """From inside the ball: half the step is inside, the whole is not."""
    assert shortened([0.3, 0.3], [0.6, 0.3], outside_a_ball) == pytest.approx([0.45, 0.3])
    assert shortened([0.9, 0.9], [1.0, 0.9], outside_a_ball) == [1.0, 0.9]
