"""The summary of a flight: summary.json and a table for the terminal, from the trace and the processes' summaries."""

import math
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.text import Text

from experiments.flights.metrics import bound_metrics, flight_metrics, known_ages, median
from experiments.flights.scenario import FlightConfig
from experiments.flights.trace import FlightTrace
from runtime.files import write_json

_ONBOARD: Final = ("ticks", "missed", "tick_us", "rss_mb", "calibration")
"""What summary.json has of onboard's own summary, as it is."""
_TRAINING: Final = ("rounds", "samples", "buffered", "verdicts", "unused")
"""The same of offboard's."""


def build_summary(
    config: FlightConfig,
    mode: str,
    trace: FlightTrace | None,
    crash_reason: str,
    onboard: dict[str, Any],
    offboard: dict[str, Any] | None,
    radio: dict[str, dict[str, int]],
    invalid_reason: str = "",
) -> dict[str, Any]:
    """Return the content of summary.json.

    Parameters
    ----------
    mode: "realtime" or "lockstep".
    trace: None if the flight left no usable log.
    onboard: onboard's own summary: ticks, missed, tick_us, rss_mb, calibration, features, rejected.
    offboard: offboard's own summary; None without an offboard side.
    radio: sent, delivered, lost by direction.
    invalid_reason: why the flight says nothing about the vehicle; "" if it is valid.
    """
    metrics = flight_metrics(trace, config.onboard.guidance.trajectory) if trace is not None else None
    rejected = Counter(onboard.get("rejected", {}))
    rejected.update((offboard or {}).get("rejected", {}))
    summary: dict[str, Any] = {
        "scenario": config.scenario,
        "controller": config.controller,
        "seed": config.seed,
        "mode": mode,
        "duration_s": round(float(trace.time_s[-1]), 3) if trace is not None else 0.0,
        "outcome": "invalid" if invalid_reason else "lost" if crash_reason else "alive",
        "invalid_reason": invalid_reason,
        "survived": crash_reason == "",
        "crash_reason": crash_reason,
        "position_rmse_m": _number(metrics.position_rmse_m if metrics else math.nan),
        "attitude_rmse_rad": _number(metrics.attitude_rmse_rad if metrics else math.nan),
        "lap_rmse_m": [_number(value) for value in metrics.lap_rmse_m] if metrics else [],
        "first_lap_rmse_m": _number(metrics.first_lap_rmse_m if metrics else math.nan),
        "settled_rmse_m": _number(metrics.settled_rmse_m if metrics else math.nan),
        "features": onboard.get("features", {}),
        "training": {key: offboard[key] for key in _TRAINING if key in offboard} if offboard else {},
        "link": {**radio, "rejected": dict(rejected)},
        "onboard": {key: onboard[key] for key in _ONBOARD if key in onboard},
    }
    if trace is not None:
        summary["live_bound"] = {
            channel: {name: _number(value) for name, value in asdict(one).items()}
            for channel, one in bound_metrics(trace).items()
        }
        age = _number(median(known_ages(trace, "feature_age")))
        summary["features"] = {**summary["features"], "age_s_median": age}
    return summary


def _number(value: float) -> float | None:
    return round(float(value), 5) if math.isfinite(value) else None


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """Write summary.json, complete or not at all."""
    write_json(folder / "summary.json", summary)


def print_summary(summary: dict[str, Any], folder: Path | None, console: Console | None = None) -> None:
    """Print the summary as a short table; long lines are not broken, so that a file has them whole."""
    rows = summary_rows(summary)
    if folder is not None:
        rows.append(("record", str(folder)))
    width = max(len(name) for name, _ in rows)
    lines = [Text.assemble((f"{name:{width}}", "bold"), f"  {text}") for name, text in rows]
    console = console or Console()
    console.print(Text("\n").join([Text(_title(summary), "italic"), *lines]), soft_wrap=True)


def _title(summary: dict[str, Any]) -> str:
    return f"{summary['scenario']} · {summary['controller']} · seed {summary['seed']} · {summary['mode']}"


