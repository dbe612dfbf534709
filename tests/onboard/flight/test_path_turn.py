"""The turn of a path's thrust, against the attitude that the path asks for, differentiated in time."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.flight.path_turn import STEP_S, PathTurn, path_turn
from protocol.conventions import GRAVITY
from protocol.geometry import Vector3, attitude_for_thrust

H = 1e-4


def swing(t: float) -> Vector3:
    """Acceleration of a path with north, east and vertical motion, m/s^2."""
    return 2.0 * np.sin(1.7 * t), 3.0 * np.cos(2.3 * t), 1.0 * np.sin(1.1 * t)


def turn_at(path: Callable[[float], Vector3], t: float) -> PathTurn:
    return path_turn(path(t - STEP_S), path(t), path(t + STEP_S))


def down(t: float) -> np.ndarray:
    """The vehicle's down axis, as the controller commands it."""
    f = -np.array(swing(t)) + (0.0, 0.0, GRAVITY)
    q = attitude_for_thrust(tuple(f / np.linalg.norm(f)), 0.3)
    return Rotation.from_quat(q, scalar_first=True).apply([0.0, 0.0, 1.0])


@pytest.mark.parametrize("t", [0.0, 0.4, 1.1, 2.7])
def test_rate_and_acceleration_move_the_commanded_axis(t: float) -> None:
    """d' = omega x d, and d'' = alpha x d + omega x d'."""
    before, now, after = down(t - H), down(t), down(t + H)
    first, second = (after - before) / (2.0 * H), (after - 2.0 * now + before) / H**2
    rate, acceleration = map(np.array, turn_at(swing, t))
    np.testing.assert_allclose(np.cross(rate, now), first, atol=0.005)
    np.testing.assert_allclose(np.cross(acceleration, now) + np.cross(rate, first), second, atol=0.01)
    assert max(np.abs(first).max(), np.abs(second).max()) > 0.1


def test_the_turn_is_not_about_the_thrust_itself() -> None:
    """The heading has its own target."""
    for t in (0.2, 0.9):
        turn = turn_at(swing, t)
        assert abs(np.array(turn.rate) @ down(t)) < 1e-9


def test_a_constant_acceleration_turns_nothing() -> None:
    turn = turn_at(lambda _: (1.0, -2.0, 0.5), 0.0)
    assert not np.any(turn.rate)
    assert not np.any(turn.acceleration)


def test_a_jump_of_the_acceleration_is_a_turn_within_two_steps() -> None:
    """The integral of the rate is about the angle between the two attitudes, that of the acceleration zero."""
    times = np.arange(-0.1, 0.1, 0.001)
    turns = [turn_at(lambda t: (0.0, 1.0 if t > 0.0 else 0.0, 0.0), t) for t in times]
    rates, accelerations = (np.array([one[i][0] for one in turns]) for i in (0, 1))
    assert rates.sum() * 0.001 == pytest.approx(np.arctan(1.0 / GRAVITY), rel=0.03)
    assert accelerations.sum() * 0.001 == pytest.approx(0.0, abs=0.1)
    moving = times[np.abs(rates) > 0.0]
    assert -STEP_S - 0.002 < moving.min() < moving.max() < STEP_S + 0.002


def test_free_fall_is_no_infinite_turn() -> None:
    turn = path_turn((0.0, 0.0, GRAVITY), (0.1, 0.0, GRAVITY), (0.2, 0.0, GRAVITY))
    assert np.all(np.abs(turn.rate) < 1.3)
    assert np.all(np.isfinite(turn.acceleration))
