"""The page of a soak: what was done, and what came of it."""

import io
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from experiments.soak.soak import SoakRun
from experiments.soak.verdict import SLOPE_MAX_MB_MIN, UNEXPLAINED, Memory, TickGap, Verdict
from flight_log.html import image, page, paragraph, section, table
from runtime.files import write_atomically, write_json

PAGE: Final = "soak.html"
NUMBERS: Final = "soak.json"


def numbers(run: SoakRun, verdict: Verdict) -> dict[str, Any]:
    """What `--json` prints."""
    memory = [asdict(one) | {"slope_mb_min": _known(one.slope_mb_min)} for one in verdict.memory]
    return {
        "passed": not verdict.failures,
        "failures": verdict.failures,
        "seed": run.seed,
        "minutes": round(verdict.minutes, 2),
        "alive": verdict.alive,
        "ticks": verdict.ticks,
        "missed_ticks": verdict.missed,
        "gaps": [asdict(one) for one in verdict.gaps],
        "escapes": verdict.escapes,
        "memory": memory,
        "disruptions": len(run.done),
        "modes_s": verdict.modes_s,
        "position_rmse_m": _known(verdict.position_rmse_m),
    }


def write(run: SoakRun, verdict: Verdict, out: Path) -> Path:
    """Write page and numbers into `out`; return the page. Raises OSError."""
    write_json(out / NUMBERS, numbers(run, verdict))
    file = out / PAGE
    write_atomically(file, html(run, verdict).encode())
    return file


def html(run: SoakRun, verdict: Verdict) -> str:
    """Return the page."""
    config = run.config
    title = f"Soak of {verdict.minutes:.1f} minutes: {config.scenario}, {config.controller}, seed {run.seed}"
    good = not verdict.failures
    return page(
        title,
        [
            paragraph("passed" if good else "FAILED: " + "; ".join(verdict.failures), "good" if good else "bad"),
            section("Result", table(result_rows(run, verdict))),
            section(
                "Memory",
                paragraph(
                    f"Slope of the longest life of each process, after its first minute; at most {SLOPE_MAX_MB_MIN} "
                    "MB/min."
                ),
                table([_memory_row(one) for one in verdict.memory], MEMORY_HEAD),
                image(_memory_figure(run), "memory over time"),
            ),
            section("Missed ticks", table([_gap_row(one) for one in verdict.gaps], GAP_HEAD)),
            section("Time in each mode", table([(name, f"{s:.1f} s") for name, s in verdict.modes_s.items()])),
            section("What was done", table(done_rows(run), ("flight time", "what", "ended", "note"))),
            section("Events of the processes", table(_event_rows(run.events), ("event (N: a digit)", "times"))),
        ],
    )


MEMORY_HEAD: Final = ("process", "lives", "longest", "first MB", "last MB", "MB/min")


GAP_HEAD: Final = ("flight time", "missed", "gap", "no processor for", "loop computed", "page faults", "explanation")


def _gap_row(one: TickGap) -> tuple[str, ...]:
    times = (f"{ms:.1f} ms" for ms in (one.gap_ms, one.waited_ms, one.own_ms))
    return f"{one.at_s:.2f} s", str(one.missed), *times, str(one.page_faults), one.why


def result_rows(run: SoakRun, verdict: Verdict) -> list[tuple[str, str]]:
    """Return the lines of the result: name and text."""
    missed = ", ".join(f"{count} {why}" for why, count in verdict.missed.items() if count) or "none"
    outcome = "alive" if verdict.alive else f"LOST: {verdict.why_lost}"
    return [
        ("vehicle", outcome + (", ended early by request" if run.interrupted else "")),
        ("position RMSE", f"{1e3 * verdict.position_rmse_m:.1f} mm"),
        ("ticks", str(verdict.ticks)),
        ("missed ticks", missed),
        ("of them " + UNEXPLAINED, str(verdict.missed.get(UNEXPLAINED, 0))),
        ("escapes", ", ".join(f"{name} {count}" for name, count in verdict.escapes.items())),
        ("disruptions", f"{len(run.done)}"),
        ("feature version at the end", str(verdict.versions)),
        ("exit status", ", ".join(f"{name} {status}" for name, status in run.exit_status.items())),
    ]


def _memory_row(one: Memory) -> tuple[str, ...]:
    size = f"{one.first_mb:.1f}", f"{one.last_mb:.1f}"
    return one.process, str(one.lives), f"{one.seconds:.0f} s", *size, slope_text(one)


def slope_text(one: Memory) -> str:
    """Return the slope in MB/min, or that the life was too short."""
    return "too short a life for" if math.isnan(one.slope_mb_min) else f"{one.slope_mb_min:+.3f}"


def done_rows(run: SoakRun) -> list[tuple[str, ...]]:
    """Return one row for each disruption."""
    rows = list[tuple[str, ...]]()
    for one in run.done:
        begin_s = (one.begin_ns - run.begin_ns) * 1e-9
        ended = f"after {(one.end_ns - one.begin_ns) * 1e-9:.3f} s" if one.end_ns else "-"
        rows.append((f"{begin_s:.2f} s", str(one.disruption), ended, one.note))
    return rows


def _event_rows(events: Mapping[str, int]) -> list[tuple[str, str]]:
    return [(text, str(count)) for text, count in sorted(events.items(), key=lambda one: (-one[1], one[0]))]


def _memory_figure(run: SoakRun) -> bytes:
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(life.name for life in run.lives))
    figure = Figure(figsize=(9.0, 1.6 * len(names)), layout="constrained")
    for axes, name in zip(figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0], names, strict=True):
        for life in run.lives:
            if life.name == name:
                axes.plot([(time_s - run.begin_ns * 1e-9) / 60.0 for time_s in life.times_s], life.memory_mb)
        axes.set_ylabel(f"{name}, MB")
    axes.set_xlabel("flight time, min")
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    return out.getvalue()


def _known(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 5)
