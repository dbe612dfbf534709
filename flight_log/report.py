"""The report of a flight, one HTML page: summary, figures, training, events, logs, repeat command, configuration."""

import shlex
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from configs.loader import ConfigError, parse_yaml
from flight_log.html import code, details, image, page, paragraph, section, table, values_table
from flight_log.inspect import check
from flight_log.log_file import FlightError
from flight_log.reader import TICK_TOPIC, Flight, Table, open_flight

REPORT_NAME: Final = "report.html"
TRAINING_ROUNDS_MAX: Final = 40
EVENTS_MAX: Final = 500


def write_report(folder: Path, path: Path | None = None) -> Path:
    """Write the report, by default to `folder/report.html`; returns its path. Figures are the PNG files of the folder.

    Raises
    ------
    FlightError
        If the folder does not contain a readable flight.
    OSError
        If the page cannot be written.
    """
    if not folder.is_dir():
        raise FlightError(f"{folder}: {'not a flight folder' if folder.exists() else 'no such flight'}")
    flight = open_flight(folder)
    path = path or folder / REPORT_NAME
    path.write_text(build_report(flight), encoding="utf-8")
    return path


def build_report(flight: Flight) -> str:
    """The report as HTML."""
    summary = flight.summary
    return page(
        title_of(flight),
        [
            _outcome(summary),
            section("Summary", values_table(summary_rows(summary))),
            section("Figures", *(image(file.read_bytes(), file.stem) for file in sorted(flight.path.glob("*.png")))),
            section("Training", _training(flight.get("offboard/training"))),
            section("Events", _events(flight)),
            section("Logs", _logs(flight)),
            section("Repeat", code(repeat_command(flight)) if summary else ""),
            section("Configuration", *_configs(flight)),
        ],
    )


def title_of(flight: Flight) -> str:
    """Title of a flight: scenario, controller and seed, or the name of its folder."""
    summary = flight.summary
    if not summary:
        return flight.path.resolve().name
    return f"{summary.get('scenario', '?')}, {summary.get('controller', '?')}, seed {summary.get('seed', '?')}"


def summary_rows(summary: Mapping[str, Any], prefix: str = "") -> list[list[str]]:
    """Name and value of every entry of the flight summary except `command`; nested names are joined by dots."""
    rows: list[list[str]] = []
    for key, value in summary.items():
        name = f"{prefix}{key}"
        if name == "command":
            continue
        if isinstance(value, Mapping):
            rows += summary_rows(value, f"{name}.")
        elif isinstance(value, list | tuple) and value:
            rows.append([name, ", ".join(text_of(entry) for entry in value)])
        elif value not in ("", []):
            rows.append([name, text_of(value)])
    return rows


def text_of(value: Any) -> str:
    """A value of the flight summary as text; floats with five digits."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.5g}"
    return str(value)


def repeat_command(flight: Flight) -> str:
    """The command that flies this flight again."""
    summary = flight.summary
    if summary.get("command"):
        return str(summary["command"])
    words = ["scripts/fly", str(summary.get("scenario", ""))]
    words += ["--controller", str(summary.get("controller", "")), "--seed", str(summary.get("seed", ""))]
    duration_s = _configured_duration_s(flight)
    if duration_s:
        words += ["--duration", f"{duration_s:g}"]
    if summary.get("mode") == "lockstep":
        words.append("--lockstep")
    return shlex.join(words)


def _configured_duration_s(flight: Flight) -> float:
    """The configured duration, s; 0 if no configuration states it."""
    for attachments in flight.attachments.values():
        for data in attachments.values():
            with suppress(ConfigError, ValueError):
                tree = parse_yaml(data.decode(), "")
                if isinstance(tree, dict) and isinstance(tree.get("duration_s"), int | float):
                    return float(tree["duration_s"])
    return 0.0


def _outcome(summary: Mapping[str, Any]) -> str:
    if not summary:
        return paragraph("no flight summary (summary.json): the flight did not end in order", "bad")
    if summary.get("outcome") == "invalid":
        return paragraph(f"invalid flight: {summary.get('invalid_reason')}", "bad")
    if summary.get("survived"):
        return paragraph(f"vehicle alive after {text_of(summary.get('duration_s'))} s, {summary.get('mode')}", "good")
    return paragraph(f"vehicle lost: {summary.get('crash_reason') or 'no reason recorded'}", "bad")


def _training(training: Table | None) -> str:
    """The rounds of training, at most TRAINING_ROUNDS_MAX of them."""
    if training is None or len(training) == 0:
        return ""
    shown = np.unique(np.linspace(0, len(training) - 1, TRAINING_ROUNDS_MAX).astype(int))
    names = [name for name in training.names if np.isfinite(training[name]).any()]
    rows = [[f"{training[name][i]:.4g}" for name in names] for i in shown]
    return details(f"{len(shown)} of {len(training)} rounds", table(rows, names))


def _events(flight: Flight) -> str:
    if not flight.events:
        return ""
    events = flight.events[:EVENTS_MAX]
    rows = [[f"{(e.time_ns - flight.start_ns) * 1e-9:.3f}", e.process, e.text] for e in events]
    more = len(flight.events) - len(events)
    zero = paragraph("t = 0 is onboard's first tick" if TICK_TOPIC in flight else "t = 0 is the first record", "quiet")
    return zero + table(rows, ("t [s]", "process", "event")) + paragraph(f"and {more} more" if more else "", "quiet")


def _logs(flight: Flight) -> str:
    faults = check(flight)
    state = "".join(paragraph(fault, "bad") for fault in faults) or paragraph("complete, without gaps", "good")
    rows = [[t.topic, str(len(t)), str(len(t.names))] for t in flight]
    metadata = "\n\n".join(
        f"{process}\n" + "\n".join(f"  {key}: {value}" for key, value in values.items())
        for process, values in flight.metadata.items()
    )
    return state + table(rows, ("topic", "records", "columns")) + details("versions and clocks", code(metadata))


def _configs(flight: Flight) -> list[str]:
    """Each attached configuration once; processes attach the same one."""
    found: dict[bytes, list[str]] = {}
    for process, attachments in flight.attachments.items():
        for name, data in attachments.items():
            found.setdefault(data, []).append(f"{process}: {name}")
    return [details(", ".join(names), code(data.decode(errors="replace"))) for data, names in found.items()]
