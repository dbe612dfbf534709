"""The tables of a campaign, as Markdown or HTML."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from statistics import fmean, median
from typing import Final

from experiments.campaigns.campaign import Flown, Target
from experiments.campaigns.flight_row import Row
from experiments.results.campaign_data import OURS, CampaignData, Group, generator
from experiments.results.statistics import Estimate, half_survival_point
from experiments.results.wording import BOUND_UNITS, counted, metric_name, show
from flight_log.html import table

ROWS_TO_JOIN = 3
"""Cases with at most so many rows share one table."""
_SIZES: Final = ("bound", "error")
TARGET_HEADER: Final = ("ratio", "reached", "pairs", "target", "met")


@dataclass(frozen=True)
class Table:
    """A table of texts."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """Return the table in GitHub's Markdown."""
        lines = [f"**{self.caption}**", "", "| " + " | ".join(self.header) + " |", "|---" * len(self.header) + "|"]
        lines += ["| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in self.rows]
        return "\n".join(lines) + "\n"

    def html(self) -> str:
        """Return the table in HTML."""
        return table(self.rows, self.header, self.caption)


def tables(data: CampaignData) -> list[Table]:
    """Return all tables of a campaign."""
    cases = data.cases()
    few = max(len(data.select(case)) for case in cases) <= ROWS_TO_JOIN
    made = [_results(data, cases)] if few else [_results(data, [case]) for case in cases]
    made += [_half_points(data)] if _numeric_sweep(data) else []
    made += [_targets(data)] if data.config.targets else []
    made += [_bounds(data)] if has_bounds(data.rows) else []
    made += [_failures(data)] if data.failed else []
    return made


def has_bounds(rows: Sequence[Row]) -> bool:
    """Return whether a flight has a live bound; those flown before it became one on the tracking error have none."""
    return any(isfinite(row["position_bound_coverage"]) for row in rows)


def _bounds(data: CampaignData) -> Table:
    """Return the live bound and its coverage by controller, and over the campaign; vehicles that were lost count."""
    header: tuple[str, ...] = ("controller", "flights")
    for channel, _, unit, _ in BOUND_UNITS:
        header += (f"{channel}: bound [{unit}]", f"error [{unit}]", "covered", "least flight")
    named = [(name, [row for row in data.rows if row["controller"] == name]) for name in data.controllers]
    rows = []
    for name, flights in (*named, ("all", list(data.rows))):
        flown = [row for row in flights if isfinite(row["position_bound_coverage"])]
        if flown:
            cells = [cell for unit in BOUND_UNITS for cell in _bound_cells(flown, *unit)]
            rows.append((name, str(len(flown)), *cells))
    caption = "Live bound on the tracking error: medians over the flights, and the share of ticks that it covers"
    return Table(f"{caption} (lost vehicles included)", header, tuple(rows))


def _bound_cells(rows: Sequence[Row], channel: str, column_unit: str, unit: str, factor: float) -> list[str]:
    """Return bound, error, mean coverage and that of the worst flight."""
    bound, error = (median(factor * row[f"{channel}_{kind}_median_{column_unit}"] for row in rows) for kind in _SIZES)
    coverage = [row[f"{channel}_bound_coverage"] for row in rows]
    return [f"{bound:.1f}", f"{error:.1f}", f"{100.0 * fmean(coverage):.2f} %", f"{100.0 * min(coverage):.1f} %"]


def _results(data: CampaignData, cases: Sequence[str]) -> Table:
    """Return one table for a case, or for several cases that are compared with each other."""
    metrics = data.config.metrics
    groups = [group for case in cases for group in data.select(case)]
    swept = list(dict.fromkeys(name for group in groups for name, _ in group.point))
    joined = len(cases) > 1
    header = (*(["case"] if joined else []), *swept, "controller", "flights", "survived")
    rows = []
    for group in groups:
        base = _base(data, group)
        rows.append(
            (
                *([data.label(group.case)] if joined else []),
                *(str(dict(group.point).get(name, "–")) for name in swept),
                f"**{group.controller}**" if group.controller == OURS else group.controller,
                str(len(group.rows)),
                show(group.survival, percent=True),
                *(show(group.estimate(metric)) for metric in metrics),
                _ratio(group, base, main_metric(metrics)),
            )
        )
    against = data.config.compare_to or data.config.controllers[-1]
    header = (*header, *(metric_name(metric) for metric in metrics), f"ratio to {against}")
    which = f"ratio: {metric_name(main_metric(metrics))}, paired by seed"
    title = data.config.title if joined else data.label(cases[0])
    return Table(f"{title}: medians of the survivors [95 % interval]; {which}", header, tuple(rows))


def _ratio(group: Group, base: Group | None, metric: str) -> str:
    if base is None:
        return "–"
    if base == group:
        return "1"
    ratio = group.ratio(base, metric)
    pairs = f" ({counted(ratio.count, 'pair')})" if 0 < ratio.count < len(group.rows) else ""
    return show(ratio, 2) + pairs


def main_metric(metrics: Sequence[str]) -> str:
    """Return the metric that ratios are formed of."""
    return metrics[0] if len(metrics) == 1 else metrics[1]


def _base(data: CampaignData, group: Group) -> Group | None:
    """Return the group that a group's ratio is formed with; the group itself if it is the base; None if there is none.

    The campaign's `compare_to` names a controller, a case, or a point of the sweep; the first that exists counts.
    """
    name = data.config.compare_to or data.config.controllers[-1]
    point = dict(group.point)
    candidates = data.select(group.case, name, point)
    if not candidates and name in [case.name for case in data.config.cases]:
        candidates = data.select(name, group.controller) or data.select(name)
    if not candidates:
        candidates = [
            other for other in data.select(group.case, group.controller) if name in dict(other.point).values()
        ]
    return candidates[0] if candidates else None


def _numeric_sweep(data: CampaignData) -> str:
    names = [sweep.name for sweep in data.config.sweeps if all(isinstance(v, int | float) for v in sweep.values)]
    return names[0] if names and data.config.sweeps[0].values else ""


def _half_points(data: CampaignData) -> Table:
    sweep = _numeric_sweep(data)
    rows = []
    for case in data.cases():
        for controller in data.controllers:
            groups = [group for group in data.select(case, controller) if group.point]
            x = [float(dict(group.point)[sweep]) for group in groups for _ in group.rows]
            alive = [bool(row["survived"]) for group in groups for row in group.rows]
            seeds = [int(row["seed"]) for group in groups for row in group.rows]
            if x:
                point = half_survival_point(x, alive, seeds, generator("half", case, controller))
                rows.append((data.label(case), controller, str(len(x)), show(point), _band(data, case, controller)))
    label = data.config.sweeps[0].label or sweep
    header = ("case", "controller", "flights", label, "dmrac ≥ 95 % and this ≤ 50 % at")
    return Table(f"Where half of the vehicles survive, by logistic fit: {label}", header, tuple(rows))


def _band(data: CampaignData, case: str, controller: str) -> str:
    """Return the values of the sweep where 95 % of ours survive and at most half of the other's."""
    found = []
    for ours in data.select(case, OURS):
        for theirs in data.select(case, controller, dict(ours.point)):
            if ours.survival.value >= 0.95 and theirs.survival.value <= 0.5:
                found += [str(value) for _, value in ours.point]
    return ", ".join(found) or "–"


def _group(data: CampaignData, flown: Flown) -> Group | None:
    found = data.select(flown.case, flown.controller, flown.point)
    return found[0] if found else None


def target_ratio(data: CampaignData, target: Target) -> tuple[Estimate, str] | None:
    """Return the ratio of a target and the controller that ours is compared with; None if a group was not flown.

    Of several controllers it is the one with the least median: the strongest there, named after the fact.
    """
    ours, theirs = _group(data, target.ours), [_group(data, flown) for flown in target.theirs.flown]
    flown = [group for group in theirs if group is not None and isfinite(group.median(target.metric))]
    if ours is None or len(flown) < len(theirs):
        return None
    best = min(flown, key=lambda group: group.median(target.metric))
    return ours.ratio(best, target.metric), best.controller


def _targets(data: CampaignData) -> Table:
    return Table("Targets: medians of ratios paired by seed", TARGET_HEADER, tuple(target_rows(data)))


def target_rows(data: CampaignData) -> list[tuple[str, ...]]:
    """Return the rows of the table of targets, for the targets that have flights."""
    rows: list[tuple[str, ...]] = []
    for target in data.config.targets:
        found = target_ratio(data, target)
        if found is not None:
            ratio, against = found
            label = target.label if isinstance(target.theirs.controller, str) else f"{target.label} ({against})"
            met = "yes" if ratio.value <= target.at_most else "**no**"
            rows.append((label, show(ratio, 2), str(ratio.count), f"≤ {target.at_most:.2f}", met))
    return rows


def _failures(data: CampaignData) -> Table:
    rows = tuple((row["key"], row["error"], row["command"]) for row in data.failed[:20])
    return Table(
        f"{len(data.failed)} flights failed; they are in none of the numbers above",
        ("flight", "error", "command"),
        rows,
    )
