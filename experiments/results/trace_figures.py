"""Figures from traces, in the paper's form: means with variance bands over the seeds, and marked faults."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from experiments.results.campaign_data import CampaignData, Group, Trace
from experiments.results.figure_style import finish, legend_below, new_figure, style
from protocol.conventions import Array
from protocol.geometry import roll_pitch_yaw

FLOWN = "flown: mean, ± standard deviation"
FLOWN_ONCE = "flown"
FLYING_MODES = (4.0, 5.0)


class Column(NamedTuple):
    """The panels of one controller."""

    group: Group
    traces: list[Trace]
    panels: list[Any]
    colour: str


def _groups(
    data: CampaignData, case: str, controllers: Sequence[str] | None, point: dict[str, Any] | None
) -> list[Group]:
    chosen = controllers or data.controllers
    return [group for name in chosen for group in data.select(case, name, point) if data.traces(group)]


def _band(panel: Any, traces: list[Trace], columns: list[Array], colour: str, line: Any, label: str) -> None:
    """Draw mean and standard deviation over the flights that are still in the air."""
    longest = max((trace.time_s for trace in traces), key=len)
    stacked = np.full((len(traces), longest.size), np.nan)
    for row, column in enumerate(columns):
        stacked[row, : column.size] = column
    alive = np.isfinite(stacked).any(axis=0)
    time, stacked = longest[alive], stacked[:, alive]
    mean = np.nanmean(stacked, axis=0)
    flying = np.isfinite(stacked).sum(axis=0)
    spread = np.sqrt(np.nansum((stacked - mean) ** 2, axis=0) / np.maximum(flying - 1, 1))
    panel.plot(time, mean, color=colour, linestyle=line, linewidth=1.1, label=label)
    panel.fill_between(time, mean - spread, mean + spread, color=colour, alpha=0.18, linewidth=0)


def _mark(panel: Any, traces: list[Trace]) -> None:
    """Mark the onsets of the fault, and the times of crashes."""
    onsets = [float(onset) for trace in traces for onset in trace["onsets_s"]]
    if len(traces) == 1:
        for onset in onsets:
            panel.axvline(onset, color="0.6", linewidth=1.6, zorder=0)
    elif onsets:
        panel.axvspan(min(onsets), max(max(onsets), min(onsets) + 0.05), color="0.8", zorder=0, linewidth=0)
    for trace in traces:
        if not trace.row["survived"]:
            panel.axvline(float(trace.time_s[-1]), color="k", linestyle=":", linewidth=0.9)


def _columns(data: CampaignData, rows: int, height_in: float, groups: list[Group]) -> tuple[Any, list[Column]]:
    """Return a figure with a column of panels for each group; the panels of a row share their vertical axis.

    A column has the traces of all seeds if they fly the same path, otherwise those of the first seed.
    """
    figure = new_figure(height_in, 2.2 + 2.9 * len(groups))
    columns: list[Column] = []
    for place, group in enumerate(groups):
        panels = []
        for row in range(rows):
            shared = {"sharey": columns[0].panels[row]} if columns else {}
            panels.append(figure.add_subplot(rows, len(groups), row * len(groups) + place + 1, **shared))
            if columns:
                panels[-1].tick_params(labelleft=False)
        traces = data.traces(group)
        shown = traces if data.one_path(group.case) else traces[:1]
        columns.append(Column(group, shown, panels, style(group.controller).colour))
    return figure, columns


def _finish_columns(columns: list[Column], names: Sequence[str], titles: Sequence[str]) -> None:
    """Label the rows at the first column, the time below the last row, and the columns above the first row."""
    for column, title in zip(columns, titles, strict=True):
        for panel, name in zip(column.panels, names, strict=True):
            time = "time [s]" if panel is column.panels[-1] else ""
            finish(panel, time, name if column is columns[0] else "", title if panel is column.panels[0] else "")


def _titles(columns: list[Column]) -> list[str]:
    lost = [sum(not trace.row["survived"] for trace in one.traces) for one in columns]
    counts = [f"{_which(one.traces)}{f', {n} lost' if n else ''}" for one, n in zip(columns, lost, strict=True)]
    return [f"{one.group.controller} ({count})" for one, count in zip(columns, counts, strict=True)]


def _which(traces: list[Trace]) -> str:
    return f"{len(traces)} flights" if len(traces) > 1 else f"seed {traces[0].row['seed']}"


def _flown(traces: list[Trace]) -> str:
    """Legend of what was flown."""
    return FLOWN if len(traces) > 1 else FLOWN_ONCE


def _distance(trace: Trace) -> Array:
    """Distance to the target, m; NaN where the vehicle does not follow one."""
    error: Array = np.linalg.norm(trace.vector("truth_position", "ned") - trace.vector("tick_target", "ned"), axis=1)
    return np.where(np.isin(trace["tick_mode"], FLYING_MODES), error, np.nan)


def _most(columns: list[Array]) -> float:
    """Upper end of an axis that shows all but the largest hundredth of the values, such as those before a crash."""
    values = np.concatenate(columns)
    values = values[np.isfinite(values)]
    return 1.25 * float(np.quantile(values, 0.99)) if values.size else 1.0


def _within(columns: list[Column], limit: float, rows: int | None = None) -> None:
    """Limit the vertical axes (of the first `rows`) to +-limit, which crashed vehicles exceed. Call it last."""
    for panel in columns[0].panels[:rows]:
        low, high = panel.get_ylim()
        panel.set_ylim(max(low, -limit), min(high, limit))


def position(
    data: CampaignData, case: str, controllers: Sequence[str] | None = None, point: dict[str, Any] | None = None
) -> Any:
    """Draw north, east and height against time: target, mean and standard deviation over the seeds; below, the error.

    The axes of a position span metres, so millimetres of error only show in the panel of their own.
    """
    figure, columns = _columns(data, 4, 8.0, _groups(data, case, controllers, point))
    for _, traces, panels, colour in columns:
        longest = max(traces, key=lambda trace: trace.time_s.size)
        label = _flown(traces)
        for panel, axis, sign in zip(panels[:3], "ned", (1.0, 1.0, -1.0), strict=True):
            target = sign * longest[f"tick_target_{axis}"]
            panel.plot(longest.time_s, target, color="0.45", linewidth=1.0, linestyle="--", label="target")
            _band(panel, traces, [sign * trace[f"truth_position_{axis}"] for trace in traces], colour, "-", label)
            _mark(panel, traces)
        _band(panels[3], traces, [1e3 * _distance(trace) for trace in traces], colour, "-", label)
        _mark(panels[3], traces)
    _finish_columns(columns, ("north [m]", "east [m]", "height [m]", "distance to\ntarget [mm]"), _titles(columns))
    _within(columns, 2.6, rows=3)
    errors = [1e3 * _distance(trace) for one in columns for trace in one.traces]
    columns[0].panels[3].set_ylim(0.0, _most(errors))
    legend_below(figure, columns[0].panels[:1], neutral=_flown(columns[0].traces))
    return figure


def attitude(
    data: CampaignData, case: str, controllers: Sequence[str] | None = None, point: dict[str, Any] | None = None
) -> Any:
    """Draw roll and pitch against time: commanded and flown, mean and standard deviation."""
    figure, columns = _columns(data, 2, 4.6, _groups(data, case, controllers, point))
    for _, traces, panels, colour in columns:
        for angle, panel in enumerate(panels):
            commanded, flown = (
                [np.degrees(roll_pitch_yaw(trace.vector(f"tick_{name}", "wxyz"))[:, angle]) for trace in traces]
                for name in ("commanded_quaternion", "quaternion")
            )
            _band(panel, traces, commanded, "0.45", "--", "commanded")
            _band(panel, traces, flown, colour, "-", _flown(traces))
            _mark(panel, traces)
    _finish_columns(columns, ("roll [deg]", "pitch [deg]"), _titles(columns))
    _within(columns, 45.0)
    legend_below(figure, columns[0].panels[:1], neutral=_flown(columns[0].traces))
    return figure


def torques(
    data: CampaignData, case: str, controllers: Sequence[str] | None = None, point: dict[str, Any] | None = None
) -> Any:
    """Draw the commands of one flight: feedback, feed-forward and adaptive part, for roll, pitch and east."""
    figure, columns = _columns(data, 3, 6.4, _groups(data, case, controllers, point))
    for _, (trace, *_), panels, _ in columns:
        on_path = np.isin(trace["tick_mode"], FLYING_MODES)
        for panel, (channel, axis) in zip(
            panels, (("attitude", "x"), ("attitude", "y"), ("position", "e")), strict=True
        ):
            parts = _parts(trace, channel, axis)
            for (label, values), (colour, line) in zip(parts.items(), _PART_STYLES, strict=True):
                smooth = np.where(on_path, _smooth(np.where(on_path, values, 0.0)), np.nan)
                panel.plot(trace.time_s, smooth, color=colour, linestyle=line, linewidth=0.9, label=label)
            _mark(panel, [trace])
            _limit(panel, [values[on_path] for values in parts.values()])
    titles = [f"{one.group.controller}, seed {one.traces[0].row['seed']}" for one in columns]
    _finish_columns(columns, ("roll [rad/s²]", "pitch [rad/s²]", "east [m/s²]"), titles)
    legend_below(figure, [columns[0].panels[2]])
    return figure


_PARTS_OF = (("attitude", "x"), ("attitude", "y"), ("position", "e"))
_PART_STYLES = (("#0072b2", "-"), ("0.35", ":"), ("#d55e00", "--"))


def _parts(trace: Trace, channel: str, axis: str) -> dict[str, Array]:
    """Split a command u = feedback + feed-forward - nu_ad; the attitude channel has no feed-forward."""
    demand, nu = trace[f"tick_{channel}_demand_{axis}"], trace[f"tick_{channel}_adaptive_{axis}"]
    forward = trace[f"tick_feed_forward_{axis}"] if channel == "position" else np.zeros_like(demand)
    return {"feedback": demand - forward + nu, "feed-forward": forward, "adaptive (-nu_ad)": -nu}


def _smooth(values: Array, window: int = 9) -> Array:
    smoothed: Array = np.convolve(values, np.ones(window) / window, mode="same")
    return smoothed


def _limit(panel: Any, parts: list[Array]) -> None:
    values = np.abs(np.concatenate(parts))
    if values.size:
        most = max(
            float(np.quantile(values, 0.985)) * 1.3, panel.get_ylim()[1] if panel.get_shared_y_axes() else 0.1, 0.1
        )
        most = min(most, float(np.quantile(values, 0.985)) * 2.5 + 0.1)
        panel.set_ylim(-most, most)


def path(
    data: CampaignData, case: str, controllers: Sequence[str] | None = None, point: dict[str, Any] | None = None
) -> Any:
    """Draw the path in three dimensions: target and one flight of each controller."""
    groups = _groups(data, case, controllers, point)
    figure = new_figure(3.9, 3.4 * len(groups))
    panels = []
    for column, group in enumerate(groups):
        trace = data.traces(group)[0]
        on_path = np.isin(trace["tick_mode"], FLYING_MODES)
        panel = figure.add_subplot(1, len(groups), column + 1, projection="3d")
        target, flown = trace.vector("tick_target", "ned")[on_path], trace.vector("truth_position", "ned")[on_path]
        panel.plot(
            target[:, 1], target[:, 0], -target[:, 2], color="0.5", linestyle="--", linewidth=1.2, label="target"
        )
        panel.plot(
            flown[:, 1], flown[:, 0], -flown[:, 2], color=style(group.controller).colour, linewidth=0.6, label="flown"
        )
        panel.set_xlabel("east [m]")
        panel.set_ylabel("north [m]")
        panel.set_zlabel("height [m]")
        panel.set_zlim(0.6, 1.4)
        for axis, values in ((panel.xaxis, flown[:, 1]), (panel.yaxis, flown[:, 0])):
            most = np.ceil(2.0 * np.abs(values).max()) / 2.0
            axis.set_ticks([-most, 0.0] if axis is panel.xaxis else [0.0, most])  # their ends meet in one corner
        panel.zaxis.set_ticks([0.6, 1.0, 1.4])
        panel.tick_params(labelsize=8, pad=1)
        panel.set_box_aspect((1.0, 1.6, 0.8), zoom=0.82)
        panel.set_title(f"{group.controller}, seed {trace.row['seed']}", fontsize=10, y=0.98)
        panels.append(panel)
    legend_below(figure, panels[:1], neutral="flown")
    return figure


def training(data: CampaignData, case: str, controllers: Sequence[str] | None = None) -> Any:
    """Draw training, validation and test loss of both channels over one flight."""
    groups = [group for group in _groups(data, case, controllers, None) if data.traces(group)[0]["epochs"].size]
    figure = new_figure(3.8)
    panels = [figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)]
    trace = data.traces(groups[0])[0]
    time, epochs = trace["epoch_time_s"], trace["epochs"]
    looks = (("training", "#0072b2", "-"), ("validation", "#d55e00", "--"), ("test", "#009e73", ":"))
    for channel, (panel, unit) in enumerate(zip(panels, ("(m/s²)²", "(rad/s²)²"), strict=True)):
        for kind, (label, colour, line) in enumerate(looks):
            panel.plot(
                time, epochs[:, 2 + 2 * kind + channel], color=colour, linestyle=line, linewidth=1.0, label=label
            )
        panel.set_yscale("log")
        _mark(panel, [trace])
        finish(
            panel, "flight time [s]", f"mean squared error [{unit}]", ("position channel", "attitude channel")[channel]
        )
    legend_below(figure, panels)
    return figure


def position_cases(data: CampaignData, cases: Sequence[str], controllers: Sequence[str] | None = None) -> Any:
    """Draw the distance to the target against time for several cases: mean and standard deviation."""
    figure = new_figure(3.8)
    panel = figure.add_subplot()
    looks = (("#0072b2", "-"), ("#d55e00", "--"), ("#009e73", ":"), ("0.3", "-."))
    for (colour, line), case in zip(looks, cases, strict=False):
        for group in _groups(data, case, controllers, None):
            traces = data.traces(group)
            _band(panel, traces, [_distance(trace) for trace in traces], colour, line, data.label(case))
    panel.set_ylim(bottom=0.0)
    finish(panel, "flight time [s]", "distance to the target [m]", "mean and standard deviation over the seeds")
    legend_below(figure, [panel])
    return figure
