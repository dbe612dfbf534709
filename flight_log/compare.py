"""Compares several flights: a table of their summaries and a figure, in one self-contained HTML page."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from flight_log.html import code, image, page, paragraph, section, table, values_table
from flight_log.reader import Flight, FlightError, Table
from flight_log.report import repeat_command, summary_rows, title_of

Array = NDArray[np.float64]

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#e69f00", "#56b4e9", "#f0e442")
STYLES: Final = ("-", "--", "-.", ":")
SMOOTHING_S: Final = 0.5
LEGEND_ROW_INCH: Final = 0.25


def write_comparison(flights: Sequence[Flight], path: Path) -> None:
    """Write the comparison as an HTML page.

    Raises
    ------
    FlightError
        If fewer than two flights are given, or none contains onboard/tick.
    OSError
        If the page cannot be written.
    """
    if len(flights) < 2:
        raise FlightError("give two flights or more to compare")
    path.write_text(build_comparison(flights), encoding="utf-8")


def build_comparison(flights: Sequence[Flight]) -> str:
    """The comparison as HTML."""
    names = labels(flights)
    return page(
        f"{len(flights)} flights compared",
        [
            section("Flights", table([[n, str(f.path)] for n, f in zip(names, flights, strict=True)])),
            section("Figure", image(draw(flights, names), "comparison")),
            section("Summaries", values_table(summary_table(flights), ("", *names)), _without_summary(flights, names)),
            section("Repeat", code("\n".join(repeat_command(flight) for flight in flights if flight.summary))),
        ],
    )


def labels(flights: Sequence[Flight]) -> list[str]:
    """A short, unique name for each flight."""
    names = [title_of(flight) for flight in flights]
    return [name if names.count(name) == 1 else f"{name} ({i + 1})" for i, name in enumerate(names)]


def summary_table(flights: Sequence[Flight]) -> list[list[str]]:
    """Rows of the entry's name and its value in each flight's summary, "-" where there is none."""
    summaries = [{row[0]: row[1] for row in summary_rows(flight.summary)} for flight in flights]
    keys = dict.fromkeys(key for summary in summaries for key in summary)
    return [[key, *(summary.get(key, "-") for summary in summaries)] for key in keys]


def draw(flights: Sequence[Flight], names: Sequence[str]) -> bytes:
    """The figure as PNG: path from above, distance to the target, adaptive signal, age of features.

    Raises FlightError if no flight contains onboard/tick.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    ticks = [flight.get("onboard/tick") for flight in flights]
    if all(tick is None for tick in ticks):
        raise FlightError("none of the flights contains onboard/tick: nothing to draw")
    figure = Figure(figsize=(13, 8 + LEGEND_ROW_INCH * len(flights)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(4, 2, width_ratios=(1.7, 1.0))
    above = figure.add_subplot(grid[:, 1])
    panels = [figure.add_subplot(grid[0, 0])]
    panels += [figure.add_subplot(grid[row, 0], sharex=panels[0]) for row in (1, 2, 3)]
    for i, (flight, tick) in enumerate(zip(flights, ticks, strict=True)):
        if tick is None:
            continue
        style: dict[str, Any] = {
            "color": COLOURS[i % len(COLOURS)],
            "linestyle": STYLES[i % len(STYLES)],
            "linewidth": 1.0,
        }
        _draw_flight(panels, above, flight, tick, names[i], style)
    for panel, label in zip(
        panels, ("distance to\ntarget [m]", "tilt [deg]", "norm(nu_ad)\n[m/s²]", "feature age [s]"), strict=True
    ):
        panel.set_ylabel(label)
        panel.set_ylim(bottom=0.0)
        panel.grid(alpha=0.3)
    panels[-1].set_xlabel("time since the start of the path [s]")
    above.set(xlabel="east [m]", ylabel="north [m]", title="path from above, target grey")
    above.set_aspect("equal", adjustable="datalim")
    above.grid(alpha=0.3)
    figure.legend(*above.get_legend_handles_labels(), loc="outside lower left")
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    return buffer.getvalue()


def _draw_flight(panels: Sequence[Any], above: Any, flight: Flight, tick: Table, name: str, style: Any) -> None:
    time_s = path_seconds(tick)
    position = true_position(flight, tick)
    target = tick.vector("target_n", "target_e", "target_d")
    on_path = (time_s >= 0.0) & (time_s <= path_end_s(tick, time_s))
    error = np.linalg.norm(position - target, axis=1)
    adaptive = np.linalg.norm(tick.vector("position_adaptive_n", "position_adaptive_e", "position_adaptive_d"), axis=1)
    tilt = np.degrees(np.hypot(tick["euler_x"], tick["euler_y"]))
    age = np.where(tick["feature_age"] < 0.0, np.nan, tick["feature_age"])
    for panel, values in zip(panels, (smoothed(error, time_s), tilt, adaptive, age), strict=True):
        panel.plot(time_s[on_path], values[on_path], label=name, **style)
    above.plot(target[on_path, 1], target[on_path, 0], color="0.75", linewidth=2.5, zorder=0)
    above.plot(position[on_path, 1], position[on_path, 0], label=name, **style)


def path_seconds(tick: Table) -> Array:
    """[n], s since the start of the path; since the first record if it never started."""
    started = np.flatnonzero(tick["path_time"] > 0.0)
    return tick.seconds(int(tick.time_ns[started[0] if started.size else 0]))


def path_end_s(tick: Table, time_s: Array) -> float:
    """Time, s, at which the vehicle left the path to land; of the last record if it did not."""
    advanced = np.flatnonzero(np.diff(tick["path_time"]) > 0.0)
    return float(time_s[advanced[-1] + 1 if advanced.size else -1])


def true_position(flight: Flight, tick: Table) -> Array:
    """[n, 3] m, world NED, at the times of the ticks: the simulator's truth if it was logged, else the estimate."""
    truth = flight.get("sim_vehicle/truth")
    if truth is None:
        return tick.vector("position_n", "position_e", "position_d")
    at, times = tick.seconds(flight.start_ns), truth.seconds(flight.start_ns)
    return np.column_stack([np.interp(at, times, truth[f"position_{axis}"]) for axis in "ned"])


def smoothed(values: Array, time_s: Array) -> Array:
    """Running root mean square over SMOOTHING_S."""
    period_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else SMOOTHING_S
    window = max(int(SMOOTHING_S / max(period_s, 1e-6)), 1)
    kernel = np.ones(window) / window
    weight = np.convolve(np.ones(len(values)), kernel, mode="same")
    rms: Array = np.sqrt(np.convolve(values**2, kernel, mode="same")[: len(values)] / weight[: len(values)])
    return rms


def _without_summary(flights: Sequence[Flight], names: Sequence[str]) -> str:
    missing = [name for name, flight in zip(names, flights, strict=True) if not flight.summary]
    return paragraph(f"without a flight summary: {', '.join(missing)}" if missing else "", "bad")
