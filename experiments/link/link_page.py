"""`python -m experiments.link.link_page`: measures what the link tolerates and rebuilds the tables of docs/link.md.

Flies the campaign `dropouts` (going on with what its folder holds) and every trace of configs/dropouts, then rewrites
what stands between the marks in the page, and the figure. Nothing in there is written by hand.
"""

import argparse
import contextlib
import json
import math
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from configs.loader import ConfigError
from experiments.campaigns.flight_row import Row, outcomes, point_of
from experiments.campaigns.store import read_table
from experiments.results.statistics import Estimate, median, survives_less, wilson

CAMPAIGN: Final = "dropouts"
SWEEP: Final = "link"
PERFECT_POINT: Final = "loss_0"
TRACES_FILE: Final = "traces.json"
PAGE: Final = Path(__file__).resolve().parents[2] / "docs" / "link.md"
FIGURE: Final = "link_feature_age.png"
MARKS: Final = ("<!-- made by python -m experiments.link.link_page: {} -->", "<!-- end: {} -->")
AGE_EDGES_S: Final = (0.0, 1.0, 2.0, 4.0, 8.0, math.inf)
GROUPS: Final = (
    ("loss", "Independent loss, each way"),
    ("burst", "30 % lost in bursts, each way"),
    ("silent", "Silence, each way"),
)


@dataclass(frozen=True)
class Cell:
    """The flights of one controller with one kind of link."""

    rows: tuple[Row, ...]

    @cached_property
    def survival(self) -> Estimate:
        """Share that survived, Wilson interval."""
        return wilson(sum(bool(row["survived"]) for row in self.rows), len(self.rows))

    def survivors(self, name: str) -> list[float]:
        """A column of those that survived, without NaN."""
        values = (float(row[name]) for row in self.rows if row["survived"])
        return [value for value in values if math.isfinite(value)]

    def estimate(self, name: str) -> Estimate:
        """Median over survivors with its bootstrap interval."""
        return median(self.survivors(name), np.random.default_rng([20_301, len(name)]))

    def mean(self, name: str) -> float:
        """Mean over all; NaN for none."""
        values = [float(row[name]) for row in self.rows if math.isfinite(row[name])]
        return float(np.mean(values)) if values else math.nan


Cells = dict[tuple[str, str], Cell]
"""By (link, controller)."""


def read_cells(folder: Path) -> Cells:
    """The campaign's flights by link and controller; flights that failed are left out."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in read_table(folder).to_pylist():
        if not row["error"]:
            found.setdefault((str(point_of(row)[SWEEP]), row["controller"]), []).append(row)
    return {key: Cell(tuple(rows)) for key, rows in found.items()}


def links_of(cells: Cells, kind: str) -> list[str]:
    """The links of one kind, in the order of the campaign file."""
    from experiments.campaigns.campaign import load_campaign

    points = load_campaign(CAMPAIGN)[0].sweeps[0].points
    flown = {link for link, _ in cells}
    return [link for link in points if link.startswith(kind) and link in flown]


def name_of(link: str) -> str:
    """A link in words: `silent_3_before` is "3 s before the chip"."""
    kind, _, rest = link.partition("_")
    if kind == "loss":
        return "perfect" if rest == "0" else f"{rest} %"
    if kind == "burst":
        return f"{rest} on average"
    length, _, place = rest.partition("_")
    how_long = "to the end" if length == "end" else f"{length} s"
    return f"{how_long}, from {'before' if place == 'before' else 'right after'} the chip"


def sweep_table(cells: Cells, kind: str, controllers: Sequence[str]) -> str:
    """Markdown: one row for each link of a kind, the perfect one first."""
    links = links_of(cells, kind)
    links = links if PERFECT_POINT in links else [PERFECT_POINT, *links]
    heads = ["link", "lost up / down"]
    for controller in controllers:
        heads += [f"{controller}: survived", "RMSE", "before the chip", "after it"]
    heads += ["feature age", "pose age", "up", "down"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for link in links:
        present = [controller for controller in controllers if (link, controller) in cells]
        if not present:
            continue
        last = cells[link, present[-1]]
        parts = [name_of(link), f"{last.mean('up_lost_share'):.0%} / {last.mean('down_lost_share'):.0%}"]
        for controller in controllers:
            parts += _flown(cells.get((link, controller)), cells.get((PERFECT_POINT, controller)))
        parts += [_seconds(last.estimate("feature_age_median_s").value), _seconds(last.mean("pose_age_median_s"))]
        parts += [f"{last.mean(f'{way}_bytes_s') / 1000:.1f} kB/s" for way in ("up", "down")]
        lines.append("| " + " | ".join(parts) + " |")
    return "\n".join(lines)


def _flown(cell: Cell | None, perfect: Cell | None) -> list[str]:
    if cell is None:
        return ["-"] * 4
    survival = cell.survival
    alive = sum(bool(row["survived"]) for row in cell.rows)
    text = f"{alive}/{len(cell.rows)} ({survival.low:.0%} to {survival.high:.0%})"
    if perfect is not None and is_below(cell, perfect):
        text = f"**{text} below**"
    names = ("position_rmse_m", "before_onset_rmse_m", "after_onset_rmse_m")
    return [text, *(_centimetres(cell.estimate(name)) for name in names)]


def is_below(cell: Cell, perfect: Cell) -> bool:
    """Whether survival is below the perfect link's at the 95 % level, on the same seeds."""
    return survives_less(outcomes(cell.rows), outcomes(perfect.rows))


