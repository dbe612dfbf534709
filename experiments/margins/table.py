"""Measured and predicted margins of all loops of a controller, as rows of a table and for JSON."""

from typing import Any, Final, NamedTuple

import numpy as np

from experiments.flights.scenario import FlightConfig
from experiments.margins.linear import predicted_loop
from experiments.margins.measurement import Response, measure
from experiments.margins.stability import Complex, Margins, margins

HEADINGS: Final = ("loop", "gain margin [dB]", "phase margin [deg]", "delay margin [ms]", "crossover [rad/s]")
FINE_POINTS: Final = 400


class Loop(NamedTuple):
    """One loop, measured and predicted."""

    measured: Response
    predicted: Complex | None
    """At the same frequencies; None for a controller that is not a cascade."""
    predicted_margins: Margins | None


def measure_all(config: FlightConfig) -> list[Loop]:
    """Fly twice and measure the attitude loops, then the position loops. Raises LoopMeasurementError."""
    loops = []
    for channel in (1, 0):
        for axis, response in enumerate(measure(config, channel)):
            fine = np.geomspace(response.omega[0], response.omega[-1], FINE_POINTS)
            try:
                predicted = predicted_loop(config, channel, axis, response.omega)
                expected = margins(fine, predicted_loop(config, channel, axis, fine))
            except ValueError:
                predicted, expected = None, None
            loops.append(Loop(response, predicted, expected))
    return loops


def cells(loop: Loop) -> tuple[str, ...]:
    """The cells of a row, in the order of HEADINGS: measured, and predicted in brackets."""
    measured, predicted = _text(loop.measured.margins), loop.predicted_margins
    if predicted is None:
        return (loop.measured.loop, *measured)
    each = zip(measured, _text(predicted), strict=True)
    return (loop.measured.loop, *(f"{one} ({other})" for one, other in each))


def as_json(controller: str, loops: list[Loop]) -> list[dict[str, Any]]:
    """One entry per loop; null for a margin that the measured band does not contain."""
    entries = []
    for loop in loops:
        gain, phase, delay, _ = (value if np.isfinite(value) else None for value in loop.measured.margins)
        entry = {"controller": controller, "loop": loop.measured.loop, "gain_margin_db": gain}
        entries.append({**entry, "phase_margin_deg": phase, "delay_margin_ms": delay})
    return entries


def _text(found: Margins) -> tuple[str, ...]:
    return tuple(f"{value:.1f}" if np.isfinite(value) else "-" for value in found)
