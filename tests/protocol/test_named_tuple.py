"""Tuples that are made without their constructor are the same."""

from typing import NamedTuple

from protocol.named_tuple import of_members


class Point(NamedTuple):
    """Two numbers, one of them with a default."""

    x: float
    y: float = 0.0


def test_a_tuple_of_its_members_is_what_the_constructor_makes() -> None:
    made = of_members(Point)((1.0, 2.0))
    assert type(made) is Point
    assert made == Point(1.0, 2.0)
    assert (made.x, made._replace(y=3.0)) == (1.0, Point(1.0, 3.0))
