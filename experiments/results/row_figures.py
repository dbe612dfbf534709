"""Figures from the rows of a campaign: comparisons, laps, age of the features, swaps and live bounds."""

from typing import Any

import numpy as np

from experiments.results.campaign_data import OURS, CampaignData
from experiments.results.figure_style import (
    draw_intervals,
    finish,
    legend_below,
    new_figure,
    plain_ticks,
    style,
    upward_axis,
)
from experiments.results.wording import BOUND_UNITS, counted, metric_name


def compare(data: CampaignData, metric: str, controllers: list[str] | None = None) -> Any:
    """Draw the controllers side by side in each case: median, interval, and a faint point for every flight."""
    chosen = controllers or data.controllers
    cases = [case for case in data.cases() if any(group.values(metric) for group in data.select(case))]
    figure = new_figure(4.4, max(6.0, 1.6 + 1.15 * len(cases)))
    panel = figure.add_subplot()
    for index, controller in enumerate(chosen):
        groups = [(place, group) for place, case in enumerate(cases) for group in data.select(case, controller)[:1]]
        shift = (index - (len(chosen) - 1) / 2.0) * 0.8 / max(len(chosen), 1)
        colour = style(controller).colour
        for place, group in groups:
            values = list(group.values(metric).values())
            panel.plot([place + shift] * len(values), values, ".", color=colour, alpha=0.25, markersize=3)
        estimates = [group.estimate(metric) for _, group in groups]
        draw_intervals(panel, [place + shift for place, _ in groups], estimates, controller)
    _split(panel, len(cases))
    panel.set_xticks(range(len(cases)), [_wrap(data.label(case), 60 // len(cases)) for case in cases], fontsize=8)
    upward_axis(panel, [value for case in cases for one in data.select(case) for value in one.values(metric).values()])
    finish(panel, "", metric_name(metric))
    legend_below(figure, [panel])
    return figure


def _split(panel: Any, count: int) -> None:
    for place in range(1, count):
        panel.axvline(place - 0.5, color="0.85", linewidth=0.8, zorder=0)
    panel.set_xlim(-0.5, count - 0.5)


def _wrap(text: str, width: int) -> str:
    width, lines = max(width, 14), [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) > width:
            lines.append(word)
        else:
            lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n".join(lines)


def laps(data: CampaignData, case: str, controllers: list[str] | None = None) -> Any:
    """Draw the position RMSE lap by lap: median and the middle half of the seeds."""
    figure = new_figure(3.8)
    panel = figure.add_subplot()
    for controller in controllers or data.controllers:
        for group in data.select(case, controller):
            rows = [row["lap_rmse_m"] for row in group.survivors if row["lap_rmse_m"]]
            if not rows:
                continue
            shortest = min(len(row) for row in rows)
            values = np.array([row[:shortest] for row in rows])
            number, look = np.arange(1, shortest + 1), style(controller)
            low, middle, high = np.quantile(values, (0.25, 0.5, 0.75), axis=0)
            drawn = {"color": look.colour, "linestyle": look.line, "marker": look.marker, "label": controller}
            panel.plot(number, middle, markersize=4, **drawn)
            panel.fill_between(number, low, high, color=look.colour, alpha=0.12, linewidth=0)
            panel.set_xticks(number)
    panel.set_ylim(bottom=0.0)
    finish(panel, "lap at full speed", "position RMSE [m]", f"{data.label(case)}: median and middle half of the seeds")
    legend_below(figure, [panel])
    return figure


def age(data: CampaignData, controllers: list[str] | None = None) -> Any:
    """Draw each survivor's RMSE against the median age of its features; left of the axis: no version was activated."""
    figure = new_figure(3.8)
    panel = figure.add_subplot()
    markers = "o^sDvP*X<>"
    ageless: list[float] = []
    for controller in controllers or data.controllers:
        for number, case in enumerate(data.cases()):
            rows = [row for group in data.select(case, controller) for row in group.survivors]
            x, y = [row["feature_age_median_s"] for row in rows], [row["settled_rmse_m"] for row in rows]
            label = data.label(case) if len(data.cases()) > 1 else controller
            colour = f"C{number}" if len(data.cases()) > 1 else style(controller).colour
            panel.plot(x, y, markers[number % len(markers)], color=colour, markersize=4, alpha=0.7, label=label)
            ageless += [error for age_s, error in zip(x, y, strict=True) if not np.isfinite(age_s)]
    if ageless:
        end = panel.get_xlim()[1]
        panel.axvline(0.0, color="0.6", linewidth=0.9)
        never = f"no version swapped in ({counted(len(ageless), 'flight')})"
        panel.plot([-0.03 * end] * len(ageless), ageless, "+", color="k", markersize=5, alpha=0.6, label=never)
        panel.set_xticks([tick for tick in panel.get_xticks() if tick >= 0.0])
        panel.set_xlim(-0.06 * end, end)
    panel.set_ylim(bottom=0.0)
    finish(panel, "median age of the features [s]", metric_name("settled_rmse_m"), "survivors, one point a flight")
    legend_below(figure, [panel], columns=4)
    return figure


_SWAPS = (
    ("position", "position_swap_jump_max_m_s2", "m/s²", 3.0),
    ("attitude", "attitude_swap_jump_max_rad_s2", "rad/s²", 40.0),
)
"""Channel, column of the largest jump, its unit, and the limit of the swap."""


def swaps(data: CampaignData) -> Any:
    """Draw the distribution of the largest jump of nu_ad at a swap, over the flights with swaps."""
    figure = new_figure(3.8)
    jumps = figure.add_subplot()
    rows = [row for group in data.select(controller=OURS) for row in group.rows if row["swaps"] > 0]
    for (channel, metric, unit, limit), controller in zip(_SWAPS, (OURS, "mrac"), strict=True):
        look = style(controller)
        values = np.array([row[metric] for row in rows], dtype=float) / limit
        values = np.sort(values[np.isfinite(values)])
        share = np.arange(1, values.size + 1) / max(values.size, 1)
        drawn = {"where": "post", "color": look.colour, "linestyle": look.line}
        jumps.step(np.maximum(values, 1e-4), share, label=f"{channel} (bound {limit:g} {unit})", **drawn)
    jumps.set_xscale("log")
    jumps.axvline(1.0, color="k", linewidth=0.9, linestyle=":")
    finish(jumps, "largest jump at a swap / bound of the swap", "share of the flights")
    legend_below(figure, [jumps])
    return figure


def bounds(data: CampaignData) -> Any:
    """Draw the median live bound of every flight against its median tracking error, a panel for each channel."""
    figure = new_figure(4.0)
    panels = []
    for number, (channel, column_unit, unit, factor) in enumerate(BOUND_UNITS):
        panel = figure.add_subplot(1, 2, number + 1)
        for controller in data.controllers:
            look = style(controller)
            rows = [row for group in data.select(controller=controller) for row in group.rows]
            kinds = (f"{channel}_error_median_{column_unit}", f"{channel}_bound_median_{column_unit}")
            error, bound = (factor * np.array([row[kind] for row in rows], dtype=float) for kind in kinds)
            drawn = {"color": look.colour, "markersize": 4, "alpha": 0.6, "label": controller}
            panel.loglog(error, bound, look.marker, **drawn)
        finish(panel, f"median {channel} error of a flight [{unit}]", f"median live bound [{unit}]")
        low, high = panel.get_xlim()
        panel.plot([low, high], [low, high], color="k", linewidth=0.9, linestyle=":")
        panel.set_xlim(low, high)
        for axis in (panel.xaxis, panel.yaxis):
            plain_ticks(axis, (1.0, 3.0))
        panels.append(panel)
    legend_below(figure, panels, columns=4)
    return figure
