"""The tables of docs/link.md, from the flights of the campaign `dropouts` and of the dropout traces."""

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from experiments.campaigns.campaign import load_campaign
from experiments.campaigns.flight_row import Row, point_of
from experiments.campaigns.store import read_table
from experiments.link.dropout_flights import HEADINGS, DropoutRow
from experiments.results.campaign_data import Group
from experiments.results.statistics import SIGNIFICANT, holm, sign_test

CAMPAIGN: Final = "dropouts"
SWEEP: Final = "link"
PERFECT_POINT: Final = "loss_0"
AGE_EDGES_S: Final = (0.0, 1.0, 2.0, 4.0, 8.0, math.inf)
GROUPS: Final = (
    ("loss", "Independent loss, each way"),
    ("burst", "30 % lost in bursts, each way"),
    ("silent", "Silence, each way"),
)

Flights = dict[tuple[str, str], Group]
"""By (link, controller)."""


def read_flights(folder: Path) -> Flights:
    """Return the campaign's flights by link and controller, without flights that failed."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in read_table(folder).to_pylist():
        if not row["error"]:
            found.setdefault((str(point_of(row)[SWEEP]), row["controller"]), []).append(row)
    return {key: group_of(*key, rows) for key, rows in found.items()}


def group_of(link: str, controller: str, rows: Iterable[Row]) -> Group:
    """Return the flights of one controller with one link as a group; missing numbers become NaN."""
    known = ({name: math.nan if value is None else value for name, value in row.items()} for row in rows)
    return Group(CAMPAIGN, controller, ((SWEEP, link),), tuple(known))


def links_of(flights: Flights, kind: str) -> list[str]:
    """Return the links of one kind that were flown, in the order of the campaign file."""
    points = load_campaign(CAMPAIGN)[0].sweeps[0].points
    flown = {link for link, _ in flights}
    return [link for link in points if link.startswith(kind) and link in flown]


def name_of(link: str) -> str:
    """Return a link in words: `silent_3_before` is "3 s, from before the chip"."""
    kind, _, rest = link.partition("_")
    if kind == "loss":
        return "perfect" if rest == "0" else f"{rest} %"
    if kind == "burst":
        return f"{rest} on average"
    length, _, place = rest.partition("_")
    how_long = "to the end" if length == "end" else f"{length} s"
    return f"{how_long}, from {'before' if place == 'before' else 'right after'} the chip"


def markdown(*rows: Sequence[str]) -> str:
    """Return a Markdown table; the first row is its head."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|---" * len(rows[0]) + "|", *lines[1:]])


def sweep_table(flights: Flights, kind: str, controllers: Sequence[str]) -> str:
    """Return a Markdown table with one row for each link of a kind, the perfect link first."""
    links, below = links_of(flights, kind), links_below(flights)
    head = ["link", "lost up / down"]
    for controller in controllers:
        head += [f"{controller}: survived", "RMSE", "before the chip", "after it"]
    rows = [[*head, "feature age", "pose age", "up", "down"]]
    for link in links if PERFECT_POINT in links else [PERFECT_POINT, *links]:
        groups = {name: flights[link, name] for name in controllers if (link, name) in flights}
        if groups:
            last = list(groups.values())[-1]
            cells = [name_of(link), f"{_mean(last, 'up_lost_share'):.0%} / {_mean(last, 'down_lost_share'):.0%}"]
            for name in controllers:
                cells += _flown(groups[name], (link, name) in below) if name in groups else ["-"] * 4
            cells += [_seconds(last.median("feature_age_median_s")), _seconds(_mean(last, "pose_age_median_s"))]
            rows.append([*cells, *(f"{_mean(last, f'{way}_bytes_s') / 1000:.1f} kB/s" for way in ("up", "down"))])
    return markdown(*rows)


def _flown(group: Group, below: bool) -> list[str]:
    share = group.survival
    text = f"{len(group.survivors)}/{len(group.rows)} ({share.low:.0%} to {share.high:.0%})"
    names = ("position_rmse_m", "before_onset_rmse_m", "after_onset_rmse_m")
    errors = (group.median(name) for name in names)
    return [
        f"**{text} below**" if below else text,
        *("-" if math.isnan(one) else f"{100 * one:.1f} cm" for one in errors),
    ]


def _mean(group: Group, name: str) -> float:
    """Mean of a column over all flights; NaN for none."""
    values = [float(row[name]) for row in group.rows if math.isfinite(row[name])]
    return float(np.mean(values)) if values else math.nan


def _seconds(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f} s"


def links_below(flights: Flights) -> set[tuple[str, str]]:
    """Return link and controller where significantly fewer flights survive than with a perfect link.

    Exact sign test on the same seeds, 5 % level after Holm's correction for the number of links and controllers.
    """
    tests = {
        (link, controller): sign_test(group.outcomes, flights[PERFECT_POINT, controller].outcomes)
        for (link, controller), group in flights.items()
        if link != PERFECT_POINT and (PERFECT_POINT, controller) in flights
    }
    corrected = dict(zip(tests, holm([p_value for _, _, p_value in tests.values()]), strict=True))
    return {key for key, (less, more, _) in tests.items() if less > more and corrected[key] < SIGNIFICANT}


def verdict(flights: Flights) -> str:
    """Return the number of flights, and where survival is below that with a perfect link."""
    found = links_below(flights)
    below = [f"{controller} at {link}" for link, controller in flights if (link, controller) in found]
    rows = [row for group in flights.values() for row in group.rows]
    lost, seeds = sum(not row["survived"] for row in rows), len({row["seed"] for row in rows})
    text = f"{len(rows)} flights, {seeds} seeds, {lost} vehicles lost. Survival is "
    text += "significantly below" if below else "nowhere significantly below"
    text += " that of the same controller with a perfect link (exact sign test by seed, 5 % level, corrected for the "
    return f"{text}number of links with Holm's method){': ' if below else ''}{', '.join(below)}."


def age_table(flights: Flights, controller: str) -> str:
    """Return a Markdown table of the survivors' RMSE by the median age of the features in use."""
    alive = [row for (_, name), group in flights.items() if name == controller for row in group.survivors]
    rows = [("median age of the features", "flights", "RMSE, median", "quartiles")]
    for low, high in pairwise(AGE_EDGES_S):
        within = [row["position_rmse_m"] for row in alive if low <= row["feature_age_median_s"] < high]
        rows.append(_age_row(f"{low:g} s and more" if math.isinf(high) else f"{low:g} to {high:g} s", within))
    never = [row["position_rmse_m"] for row in alive if math.isnan(row["feature_age_median_s"])]
    return markdown(*rows, _age_row("none ever arrived", never))


def _age_row(name: str, values: list[float]) -> tuple[str, str, str, str]:
    if not values:
        return name, "0", "-", "-"
    low, middle, high = 100 * np.quantile(values, (0.25, 0.5, 0.75))
    return name, str(len(values)), f"{middle:.1f} cm", f"{low:.1f} to {high:.1f} cm"


def trace_table(rows: Iterable[dict[str, Any]]) -> str:
    """Return a Markdown table of the flights with the shipped dropout traces."""
    return markdown(HEADINGS, *(DropoutRow(**row).cells() for row in rows))
