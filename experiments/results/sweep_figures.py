"""Figures of a sweep, from a campaign's rows: survival, and a metric, against the swept value."""

from typing import Any

import numpy as np

from experiments.results.campaign_data import CampaignData, Group
from experiments.results.figure_style import (
    cut_outliers,
    draw_intervals,
    finish,
    legend_below,
    new_figure,
    style,
    upward_axis,
)
from experiments.results.statistics import SEPARATION_RIDGE, logistic_fit
from experiments.results.wording import metric_name


class _Axis:
    """The swept values along the horizontal axis; each controller's points are moved aside a little."""

    def __init__(self, data: CampaignData, name: str, controllers: list[str]) -> None:
        sweep = next(sweep for sweep in data.config.sweeps if sweep.name == name)
        self.name, self.label = name, sweep.label or name
        self.values = [value for value, _ in sweep.steps()]
        self.numeric = all(isinstance(value, int | float) for value in self.values)
        self.controllers = controllers

    def places(self, groups: list[Group]) -> list[float]:
        """Return where the points of one controller's groups are drawn."""
        span = min(np.diff(sorted(self.values)), default=1.0) if self.numeric else 1.0
        count = len(self.controllers)
        found = []
        for group in groups:
            value = dict(group.point)[self.name]
            place = float(value) if self.numeric else float(self.values.index(value))
            found.append(place + (self.controllers.index(group.controller) - (count - 1) / 2.0) * span * 0.1)
        return found

    def finish(self, panel: Any, y_label: str, title: str) -> None:
        """Label a panel; values that are no numbers are named at the axis."""
        if not self.numeric:
            slanted = len(self.values) > 5
            panel.set_xticks(range(len(self.values)), [str(value).replace("_", " ") for value in self.values])
            panel.tick_params(axis="x", labelrotation=55 if slanted else 0)
            for label in panel.get_xticklabels():
                label.set_horizontalalignment("right" if slanted else "center")
                label.set_rotation_mode("anchor" if slanted else "default")
        finish(panel, self.label, y_label, title)


def _panels(data: CampaignData, height_in: float) -> tuple[Any, dict[str, Any]]:
    """Return a figure with one panel for each case that was swept, by case."""
    cases = [case for case in data.cases() if any(group.point for group in data.select(case))]
    figure = new_figure(height_in * len(cases))
    return figure, {case: figure.add_subplot(len(cases), 1, number + 1) for number, case in enumerate(cases)}


def survival(data: CampaignData, sweep: str, controllers: list[str] | None = None) -> Any:
    """Draw the share of survivors against a sweep: counts with Wilson intervals, and a logistic fit to all flights."""
    chosen = controllers or data.controllers
    axis = _Axis(data, sweep, chosen)
    figure, panels = _panels(data, 4.4)
    for case, panel in panels.items():
        for controller in chosen:
            _survival_curve(panel, axis, [group for group in data.select(case, controller) if group.point])
        panel.set_ylim(-0.04, 1.04)
        axis.finish(panel, "share that survived (95 % Wilson)", data.label(case))
    legend_below(figure, list(panels.values()))
    return figure


def _survival_curve(panel: Any, axis: _Axis, groups: list[Group]) -> None:
    if not groups:
        return
    controller, places = groups[0].controller, axis.places(groups)
    draw_intervals(panel, places, [group.survival for group in groups], controller)
    if not axis.numeric:
        return
    flights = [(float(dict(group.point)[axis.name]), row["survived"]) for group in groups for row in group.rows]
    if len({alive for _, alive in flights}) == 2:
        fit = logistic_fit([at for at, _ in flights], [alive for _, alive in flights], SEPARATION_RIDGE)
        fine = np.linspace(min(axis.values), max(axis.values), 300)
        look = style(controller)
        panel.plot(fine, fit.probability(fine), color=look.colour, linestyle=look.line, linewidth=1.1)


def sweep_metric(data: CampaignData, sweep: str, metric: str, controllers: list[str] | None = None) -> Any:
    """Draw a metric's median over survivors, with its bootstrap interval, against a sweep.

    A group that was flown once under the same conditions is a dashed line across.
    """
    chosen = controllers or data.controllers
    axis = _Axis(data, sweep, chosen)
    figure, panels = _panels(data, 4.2)
    for case, panel in panels.items():
        shown: list[float] = []
        points: list[tuple[float, float]] = []
        for controller in chosen:
            groups = [group for group in data.select(case, controller) if group.values(metric)]
            estimates = [group.estimate(metric) for group in groups]
            draw_intervals(panel, axis.places(groups), estimates, controller, joined=axis.numeric)
            shown += [estimate.value for estimate in estimates]
            points += zip(axis.places(groups), (estimate.value for estimate in estimates), strict=True)
        for group in data.flown_once(case):
            if group.controller in chosen and group.values(metric):
                shown.append(group.median(metric))
                look = style(group.controller)
                panel.axhline(shown[-1], color=look.colour, linestyle="--", label=group.controller)
        if axis.numeric or not cut_outliers(panel, points):
            upward_axis(panel, shown)
        axis.finish(panel, metric_name(metric), f"{data.label(case)}: survivors only")
    legend_below(figure, list(panels.values()))
    return figure
