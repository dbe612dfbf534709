"""Figures from the rows of a campaign: survival curves, sweeps, comparisons, laps, feature age, swaps and bound."""

from typing import Any

import numpy as np

from experiments.results.campaign_data import CampaignData, Group
from experiments.results.figure_style import finish, legend_below, new_figure, style
from experiments.results.statistics import SEPARATION_RIDGE, logistic_fit
from experiments.results.wording import counted, metric_name

LOGARITHMIC_FROM = 8.0
"""Largest over smallest value from which a comparison's axis is logarithmic."""


def _sweep(data: CampaignData, name: str) -> tuple[str, list[Any], bool]:
    sweep = next(sweep for sweep in data.config.sweeps if sweep.name == name)
    values = [value for value, _ in sweep.steps()]
    return sweep.label or name, values, all(isinstance(value, int | float) for value in values)


def _swept(data: CampaignData) -> list[str]:
    """Cases with flights at points of a sweep."""
    return [case for case in data.cases() if any(group.point for group in data.select(case))]


def _flown_once(data: CampaignData, case: str) -> list[Group]:
    """Groups of the cases that are not swept, but flown under the same conditions as this one."""
    return [group for other in data.same_conditions(case) for group in data.select(other) if not group.point]


def _places(values: list[Any], numeric: bool, index: int, count: int) -> list[float]:
    """Where the controllers' points of a sweep stand, moved apart a little."""
    span = min(np.diff(sorted(values)), default=1.0) if numeric else 1.0
    shift = (index - (count - 1) / 2.0) * span * 0.1
    return [(float(value) if numeric else float(place)) + shift for place, value in enumerate(values)]


def _name_ticks(panel: Any, values: list[Any], numeric: bool) -> None:
    if numeric:
        return
    panel.set_xticks(range(len(values)), [str(value).replace("_", " ") for value in values])
    panel.tick_params(axis="x", labelrotation=55 if len(values) > 5 else 0)
    for label in panel.get_xticklabels():
        label.set_horizontalalignment("right" if len(values) > 5 else "center")
        label.set_rotation_mode("anchor" if len(values) > 5 else "default")


def survival(data: CampaignData, sweep: str, controllers: list[str] | None = None) -> Any:
    """Share of survivors against a sweep: counts with Wilson intervals, and the logistic fit through all flights."""
    label, values, numeric = _sweep(data, sweep)
    cases, chosen = _swept(data), controllers or data.controllers
    figure = new_figure(4.4 * len(cases))
    panels = [figure.add_subplot(len(cases), 1, number + 1) for number in range(len(cases))]
    for panel, case in zip(panels, cases, strict=True):
        for index, controller in enumerate(chosen):
            places = dict(zip(values, _places(values, numeric, index, len(chosen)), strict=True))
            groups = [group for group in data.select(case, controller) if group.point]
            _survival_curve(panel, groups, sweep, places, controller, numeric)
        panel.set_ylim(-0.04, 1.04)
        _name_ticks(panel, values, numeric)
        finish(panel, label, "share that survived (95 % Wilson)", data.label(case))
    legend_below(figure, panels)
    return figure


def _survival_curve(
    panel: Any, groups: list[Group], sweep: str, places: dict[Any, float], controller: str, numeric: bool
) -> None:
    if not groups:
        return
    look = style(controller)
    x = [places[dict(group.point)[sweep]] for group in groups]
    shares = [group.survival for group in groups]
    low = [share.value - share.low for share in shares]
    high = [share.high - share.value for share in shares]
    panel.errorbar(
        x,
        [share.value for share in shares],
        [low, high],
        fmt=look.marker,
        color=look.colour,
        markersize=4,
        elinewidth=0.9,
        capsize=2,
        label=controller,
    )
    flights = (
        [(float(dict(group.point)[sweep]), row["survived"]) for group in groups for row in group.rows]
        if numeric
        else []
    )
    if flights and len({alive for _, alive in flights}) == 2:
        fit = logistic_fit([at for at, _ in flights], [alive for _, alive in flights], SEPARATION_RIDGE)
        fine = np.linspace(min(places), max(places), 300)
        panel.plot(fine, fit.probability(fine), color=look.colour, linestyle=look.line, linewidth=1.1)


def sweep_metric(data: CampaignData, sweep: str, metric: str, controllers: list[str] | None = None) -> Any:
    """A metric's median (survivors) with its bootstrap interval against a sweep.

    What was flown once under the same conditions is a broken line.
    """
    label, values, numeric = _sweep(data, sweep)
    cases, chosen = _swept(data), controllers or data.controllers
    figure = new_figure(4.2 * len(cases))
    panels = [figure.add_subplot(len(cases), 1, number + 1) for number in range(len(cases))]
    for panel, case in zip(panels, cases, strict=True):
        shown: list[float] = []
        for index, controller in enumerate(chosen):
            places = dict(zip(values, _places(values, numeric, index, len(chosen)), strict=True))
            groups = [group for group in data.select(case, controller) if group.values(metric)]
            x = [places[dict(group.point)[sweep]] for group in groups]
            shown += _interval_line(panel, x, groups, metric, controller, joined=numeric)
        for group in _flown_once(data, case):
            if group.controller in chosen and group.values(metric):
                shown.append(group.estimate(metric).value)
                look = style(group.controller)
                panel.axhline(shown[-1], color=look.colour, linestyle="--", label=group.controller)
        _upward_axis(panel, shown)
        _name_ticks(panel, values, numeric)
        finish(panel, label, metric_name(metric), f"{data.label(case)}: survivors only")
    legend_below(figure, panels)
    return figure


