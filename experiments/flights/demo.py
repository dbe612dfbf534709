"""The demonstration: the same wind with two controllers, flown in lockstep, with one picture."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from experiments.flights.lockstep_flight import LockstepOutcome, Observer, fly_lockstep
from experiments.flights.metrics import flight_metrics
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, FlightConfig, resolve
from experiments.flights.trace import FlightTrace
from protocol.conventions import Array

PAIR: Final = ("pid", "dmrac")
DURATION_S: Final = 45.0
WIND: Final = "vehicle.disturbances.0.speed_m_s=6.0"
"""The fan's jet of the default scenario, half again as fast."""
SMOOTHING_S: Final = 0.5
COLOURS: Final = ("#d55e00", "#0072b2")

Watch = Callable[[FlightConfig], Observer]


@dataclass(frozen=True)
class DemoFlight:
    """One of the two flights."""

    config: FlightConfig
    trace: FlightTrace
    crash_reason: str
    first_lap_rmse_m: float
    settled_rmse_m: float
    feature_versions: int

    def line(self) -> str:
        """One line about the flight."""
        name = f"{self.config.controller}:"
        if self.crash_reason:
            return f"{name:<7} VEHICLE LOST after {self.trace.time_s[-1]:.1f} s: {self.crash_reason}"
        learnt = f", {self.feature_versions} feature versions learnt in flight" if self.feature_versions else ""
        return (
            f"{name:<7} first lap {1e3 * self.first_lap_rmse_m:5.1f} mm, "
            f"settled {1e3 * self.settled_rmse_m:5.1f} mm{learnt}"
        )


def demo_configs(seed: int | None, duration_s: float, assignments: tuple[str, ...]) -> tuple[FlightConfig, ...]:
    """The two flights, which differ in the controller only. Raises ConfigError."""
    given = (WIND, *assignments)
    return tuple(resolve(DEFAULT_SCENARIO, Choices(controller, seed, duration_s, given)) for controller in PAIR)


def fly_demo(config: FlightConfig, observers: tuple[Observer, ...] = ()) -> DemoFlight:
    """Fly one of the two."""
    outcome: LockstepOutcome = fly_lockstep(config, observers)
    metrics = flight_metrics(outcome.trace, config.onboard.guidance.trajectory)
    versions = int(outcome.onboard.get("features", {}).get("swaps", 0))
    return DemoFlight(
        config, outcome.trace, outcome.crash_reason, metrics.first_lap_rmse_m, metrics.settled_rmse_m, versions
    )


def summary(flights: tuple[DemoFlight, ...]) -> list[str]:
    """The lines that the command prints about the flights."""
    lines = [flight.line() for flight in flights]
    before, after = (flight.settled_rmse_m for flight in flights)
    if not any(flight.crash_reason for flight in flights) and np.isfinite([before, after]).all() and before > 0.0:
        lines.append(
            f"With dmrac {after / before:.0%} of pid's settled error is left: it learns the wind at each place."
        )
    return lines


def draw_demo(flights: tuple[DemoFlight, ...], path: Path) -> None:
    """Draw the paths from above side by side, and the errors over time below; the file's ending gives the format."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.5, 1.0))
    below = figure.add_subplot(grid[1, :])
    shared: dict[str, Any] = {}
    for column, flight in enumerate(flights):
        above = figure.add_subplot(grid[0, column], **shared)
        shared = {"sharex": above, "sharey": above}
        _draw_path(above, flight, COLOURS[column])
        error_mm = 1e3 * np.where(flight.trace.on_path, _smoothed(flight.trace), np.nan)
        below.plot(flight.trace.time_s, error_mm, color=COLOURS[column], label=flight.config.controller)
    below.set(xlabel="time [s]", ylabel=f"distance to target [mm],\nRMS over {SMOOTHING_S:g} s", ylim=(0.0, None))
    below.legend(frameon=False)
    below.grid(alpha=0.3)
    figure.suptitle(f"{flights[0].config.scenario}, seed {flights[0].config.seed}: the same wind, two controllers")
    figure.savefig(path, dpi=110)


def _draw_path(panel: Any, flight: DemoFlight, colour: str) -> None:
    on_path = flight.trace.on_path
    actual, target = flight.trace.truth.vector("position", "ned"), flight.trace.tick.vector("target", "ned")
    panel.plot(target[on_path, 1], target[on_path, 0], color="0.6", linewidth=3.0, label="target")
    panel.plot(actual[on_path, 1], actual[on_path, 0], color=colour, linewidth=0.8, label="flown")
    panel.set(title=flight.line(), xlabel="east [m]", ylabel="north [m]")
    panel.title.set_fontsize(9)
    panel.set_aspect("equal", adjustable="box")
    panel.legend(frameon=False, fontsize=8, loc="lower right")
    panel.grid(alpha=0.3)


def _smoothed(trace: FlightTrace) -> Array:
    """Distance to the target, m: running root mean square over SMOOTHING_S."""
    square = np.sum(trace.position_error**2, axis=1)
    window = max(round(SMOOTHING_S / float(trace.time_s[1] - trace.time_s[0])), 1)
    mean: Array = np.convolve(square, np.ones(window) / window, mode="same")
    return np.sqrt(mean)
