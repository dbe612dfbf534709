"""`python -m experiments.link.link_page`: measures what the link tolerates and rebuilds the tables of docs/link.md.

Flies the campaign `dropouts` (or the rest of it, if its folder holds flights) and every trace of configs/dropouts, then
rewrites the text between the marks of the page, and the figure. That text is not edited by hand.
"""

import argparse
import contextlib
import json
import math
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from configs.loader import ConfigError
from experiments.link.link_tables import (
    CAMPAIGN,
    GROUPS,
    PERFECT_POINT,
    Flights,
    age_table,
    read_flights,
    sweep_table,
    trace_table,
    verdict,
)
from experiments.results.figure_style import finish, new_figure

TRACES_FILE: Final = "traces.json"
PAGE: Final = Path(__file__).resolve().parents[2] / "docs" / "link.md"
FIGURE: Final = "link_feature_age.png"
MARKS: Final = ("<!-- made by python -m experiments.link.link_page: {} -->", "<!-- end: {} -->")
COLOURS: Final = ("#0072b2", "#d55e00", "#009e73")


def draw(flights: Flights, controller: str, path: Path) -> None:
    """Write the figure: RMSE of each survivor against the median age of its features."""
    figure = new_figure(4.2, 7.0)
    axes = figure.add_subplot()
    flown = {link: group.survivors for (link, name), group in flights.items() if name == controller}
    for (kind, title), colour in zip(GROUPS, COLOURS, strict=True):
        rows = [row for link, survivors in flown.items() if link.startswith(kind) for row in survivors]
        rows = [row for row in rows if math.isfinite(row["feature_age_median_s"])]
        ages, errors = ([row[name] for row in rows] for name in ("feature_age_median_s", "position_rmse_m"))
        axes.scatter(ages, 100 * np.array(errors), s=14, alpha=0.6, color=colour, label=title)
    every = [row for survivors in flown.values() for row in survivors]
    never = [row["position_rmse_m"] for row in every if math.isnan(row["feature_age_median_s"])]
    if never:
        axes.axhline(
            100 * float(np.median(never)), color="0.5", linewidth=0.8, label="median of flights without features"
        )
    axes.set_xscale("log")
    title = f"{controller}: each dot is a flight that survived"
    finish(axes, "median age of the features in use [s]", "position RMSE [cm]", title)
    axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def replace_between_marks(text: str, name: str, content: str) -> str:
    """Return the page with the content of a block replaced.

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
    """Rewrite the blocks of the page and the figure from the flights in `folder`.

    Raises
    ------
    ConfigError
        If there is no flight with a perfect link: all others are compared with these.
    """
    flights = read_flights(folder)
    if not any(link == PERFECT_POINT for link, _ in flights):
        raise ConfigError(
            f"--out {folder}: holds no flight at {PERFECT_POINT} yet, so there is nothing to compare with"
        )
    controllers = [name for name in ("mrac", "dmrac") if any(flown_by == name for _, flown_by in flights)]
    blocks = {"verdict": verdict(flights), "age": age_table(flights, "dmrac")}
    blocks |= {kind: sweep_table(flights, kind, controllers) for kind, _ in GROUPS}
    traces = folder / TRACES_FILE
    if traces.exists():
        blocks["traces"] = trace_table(json.loads(traces.read_text(encoding="utf-8")))
    text = page.read_text(encoding="utf-8")
    for name, content in blocks.items():
        text = replace_between_marks(text, name, content)
    page.write_text(text, encoding="utf-8")
    draw(flights, "dmrac", page.parent / "pictures" / FIGURE)


def dmrac(*words: str) -> int:
    """Run a subcommand and return its exit status; the subcommand itself answers Ctrl-C and stores what was flown."""
    process = subprocess.Popen([sys.executable, "-m", "async_dmrac", *words])
    while True:
        with contextlib.suppress(KeyboardInterrupt):
            return process.wait()


def main(words: Sequence[str] | None = None) -> int:
    """Fly what is missing and rebuild the page."""
    parser = argparse.ArgumentParser(description="Rebuild the tables of docs/link.md.")
    parser.add_argument("--seeds", type=int, default=4, help="seeds per point (default 4)")
    parser.add_argument("--jobs", type=int, help="flights side by side (default: one per core)")
    parser.add_argument("--out", type=Path, default=Path("campaigns") / CAMPAIGN, help="folder of the flights")
    parser.add_argument("--no-flights", action="store_true", help="fly nothing, rebuild from the folder's flights")
    parser.add_argument("--page", type=Path, default=PAGE, help="the page (default docs/link.md)")
    options = parser.parse_args(words)
    if not options.page.is_file():
        parser.error(f"--page {options.page}: no such page")
    status = 0 if options.no_flights else fly(options)
    if status:
        return status
    try:
        rebuild(options.out, options.page)
    except ConfigError as error:
        parser.error(str(error))
    return 0


def fly(options: argparse.Namespace) -> int:
    """Fly what is missing of the campaign, and the dropout traces once; return the exit status."""
    jobs = [] if options.jobs is None else ["--jobs", str(options.jobs)]
    resume = ["--resume", "--retry-errors"] if options.out.exists() else []
    status = dmrac("campaign", CAMPAIGN, "--seeds", str(options.seeds), "--out", str(options.out), *jobs, *resume)
    traces = options.out / TRACES_FILE
    if status or traces.exists():
        return status
    dmrac("dropouts", "--out", str(traces), *jobs)  # its status tells whether all survived; so does the table
    return 0 if traces.exists() else 2


if __name__ == "__main__":
    sys.exit(main())
