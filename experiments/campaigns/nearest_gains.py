"""Gains that have the margins, near gains that may not have them. Nothing is flown.

Away from the margins: steps of random size, accepted when less is missing. Then back: every value in turn returns to
where it started, wholly or by a part of the way, as long as nothing is missing. So what the margins do not depend on
stays as it was, and the rest changes as little as these single returns can make it.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

AWAY_MAX: Final = 400
"""Steps after which no gains with the margins are expected near these."""
RETURNS: Final = (1.0, 0.5, 0.25)
"""Shares of the way back that are tried."""
ROUNDS: Final = 2
SIGMA: Final = (0.02, 0.2)
"""Least and greatest standard deviation of a step away, as a share of each range."""

Point = Sequence[float]
"""The value of each parameter as a share of its range, from 0 to 1."""


def nearest(start: Point, missing: Callable[[Point], float], rng: np.random.Generator) -> Point | None:
    """A point near `start` where nothing is missing, or None if none was found.

    missing: what a point misses, 0 for nothing; it should fall as the point gets nearer.
    """
    there = _away(start, missing, rng)
    if there is None:
        return None
    for _ in range(ROUNDS):
        for index in rng.permutation(len(there)).tolist():
            there = _back(index, there, start, missing)
    return there


def _away(start: Point, missing: Callable[[Point], float], rng: np.random.Generator) -> Point | None:
    best, least = start, missing(start)
    low, high = SIGMA
    for _ in range(AWAY_MAX):
        if least == 0.0:
            return best
        sigma = low * (high / low) ** float(rng.uniform())
        chosen = rng.random(len(start)) < 0.5
        steps = sigma * rng.standard_normal(len(start)) * chosen
        point = np.clip(np.asarray(best) + steps, 0.0, 1.0).tolist()
        if (now := missing(point)) < least:
            best, least = point, now
    return best if least == 0.0 else None


def _back(index: int, there: Point, start: Point, missing: Callable[[Point], float]) -> Point:
    way = start[index] - there[index]
    for share in RETURNS:
        point = [*there[:index], there[index] + share * way, *there[index + 1 :]]
        if way != 0.0 and missing(point) == 0.0:
            return point
    return there


def shortened(start: Point, to: Point, missing: Callable[[Point], float], halvings: int = 4) -> Point:
    """The end of a step that is halved while something is missing; after all halvings, the full step."""
    point = to
    for _ in range(halvings + 1):
        if missing(point) == 0.0:
            return point
        point = [0.5 * (a + b) for a, b in zip(start, point, strict=True)]
    return to