def verdict(cells: Cells, controllers: Sequence[str]) -> str:
    """One line that says whether the claim holds."""
    below = [
        f"{controller} at {link}"
        for (link, controller), cell in cells.items()
        if controller in controllers
        and (PERFECT_POINT, controller) in cells
        and is_below(cell, cells[PERFECT_POINT, controller])
    ]
    flights = sum(len(cell.rows) for cell in cells.values())
    lost = sum(not row["survived"] for cell in cells.values() for row in cell.rows)
    seeds = len({row["seed"] for cell in cells.values() for row in cell.rows})
    said = f"{flights} flights, {seeds} seeds, {lost} vehicles lost. Survival is "
    said += (
        "below the perfect link's at the 95 % level for: " + ", ".join(below)
        if below
        else "nowhere below that of the same controller with a perfect link at the 95 % level"
    )
    return said + "."


def age_table(cells: Cells, controller: str) -> str:
    """Markdown: RMSE of single flights by the median age of the features in the air."""
    rows = [row for (_, flown_by), cell in cells.items() if flown_by == controller for row in cell.rows]
    alive = [row for row in rows if row["survived"]]
    lines = ["| median age of the features | flights | RMSE, median | quartiles |", "|---|---|---|---|"]
    for low, high in pairwise(AGE_EDGES_S):
        within = [row["position_rmse_m"] for row in alive if low <= row["feature_age_median_s"] < high]
        lines.append(_age_row(f"{low:g} s and more" if math.isinf(high) else f"{low:g} to {high:g} s", within))
    never = [row["position_rmse_m"] for row in alive if math.isnan(row["feature_age_median_s"])]
    lines.append(_age_row("none ever arrived", never))
    return "\n".join(lines)


def _age_row(name: str, values: list[float]) -> str:
    if not values:
        return f"| {name} | 0 | - | - |"
    low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
    return f"| {name} | {len(values)} | {100 * middle:.1f} cm | {100 * low:.1f} to {100 * high:.1f} cm |"


def trace_table(rows: Iterable[dict[str, Any]]) -> str:
    """Markdown: the flights with the shipped traces."""
    from experiments.link.dropout_flights import HEADINGS, DropoutRow

    lines = ["| " + " | ".join(HEADINGS) + " |", "|---" * len(HEADINGS) + "|"]
    lines += ["| " + " | ".join(DropoutRow(**row).cells()) + " |" for row in rows]
    return "\n".join(lines)


def _centimetres(estimate: Estimate) -> str:
    return "-" if math.isnan(estimate.value) else f"{100 * estimate.value:.1f} cm"


def _seconds(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f} s"