def summary_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the lines of the table: name and text."""
    outcome = "vehicle alive" if summary["survived"] else f"VEHICLE LOST: {summary['crash_reason']}"
    if summary["outcome"] == "invalid":
        outcome = f"INVALID FLIGHT: {summary['invalid_reason']}"
    attitude, features, onboard = summary["attitude_rmse_rad"], summary["features"], summary["onboard"]
    rows = [
        ("flight", f"{summary['duration_s']:.1f} s, {outcome}"),
        ("position RMSE", _metres(summary["position_rmse_m"]) + _laps(summary)),
        ("attitude RMSE", "-" if attitude is None else f"{math.degrees(attitude):.2f} deg"),
    ]
    if "version" in features:
        text = f"version {features['version']}, {features['swaps']} swaps, {features['refused']} refused"
        age = features.get("age_s_median")
        rows.append(("features", text if age is None else f"{text}, median age {age:.1f} s"))
    rows.extend(_training_rows(summary.get("training") or {}))
    rows.extend(_bound_rows(summary.get("live_bound") or {}))
    rows.extend(_link_rows(summary["link"]))
    if "tick_us" in onboard:
        tick = onboard["tick_us"]
        text = f"{onboard['ticks']} ticks, {onboard['missed']} missed, step p50 {tick['p50']:.0f} us, "
        text += f"p99 {tick['p99']:.0f} us, max {tick['max']:.0f} us, {onboard['rss_mb']:.0f} MB"
        rows.append(("onboard", text))
    rows.extend(("INCOMPLETE", fault) for fault in summary.get("record_faults", ()))
    return rows


def _training_rows(training: dict[str, Any]) -> list[tuple[str, str]]:
    rows = []
    if training.get("rounds"):
        rows.append(("training", f"{training['rounds']} rounds: {_counts(training.get('verdicts', {}))}"))
    unused = _counts(training.get("unused", {}))
    if unused:
        rows.append(("not learnt from", unused))
    return rows


def _counts(counts: dict[str, int]) -> str:
    """Return the counts that are not zero, largest first."""
    found = sorted(((count, name) for name, count in counts.items() if count), reverse=True)
    return ", ".join(f"{name.replace('_', ' ')} {count}" for count, name in found)


def _bound_rows(bounds: dict[str, dict[str, float | None]]) -> list[tuple[str, str]]:
    parts = []
    for channel, unit, factor in (("position", "mm", 1e3), ("attitude", "deg", math.degrees(1.0))):
        values = bounds.get(channel, {})
        bound, error, coverage = (values.get(name) for name in ("bound_median", "error_median", "coverage"))
        if bound is not None and error is not None and coverage is not None:
            sizes = f"{factor * bound:.1f} {unit} (error {factor * error:.1f})"
            parts.append(f"{channel} {sizes}, {100.0 * coverage:.1f} % covered")
    return [("live bound", f"{'; '.join(parts)}")] if parts else []


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f} m"


def _laps(summary: dict[str, Any]) -> str:
    laps = summary["lap_rmse_m"]
    if not laps:
        return ""
    first, settled = _metres(summary["first_lap_rmse_m"]), _metres(summary["settled_rmse_m"])
    return f" (first lap {first}, settled {settled}, {len(laps)} laps)"


def _link_rows(link: dict[str, Any]) -> list[tuple[str, str]]:
    rows = []
    for direction in ("up", "down"):
        if direction in link:
            counts = link[direction]
            share = 100.0 * counts["lost"] / counts["sent"] if counts["sent"] else 0.0
            rows.append((f"link {direction}", f"{counts['sent']} sent, {counts['lost']} lost ({share:.1f} %)"))
    refused = {reason: count for reason, count in link.get("rejected", {}).items() if count}
    if refused:
        rows.append(("rejected", ", ".join(f"{reason} {count}" for reason, count in sorted(refused.items()))))
    return rows
