"""The figure of one flight: path, position and target, attitude, nu_ad and the true disturbance, link."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from experiments.flights.trace import FlightTrace
from protocol.conventions import Array
from protocol.geometry import roll_pitch_yaw

AXES = ("north", "east", "down")
STYLES = ("-", "--", ":")
WIND_SCALE = 12.0
"""Wind speed, m/s, whose arrow is 1 m long."""
COLOURS = ("#0072b2", "#d55e00", "#009e73")


def draw_flight(trace: FlightTrace, title: str, path: Path, lost_s: Mapping[str, Array] | None = None) -> None:
    """Write the figure; the file's ending gives the format. lost_s: as for `flight_figure`."""
    flight_figure(trace, title, lost_s).savefig(path, dpi=110)


def flight_figure(trace: FlightTrace, title: str, lost_s: Mapping[str, Array] | None = None) -> Any:
    """Return the figure, a matplotlib.figure.Figure.

    lost_s: times of the lost datagrams, by direction, on the trace's clock.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 11), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(5, 3, width_ratios=(1.0, 1.0, 1.15))
    _draw_path(figure.add_subplot(grid[0:3, 2]), trace)
    _draw_weights(figure.add_subplot(grid[3, 2]), trace)
    link = figure.add_subplot(grid[4, 2])
    _draw_link(link, trace)
    _mark_losses(link, lost_s or {})
    panels = [figure.add_subplot(grid[row, 0:2]) for row in range(5)]
    _draw_position(panels[0], trace)
    _draw_error(panels[1], trace)
    _draw_attitude(panels[2], trace)
    _draw_adaptive(panels[3], trace, 0, "position channel [m/s²]")
    _draw_adaptive(panels[4], trace, 1, "attitude channel [rad/s²]")
    for panel in panels:
        panel.set_xlim(0.0, trace.time_s[-1])
        panel.grid(alpha=0.3)
        _mark_swaps(panel, trace)
    panels[-1].set_xlabel("time [s]")
    figure.suptitle(title)
    return figure


def _swap_times(trace: FlightTrace) -> Array:
    version = trace.tick["feature_version"]
    times: Array = trace.time_s[1:][np.diff(version) != 0]
    return times


def _mark_swaps(panel: Any, trace: FlightTrace) -> None:
    for time_s in _swap_times(trace):
        panel.axvline(time_s, color="0.75", linewidth=0.6, zorder=0)


def _draw_position(panel: Any, trace: FlightTrace) -> None:
    actual, target = trace.truth.vector("position", "ned"), trace.tick.vector("target", "ned")
    for axis, name in enumerate(AXES):
        panel.plot(trace.time_s, target[:, axis], color="0.6", linewidth=2.2)
        _axis_line(panel, trace, actual, axis, name, 1.0)
    panel.set_ylabel("position [m]")
    _legend_above(panel, "target grey; grey lines: swaps")


def _axis_line(panel: Any, trace: FlightTrace, values: Array, axis: int, name: str, width: float) -> None:
    """Draw one column of values in the colour and line of its axis."""
    look = {"color": COLOURS[axis], "linestyle": STYLES[axis], "linewidth": width}
    panel.plot(trace.time_s, values[:, axis], label=name, **look)


def _legend_above(panel: Any, note: str) -> None:
    """Put the legend above the panel, where it covers nothing, with a note at its right end."""
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    panel.legend(ncols=3, fontsize=8, frameon=False, columnspacing=1.2, handlelength=1.6, **place)
    panel.set_title(note, fontsize=8, loc="right", pad=4)


def _draw_error(panel: Any, trace: FlightTrace) -> None:
    distance = np.linalg.norm(trace.position_error, axis=1)
    distance[~trace.on_path] = np.nan
    panel.plot(trace.time_s, distance, color="k", linewidth=0.8)
    panel.set_ylabel("distance to\ntarget [m]")
    panel.set_ylim(bottom=0.0)


def _draw_attitude(panel: Any, trace: FlightTrace) -> None:
    commanded = np.degrees(roll_pitch_yaw(trace.tick.vector("commanded_quaternion", "wxyz")))
    actual = np.degrees(roll_pitch_yaw(trace.truth.vector("quaternion", "wxyz")))
    for axis, name in enumerate(("roll", "pitch")):
        panel.plot(trace.time_s, commanded[:, axis], color="0.6", linewidth=1.6)
        _axis_line(panel, trace, actual, axis, name, 0.8)
    panel.set_ylabel("attitude [deg]")
    _legend_above(panel, "commanded grey")


def _draw_adaptive(panel: Any, trace: FlightTrace, channel: int, label: str) -> None:
    name, axes = (("position", "ned"), ("attitude", "xyz"))[channel]
    adaptive = trace.tick.vector(f"{name}_adaptive_now", axes)
    true = _smoothed(trace.true_delta[:, 3 * channel : 3 * channel + 3], 20)
    airborne = (trace.truth["airborne"] > 0.5) & (trace.truth["position_d"] < -0.15)
    true[~airborne] = np.nan
    for axis in range(2 if channel else 3):
        panel.plot(trace.time_s, true[:, axis], color="0.65", linewidth=1.6)
        _axis_line(panel, trace, adaptive, axis, axes[axis], 0.8)
    inside = np.abs(np.concatenate([true[airborne], adaptive[airborne]]))
    if inside.size:
        limit = max(float(np.nanpercentile(inside, 99.7)) * 1.2, 0.5)
        panel.set_ylim(-limit, limit)
    panel.set_ylabel(f"nu_ad,\n{label}")
    _legend_above(panel, "true disturbance grey")


def _smoothed(values: Array, window: int) -> Array:
    kernel = np.ones(window) / window
    return np.stack([np.convolve(column, kernel, mode="same") for column in values.T], axis=1)


def _draw_path(panel: Any, trace: FlightTrace) -> None:
    on_path = trace.on_path
    actual, target = trace.truth.vector("position", "ned"), trace.tick.vector("target", "ned")
    panel.plot(target[on_path, 1], target[on_path, 0], color="0.6", linewidth=2.5, label="target")
    panel.plot(actual[on_path, 1], actual[on_path, 0], color=COLOURS[0], linewidth=0.7, label="flown")
    wind = trace.truth.vector("wind", "ned")
    step = max(on_path.sum() // 60, 1)
    rows = np.flatnonzero(on_path)[::step]
    if rows.size and np.abs(wind[rows]).max() > 0.05:
        arrows = (actual[rows, 1], actual[rows, 0], wind[rows, 1], wind[rows, 0])
        scale: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": WIND_SCALE, "width": 0.003}
        panel.quiver(*arrows, color=COLOURS[1], label=f"wind (1 m: {WIND_SCALE:g} m/s)", **scale)
        tips = actual[rows, :2] + wind[rows, :2] / WIND_SCALE
        panel.update_datalim(tips[:, ::-1])  # the tips of the arrows, too
        panel.autoscale_view()
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel("east [m]")
    panel.set_ylabel("north [m]")
    _legend_above(panel, "")
    panel.grid(alpha=0.3)


def _draw_weights(panel: Any, trace: FlightTrace) -> None:
    panel.plot(trace.time_s, trace.tick["position_weight_norm"], color=COLOURS[0], linewidth=0.9, label="position")
    panel.set_ylabel("norm(W) [m/s²]", color=COLOURS[0])
    other = panel.twinx()
    norm = trace.tick["attitude_weight_norm"]
    other.plot(trace.time_s, norm, color=COLOURS[1], linestyle="--", linewidth=0.9, label="attitude")
    other.set_ylabel("norm(W) [rad/s²], dashed", color=COLOURS[1])
    panel.set_xlim(0.0, trace.time_s[-1])
    panel.grid(alpha=0.3)


def _worst_per_window(time_s: Array, values: Array, window_s: float) -> tuple[Array, Array]:
    """Return the middle of each window and its largest value; NaN if there is none (values below 0 mean never)."""
    window = (time_s / window_s).astype(np.int64)
    worst = np.full(int(window[-1]) + 1, -1.0)
    np.maximum.at(worst, window, values)
    worst[worst < 0.0] = np.nan
    seconds: Array = (np.arange(worst.size, dtype=np.float64) + 0.5) * window_s
    return seconds, worst


def _mark_losses(panel: Any, lost_s: Mapping[str, Array]) -> None:
    """Draw a stroke for each lost datagram at the panel's upper edge, in one row per direction."""
    for row, times_s in enumerate(lost_s.values()):
        height = np.full(times_s.size, 0.95 - 0.07 * row)
        across = panel.get_xaxis_transform()
        panel.plot(times_s, height, "|", color="0.35", markersize=5, markeredgewidth=0.6, transform=across)
    if lost_s:
        rows = ", then ".join(f"{direction} ({times_s.size})" for direction, times_s in lost_s.items())
        panel.set_title(f"strokes: lost datagrams, {rows}", fontsize=7, loc="left")


def _draw_link(panel: Any, trace: FlightTrace) -> None:
    age = np.where(trace.tick["feature_age"] < 0.0, np.nan, trace.tick["feature_age"])
    panel.plot(trace.time_s, age, color=COLOURS[0], linewidth=1.0)
    panel.set_ylabel("age of features [s]", color=COLOURS[0])
    highest = float(np.nanmax(age)) if np.isfinite(age).any() else 1.0
    panel.set_ylim(0.0, max(1.25 * highest, 0.1))  # leaves room for the strokes
    other = panel.twinx()
    seconds, worst = _worst_per_window(trace.time_s, trace.tick["pose_age"], 0.25)
    other.semilogy(seconds, np.clip(worst, 1e-3, None), color=COLOURS[1], linewidth=0.8, linestyle="--")
    other.set_ylabel("age of pose [s], dashed", color=COLOURS[1])
    panel.set_xlim(0.0, trace.time_s[-1])
    panel.set_xlabel("time [s]")
    panel.grid(alpha=0.3)
