"""Stability, and its margins, from frequency responses."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.conventions import Array

Complex = NDArray[np.complex128]


class Margins(NamedTuple):
    """Margins of one loop. Infinite where the loop has no such crossing in the band."""

    gain_margin_db: float
    """Smallest factor, up or down, that the gain may change by."""
    phase_margin_deg: float
    delay_margin_ms: float
    """Delay that the loop tolerates in addition to its own."""
    crossover_rad_s: float
    """Highest frequency with |L| = 1."""


def margins(omega: Array, L: Complex) -> Margins:
    """Margins of L [n] at the frequencies omega [n], rad/s, ascending; linear between them in log-log.

    The loop is closed by negative feedback: it is unstable where L = -1.
    """
    x = np.log(omega)
    level = np.log(np.abs(L))
    phase = np.unwrap(np.angle(L))
    crossings = [(np.exp(at), share, i) for at, share, i in _zeros(x, level)]
    phases = [(w, phase[i] + share * (phase[i + 1] - phase[i])) for w, share, i in crossings]
    above = [(w, np.mod(p + np.pi, 2.0 * np.pi)) for w, p in phases]
    distance = [(w, float(a), float(min(a, 2.0 * np.pi - a))) for w, a in above]
    lowest, highest = (round(float(-(end + np.pi) / (2.0 * np.pi))) for end in (phase.max(), phase.min()))
    gains = [
        abs(level[i] + share * (level[i + 1] - level[i])) * 20.0 / np.log(10.0)
        for turn in range(lowest, highest + 1)
        for _, share, i in _zeros(x, phase + np.pi + 2.0 * np.pi * turn)
    ]
    return Margins(
        min((float(g) for g in gains), default=np.inf),
        min((np.degrees(d) for _, _, d in distance), default=np.inf),
        min((1e3 * a / w for w, a, _ in distance), default=np.inf),
        max((float(w) for w, _, _ in distance), default=0.0),
    )


def unstable_poles(characteristic: Complex) -> int:
    """Zeros in the right half plane of a function that has no poles there and is 1 at infinity.

    By the argument principle: with ascending omega the phase of f(j omega) falls by pi per zero. f is real at 0.

    characteristic: f(j omega) [n], from far below to far above its zeros, less than half a turn between two points.
    """
    phase = np.unwrap(np.angle(characteristic))
    return round(float(phase[0] - phase[-1]) / np.pi)


def _zeros(x: Array, y: Array) -> list[tuple[float, float, int]]:
    """Where y(x) crosses zero: x there, the share of the interval before it, and the interval's index."""
    found = []
    for i in np.flatnonzero(np.sign(y[:-1]) * np.sign(y[1:]) < 0):
        share = float(y[i] / (y[i] - y[i + 1]))
        found.append((float(x[i] + share * (x[i + 1] - x[i])), share, int(i)))
    return found
