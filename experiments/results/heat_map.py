"""The heat map of docs/results.md: controllers against conditions, each cell a ratio of median errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from math import isfinite
from typing import Any, Final

import numpy as np

from experiments.results.campaign_data import OURS, CampaignData, rank
from experiments.results.figure_style import new_figure
from experiments.results.tables import main_metric
from experiments.results.wording import metric_name

CONTROLLERS_MIN: Final = 3
"""Conditions with fewer controllers are not shown: their ratio says no more than the table."""
LOSSES_SHOWN: Final = 3
RANGE: Final = (0.35, 5.0)
"""Ratios at the ends of the colour scale."""
DARK_FROM: Final = 2.2
"""From this ratio on the text is white."""
HEAT_MAP_CAPTION: Final = (
    "Median error of each controller divided by the median error of the best other controller. Lighter is better; "
    "below 1 a controller is the best of its row (bold and framed, if at least half of its flights survived). Medians "
    "are over survivors; where not all flights survived, the cell states their share. Conditions with two controllers "
    "only are in the sections below."
)


@dataclass(frozen=True)
class HeatMapRow:
    """One condition."""

    campaign: str
    metric: str
    condition: str
    ratios: dict[str, float]
    """By controller: its median error / the least median error of the others; NaN if none of its flights survived."""
    survival: dict[str, float]
    """By controller: share of its flights."""
    best_other: str
    """The controller with the least median error but ours."""


def heat_map_rows(data: CampaignData) -> list[HeatMapRow]:
    """Return the conditions of a campaign under which enough controllers flew, with the campaign's main metric."""
    metric, rows = main_metric(data.config.metrics), []
    for ours in data.select(controller=OURS):
        groups = sorted([ours, *data.rivals(ours)], key=lambda group: rank(group.controller))
        medians = {group.controller: group.median(metric) for group in groups}
        if len(medians) >= CONTROLLERS_MIN:
            survival = {group.controller: group.survival.value for group in groups}
            others = {name: value for name, value in medians.items() if name != OURS and isfinite(value)}
            best = min(others, key=others.__getitem__, default="")
            ratios = _to_best_other(medians)
            rows.append(HeatMapRow(data.title, metric_name(metric), data.condition(ours), ratios, survival, best))
    return rows


def losses_first(rows: Sequence[HeatMapRow]) -> str:
    """Return, as Markdown, the conditions where ours is furthest behind the best other controller."""
    behind = [row for row in rows if row.ratios[OURS] > 1.0]
    if not behind:
        return f"In no condition of the picture another controller has a smaller median error than {OURS}.\n"
    worst = sorted(behind, key=lambda row: row.ratios[OURS], reverse=True)[:LOSSES_SHOWN]
    count = f"{len(behind)} of {len(rows)} conditions"
    lines = [f"{OURS.upper()} has a larger median error than the best other controller in {count}:\n"]
    for row in worst:
        error = f"{row.metric}, {row.ratios[OURS]:.2f} times that of {row.best_other}"
        lines.append(f"- {row.campaign}, {row.condition}: {error}")
    return "\n".join(lines) + "\n"


def _to_best_other(medians: dict[str, float]) -> dict[str, float]:
    ratios = {}
    for name, value in medians.items():
        others = [other for rival, other in medians.items() if rival != name and isfinite(other)]
        ratios[name] = value / min(others) if others else float("nan")
    return ratios


def draw_heat_map(rows: Sequence[HeatMapRow]) -> Any:
    """Draw the conditions as rows and the controllers as columns; dark is worse, so that it reads without colour."""
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm

    controllers = sorted({name for row in rows for name in row.ratios}, key=rank)
    campaigns = [(key, len(list(found))) for key, found in groupby(rows, key=lambda row: (row.campaign, row.metric))]
    figure = new_figure(1.4 + 0.31 * (len(rows) + len(campaigns)), 4.2 + 0.72 * len(controllers))
    panel = figure.add_subplot()
    norm, colours = LogNorm(*RANGE), colormaps["YlOrRd"]
    names, y, index = [], 0, 0
    for (campaign, metric), count in campaigns:
        panel.text(-0.6, y, f"{campaign}: {metric}", ha="left", va="center", fontsize=8.5, fontweight="bold")
        for row in rows[index : index + count]:
            y += 1
            names.append((y, row.condition))
            for x, controller in enumerate(controllers):
                _cell(panel, x, y, row, controller, colours, norm)
        index, y = index + count, y + 1
    panel.set_xlim(-0.6, len(controllers) - 0.4)
    panel.set_ylim(y - 0.4, -0.6)
    panel.set_yticks([place for place, _ in names], [name for _, name in names], fontsize=8)
    panel.set_xticks(range(len(controllers)), controllers, fontsize=9)
    panel.tick_params(top=True, labeltop=True, bottom=False, labelbottom=False, length=0)
    panel.spines[:].set_visible(False)
    _colour_bar(figure, panel, colours, norm)
    return figure


def _cell(panel: Any, x: int, y: int, row: HeatMapRow, controller: str, colours: Any, norm: Any) -> None:
    from matplotlib.patches import Rectangle

    if controller not in row.ratios:
        return
    ratio, survival = row.ratios[controller], row.survival[controller]
    known = isfinite(ratio)
    best = known and survival >= 0.5 and ratio == np.nanmin(list(row.ratios.values()))
    shade = colours(norm(min(max(ratio, RANGE[0]), RANGE[1]))) if known else "#555555"
    edge: dict[str, Any] = {"edgecolor": "k", "linewidth": 1.6, "zorder": 3} if best else {"edgecolor": "w"}
    panel.add_patch(Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, facecolor=shade, **edge))
    text = f"{ratio:.{2 if ratio < 10.0 else 0}f}" if known else "–"
    look = {"ha": "center", "va": "center", "color": "k" if known and ratio < DARK_FROM else "w", "zorder": 4}
    above = 0.14 if survival < 1.0 else 0.0
    panel.text(x, y - above, text, fontsize=8, fontweight="bold" if best else "normal", **look)
    if survival < 1.0:
        panel.text(x, y + 0.27, f"{100 * survival:.0f} % survive", fontsize=5.5, **look)


def _colour_bar(figure: Any, panel: Any, colours: Any, norm: Any) -> None:
    from matplotlib.cm import ScalarMappable

    bar = figure.colorbar(ScalarMappable(norm, colours), ax=panel, location="bottom", shrink=0.5, aspect=40, pad=0.01)
    ticks = (0.5, 1.0, 2.0, 4.0)
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks], minor=False)
    bar.ax.minorticks_off()
    bar.set_label("median error / that of the best other controller (logarithmic)", fontsize=8)