def _interval_line(
    panel: Any, x: list[float], groups: list[Group], metric: str, controller: str, joined: bool
) -> list[float]:
    """Draws medians with their intervals; returns the medians."""
    look = style(controller)
    estimates = [group.estimate(metric) for group in groups]
    middle = np.array([estimate.value for estimate in estimates])
    low = np.array([estimate.low for estimate in estimates])
    high = np.array([estimate.high for estimate in estimates])
    bars = np.nan_to_num(np.stack([middle - low, high - middle])) if middle.size else None
    panel.errorbar(
        x,
        middle,
        bars,
        marker=look.marker,
        color=look.colour,
        linestyle=look.line if joined else "none",
        linewidth=1.1,
        markersize=4.5,
        elinewidth=0.9,
        capsize=2,
        label=controller,
    )
    return [estimate.value for estimate in estimates]


def compare(data: CampaignData, metric: str, controllers: list[str] | None = None) -> Any:
    """Controllers side by side in each case: median, interval, and every flight as a faint point."""
    chosen = controllers or data.controllers
    cases = [case for case in data.cases() if any(group.values(metric) for group in data.select(case))]
    figure = new_figure(4.4, max(6.0, 1.6 + 1.15 * len(cases)))
    panel = figure.add_subplot()
    for index, controller in enumerate(chosen):
        groups = [(place, group) for place, case in enumerate(cases) for group in data.select(case, controller)[:1]]
        shift = (index - (len(chosen) - 1) / 2.0) * 0.8 / max(len(chosen), 1)
        for place, group in groups:
            values = list(group.values(metric).values())
            panel.plot(
                [place + shift] * len(values), values, ".", color=style(controller).colour, alpha=0.25, markersize=3
            )
        _interval_line(
            panel, [place + shift for place, _ in groups], [group for _, group in groups], metric, controller, False
        )
    _split(panel, len(cases))
    panel.set_xticks(range(len(cases)), [_wrap(data.label(case), 60 // len(cases)) for case in cases], fontsize=8)
    shown = [value for case in cases for group in data.select(case) for value in group.values(metric).values()]
    _upward_axis(panel, [value for value in shown if np.isfinite(value)])
    finish(panel, "", metric_name(metric))
    legend_below(figure, [panel])
    return figure


def _upward_axis(panel: Any, values: list[float]) -> None:
    """From zero; logarithmic where the values lie so far apart that small ones could not be told from each other."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    if not values or min(values) <= 0.0 or max(values) < LOGARITHMIC_FROM * min(values):
        panel.set_ylim(bottom=0.0)
        return
    panel.set_yscale("log")
    panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panel.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    panel.yaxis.set_minor_formatter(NullFormatter())


def compare_cases(data: CampaignData, metric: str, controllers: list[str] | None = None) -> Any:
    """As `compare`, for campaigns whose cases are what is compared."""
    return compare(data, metric, controllers)


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
    """Position RMSE lap by lap: median and the middle half of the seeds."""
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
            panel.plot(
                number,
                middle,
                color=look.colour,
                linestyle=look.line,
                marker=look.marker,
                markersize=4,
                label=controller,
            )
            panel.fill_between(number, low, high, color=look.colour, alpha=0.12, linewidth=0)
            panel.set_xticks(number)
    panel.set_ylim(bottom=0.0)
    finish(panel, "lap at full speed", "position RMSE [m]", f"{data.label(case)}: median and middle half of the seeds")
    legend_below(figure, [panel])
    return figure


def age(data: CampaignData, controllers: list[str] | None = None) -> Any:
    """RMSE of each flight against the median age of its features; left of the axis those that never had a version."""
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


def swaps(data: CampaignData) -> Any:
    """How large the jumps of nu_ad at swaps were, and how far the live bound stands above the error it bounds."""
    figure = new_figure(3.8)
    panels = [figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)]
    rows = [row for group in data.select(controller="dmrac") for row in group.rows if row["swaps"] > 0]
    units = {
        "position": ("position_swap_jump_max_m_s2", "m/s²", 3.0),
        "attitude": ("attitude_swap_jump_max_rad_s2", "rad/s²", 40.0),
    }
    for place, (channel, (metric, unit, limit)) in enumerate(units.items()):
        values = np.array([row[metric] for row in rows], dtype=float) / limit
        values = np.sort(values[np.isfinite(values)])
        look = style(("dmrac", "mrac")[place])
        panels[0].step(
            np.maximum(values, 1e-4),
            np.arange(1, values.size + 1) / max(values.size, 1),
            where="post",
            color=look.colour,
            linestyle=look.line,
            label=f"{channel} (bound {limit:g} {unit})",
        )
        error = np.array([row[f"{channel}_error_norm_median"] for row in rows], dtype=float)
        bound = np.array([row[f"{channel}_bound_median"] for row in rows], dtype=float)
        panels[1].loglog(
            error, bound, look.marker, color=look.colour, markersize=4, alpha=0.6, label=f"{channel}, a flight"
        )
    panels[0].set_xscale("log")
    panels[0].axvline(1.0, color="k", linewidth=0.9, linestyle=":")
    finish(panels[0], "largest jump at a swap / bound of the swap", "share of the flights")
    finish(panels[1], "median norm(e) of a flight [m, m/s; rad, rad/s]", "median live bound on norm(e)")
    low, high = panels[1].get_xlim()
    panels[1].plot([low, high], [low, high], color="k", linewidth=0.9, linestyle=":")
    panels[1].set_xlim(low, high)
    _plain_decades(panels[1])
    legend_below(figure, panels)
    return figure


def _plain_decades(panel: Any) -> None:
    """Both axes logarithmic, with so few numbers that none runs into the next."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())