def draw(cells: Cells, controller: str, path: Path) -> None:
    """RMSE of each flight that survived against the median age of its features."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    colours = dict(zip((kind for kind, _ in GROUPS), ("#0072b2", "#d55e00", "#009e73"), strict=True))
    for kind, title in GROUPS:
        rows = [
            row
            for (link, flown_by), cell in cells.items()
            if flown_by == controller and link.startswith(kind)
            for row in cell.rows
        ]
        alive = [row for row in rows if row["survived"] and math.isfinite(row["feature_age_median_s"])]
        ages, errors = ([row[name] for row in alive] for name in ("feature_age_median_s", "position_rmse_m"))
        axes.scatter(ages, 100 * np.array(errors), s=14, alpha=0.6, color=colours[kind], label=title)
    never = [
        row["position_rmse_m"]
        for (_, flown_by), cell in cells.items()
        if flown_by == controller
        for row in cell.rows
        if row["survived"] and math.isnan(row["feature_age_median_s"])
    ]
    if never:
        axes.axhline(100 * float(np.median(never)), color="0.5", linewidth=0.8, label="median where none ever arrived")
    axes.set_xscale("log")
    axes.set_xlabel("median age of the features in the air [s]")
    axes.set_ylabel("position RMSE [cm]")
    axes.set_title(f"{controller}: each dot is a flight that survived")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def replace_between_marks(text: str, name: str, content: str) -> str:
    """The page with what stands between a block's marks replaced.

    Raises
    ------
    ValueError
        If the page has no such block.
    """
    begin, end = (mark.format(name) for mark in MARKS)
    if begin not in text or end not in text:
        raise ValueError(f"the page has no block {name!r}")
    head, _, rest = text.partition(begin)
    _, _, tail = rest.partition(end)
    return f"{head}{begin}\n\n{content}\n\n{end}{tail}"


def rebuild(folder: Path, page: Path) -> None:
    """Rewrites the blocks of the page and the figure from what the folder holds.

    Raises
    ------
    ConfigError
        If it holds no flight with a perfect link, which all others are held against.
    """
    cells = read_cells(folder)
    if not any(link == PERFECT_POINT for link, _ in cells):
        raise ConfigError(
            f"--out {folder}: holds no flight at {PERFECT_POINT} yet, so there is nothing to compare with"
        )
    controllers = [name for name in ("mrac", "dmrac") if any(flown_by == name for _, flown_by in cells)]
    text = page.read_text(encoding="utf-8")
    text = replace_between_marks(text, "verdict", verdict(cells, controllers))
    for kind, _ in GROUPS:
        text = replace_between_marks(text, kind, sweep_table(cells, kind, controllers))
    text = replace_between_marks(text, "age", age_table(cells, "dmrac"))
    traces = folder / TRACES_FILE
    if traces.exists():
        text = replace_between_marks(text, "traces", trace_table(json.loads(traces.read_text(encoding="utf-8"))))
    page.write_text(text, encoding="utf-8")
    draw(cells, "dmrac", page.parent / "pictures" / FIGURE)


def dmrac(*words: str) -> int:
    """Run a subcommand as a person would; returns its exit status. Ctrl-C is its to answer: it keeps what is flown."""
    process = subprocess.Popen([sys.executable, "-m", "async_dmrac", *words])
    while True:
        with contextlib.suppress(KeyboardInterrupt):
            return process.wait()


def main(words: Sequence[str] | None = None) -> int:
    """Flies what is missing and rebuilds the page."""
    parser = argparse.ArgumentParser(description="Rebuild the tables of docs/link.md.")
    parser.add_argument("--seeds", type=int, default=4, help="seeds a point (default 4)")
    parser.add_argument("--jobs", type=int, help="flights side by side (default: one a core)")
    parser.add_argument("--out", type=Path, default=Path("campaigns") / CAMPAIGN, help="folder of the flights")
    parser.add_argument("--no-flights", action="store_true", help="only rebuild from what the folder holds")
    parser.add_argument("--page", type=Path, default=PAGE, help="the page (default docs/link.md)")
    options = parser.parse_args(words)
    if not options.page.is_file():
        parser.error(f"--page {options.page}: no such page")
    if not options.no_flights:
        jobs = [] if options.jobs is None else ["--jobs", str(options.jobs)]
        resume = ["--resume", "--retry-errors"] if options.out.exists() else []
        flown = dmrac("campaign", CAMPAIGN, "--seeds", str(options.seeds), "--out", str(options.out), *jobs, *resume)
        if flown:
            return flown
        traces = options.out / TRACES_FILE
        if not traces.exists():
            dmrac("dropouts", "--out", str(traces), *jobs)  # its status says whether all survived: the table does, too
            if not traces.exists():
                return 2
    try:
        rebuild(options.out, options.page)
    except ConfigError as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
