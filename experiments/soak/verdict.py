"""Judges a soak by what it left: logs, summaries, memory, and what was done to whom and when."""

import json
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from experiments.flights.logged_flight import read_trace
from experiments.flights.metrics import flight_metrics, lost_target
from experiments.flights.trace import FlightTrace
from experiments.soak.schedule import Action
from experiments.soak.soak import SoakRun
from flight_log.reader import FlightError, Table, open_flight
from onboard.flight.modes import AIRBORNE, FlightMode

SLOPE_MAX_MB_MIN: Final = 0.2
AFTER_STOP_NS: Final = 100_000_000
"""A tick that is missed so soon after a stop of onboard is the stop's."""
WAITED_SHARE: Final = 0.5
"""Missed ticks are explained if onboard had no processor for this share of their time."""
SWAP_EVENT: Final = re.compile(r"features \d+ ")
STOPPED = "stopped by the soak"
WAITED = "had no processor"
SWAPPED = "a version was taken over or refused"
UNEXPLAINED = "unexplained"


@dataclass(frozen=True, slots=True)
class Memory:
    """The memory of the longest life of a process."""

    process: str
    lives: int
    seconds: float
    first_mb: float
    last_mb: float
    slope_mb_min: float
    """NaN if the life was too short to tell."""

    @property
    def good(self) -> bool:
        """Whether the slope is known and within the limit."""
        return self.slope_mb_min <= SLOPE_MAX_MB_MIN


@dataclass(frozen=True, slots=True)
class TickGap:
    """A gap in which onboard missed ticks."""

    at_s: float
    """Flight time."""
    missed: int
    gap_ms: float
    """Between the two ticks."""
    waited_ms: float
    """For which onboard had no processor: its threads waited for one, or the gap is longer than they computed."""
    own_ms: float
    """For which the loop's own thread computed, in the two ticks."""
    page_faults: int
    """Of the loop's own thread, in the two ticks."""
    why: str
    """STOPPED, WAITED, SWAPPED or UNEXPLAINED."""


@dataclass(frozen=True)
class Verdict:
    """What a soak has shown."""

    minutes: float
    """Flown."""
    alive: bool
    why_lost: str
    ticks: int
    gaps: list[TickGap]
    escapes: dict[str, int]
    """By process."""
    memory: list[Memory]
    modes_s: dict[str, float]
    """Time in each flight mode."""
    position_rmse_m: float
    versions: int
    """Feature version in use at the end."""
    faults: list[str]

    @property
    def missed(self) -> dict[str, int]:
        """Missed ticks by explanation."""
        found: Counter[str] = Counter()
        for gap in self.gaps:
            found[gap.why] += gap.missed
        return dict(found)

    @property
    def failures(self) -> list[str]:
        """What was not as promised, one line each; empty if all was."""
        found = [] if self.alive else [f"vehicle lost: {self.why_lost}"]
        if self.missed.get(UNEXPLAINED):
            found.append(f"{self.missed[UNEXPLAINED]} missed ticks without explanation")
        found += [f"{count} escapes in {name}" for name, count in self.escapes.items() if count]
        for one in self.memory:
            if one.slope_mb_min > SLOPE_MAX_MB_MIN:
                found.append(f"memory of {one.process} grows by {one.slope_mb_min:.2f} MB/min")
        return found + self.faults


def judge(run: SoakRun, out: Path) -> Verdict:
    """Judge a soak whose record is in `out`."""
    onboard, sim, offboard = (_summary(out, name) for name in ("onboard", "sim", "offboard"))
    trace = read_trace(out)
    why = str(sim.get("crash_reason", "the vehicle left no summary"))
    if not onboard:
        why = why or "onboard left no summary"
    why = why or (fallen(run, trace) if trace is not None else "no log of the flight")
    rmse = flight_metrics(trace, run.config.onboard.guidance.trajectory).position_rmse_m if trace else float("nan")
    return Verdict(
        minutes=float(sim.get("duration_s", 0.0)) / 60.0,
        alive=not why,
        why_lost=why,
        ticks=int(onboard.get("ticks", 0)),
        gaps=gaps_of(run, *_ticks(out), run.config.onboard.period_ns),
        escapes={"onboard": int(onboard.get("escapes", 0)), "offboard": int(offboard.get("escapes", 0))},
        memory=memories(run),
        modes_s=_modes(trace),
        position_rmse_m=float(rmse),
        versions=int(onboard.get("features", {}).get("version", 0)),
        faults=run.faults,
    )


