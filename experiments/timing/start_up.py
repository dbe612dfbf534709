"""Measures how long the real onboard process takes to its first tick, and its memory."""

import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from experiments.flights.realtime_flight import Child, process_command
from experiments.flights.scenario import FlightConfig
from runtime.errors import StartError

START_LIMIT_S: Final = 20.0


@dataclass(frozen=True, slots=True)
class StartUp:
    """The real onboard process, alone."""

    ready_s: float
    """From the start of the process to its first tick."""
    rss_mb: float
    granted: str
    """Its report of the real-time privileges it got."""


def start_onboard(config: FlightConfig) -> StartUp:
    """Start `python -m onboard`, let it tick for a second and end it.

    Raises
    ------
    StartError
        If it does not start.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        path = out / "config.yaml"
        path.write_text(config.to_yaml(), encoding="utf-8")
        start = time.monotonic()
        child = Child("onboard", process_command("onboard", path, out), out)
        events: list[str] = []
        while not child.ready and child.running and time.monotonic() < start + START_LIMIT_S:
            events += [str(entry["text"]) for entry in child.lines() if entry.get("kind") == "event"]
            time.sleep(0.002)
        ready_s = time.monotonic() - start
        if not child.ready:
            child.kill()
            raise StartError(f"onboard did not start: {child.last_error()}")
        time.sleep(1.0)
        child.end(5.0)
        child.tidy()
        summary = json.loads((out / "onboard_summary.json").read_text(encoding="utf-8"))
    return StartUp(ready_s, float(summary["rss_mb"]), events[0] if events else "")