def fallen(run: SoakRun, trace: FlightTrace) -> str:
    """How the vehicle left the air before its time, or its target; "" if it did not, or was asked to land."""
    landing_s = run.config.onboard.guidance.land_after_s
    aloft = trace.time_s[np.isin(trace.mode, [mode.value for mode in AIRBORNE])]
    last_s = float(aloft[-1]) if aloft.size else 0.0
    if last_s < landing_s and not run.interrupted:
        return f"on the floor after {last_s:.1f} s, and was to fly for {landing_s:.1f} s"
    return lost_target(trace)


def gaps_of(
    run: SoakRun, loop: Table | None, swaps_ns: Sequence[int] = (), period_ns: int = 5_000_000
) -> list[TickGap]:
    """Every gap in which ticks were missed, with its explanation.

    Parameters
    ----------
    loop: records of onboard's life in the air; ticks are missed between two of them.
    swaps_ns: the ticks in which a feature version was tested.
    """
    if loop is None:
        return []
    times, new = loop.time_ns, np.diff(loop["missed"])
    at = np.flatnonzero(new > 0)
    begins_ns, ends_ns = times[at], times[at + 1]
    computed_ns = 1e3 * (loop["computed"][at] + loop["computed"][at + 1])
    idle_ns = ends_ns - begins_ns - np.maximum(computed_ns, period_ns)
    waited_ns = np.maximum(run.waits.between(begins_ns - period_ns, ends_ns), idle_ns)
    own_us, faults = (loop[name][at] + loop[name][at + 1] for name in ("own", "faults"))
    found = []
    for count, begin, end, waited, own, faulted in zip(
        new[at], begins_ns, ends_ns, waited_ns, 1e-3 * own_us, faults, strict=True
    ):
        why = SWAPPED if np.isin(begin, swaps_ns) else UNEXPLAINED
        why = WAITED if waited >= WAITED_SHARE * count * period_ns else why
        why = STOPPED if _stopped(run, begin, end) else why
        begin_s = (begin - run.begin_ns) * 1e-9
        times_ms = float((end - begin) * 1e-6), float(waited * 1e-6), float(own)
        found.append(TickGap(float(begin_s), int(count), *times_ms, int(faulted), why))
    return found


def _stopped(run: SoakRun, begin_ns: int, end_ns: int) -> bool:
    """Whether onboard was stopped in a span, or shortly before."""
    stops = [one for one in run.done if one.disruption.action is Action.STOP and one.disruption.target == "onboard"]
    return any(one.begin_ns <= end_ns and begin_ns <= one.end_ns + AFTER_STOP_NS for one in stops)


def memories(run: SoakRun) -> list[Memory]:
    """The memory of each process, of its longest life."""
    found = []
    for name in dict.fromkeys(life.name for life in run.lives):
        lives = [life for life in run.lives if life.name == name and life.memory_mb]
        if lives:
            life = max(lives, key=lambda one: one.seconds)
            ends = life.memory_mb[0], life.memory_mb[-1]
            found.append(Memory(name, len(lives), life.seconds, *ends, life.slope_mb_min()))
    return found


def _modes(trace: FlightTrace | None) -> dict[str, float]:
    if trace is None:
        return {}
    modes, counts = np.unique(trace.mode, return_counts=True)
    step_s = float(np.median(np.diff(trace.time_s)))
    return {FlightMode(int(mode)).name: float(count) * step_s for mode, count in zip(modes, counts, strict=True)}


def _ticks(out: Path) -> tuple[Table | None, list[int]]:
    """The records of onboard's loop in the air, and the times of the ticks that tested a version."""
    try:
        flight = open_flight(out / "onboard_2.mcap")
    except FlightError:
        return None, []
    return flight.get("onboard/loop"), [one.time_ns for one in flight.events if SWAP_EVENT.match(one.text)]


def _summary(out: Path, name: str) -> dict[str, Any]:
    try:
        found = json.loads((out / f"{name}_summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def spans(run: SoakRun) -> NDArray[np.float64]:
    """[n, 2]: begin and end of every disruption, flight time, s."""
    ends = [(one.begin_ns, one.end_ns or one.begin_ns) for one in run.done]
    return (np.array(ends, dtype=np.float64).reshape(-1, 2) - run.begin_ns) * 1e-9
