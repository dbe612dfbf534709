"""Flies dropout traces in lockstep, one flight each, and returns the rows of a table."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from typing import Final

from experiments.campaigns.worker_pools import LocalPool
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve, with_pose_wait
from experiments.link.dropout_trace import load_trace, trace_names
from experiments.replays.replay import figures

PERFECT: Final = "perfect"
"""Name of the row without dropouts."""
HEADINGS: Final = (
    "trace",
    "lost up",
    "lost down",
    "longest gap up",
    "longest gap down",
    "RMSE",
    "feature age, median",
    "survived",
)


@dataclass(frozen=True)
class DropoutFlight:
    """One flight with a dropout trace."""

    trace: str
    """Name in configs/dropouts, file, or PERFECT."""
    scenario: str
    choices: Choices


@dataclass(frozen=True)
class DropoutRow:
    """The result of one flight."""

    trace: str
    description: str
    lost_up: float
    """Lost / sent."""
    lost_down: float
    gap_up_s: float
    gap_down_s: float
    position_rmse_m: float
    feature_age_s: float
    """Median on the path; NaN if no trained features were used."""
    survived: bool
    crash_reason: str

    def cells(self) -> tuple[str, ...]:
        """Return the row as text, in the order of HEADINGS."""
        return (
            self.trace,
            f"{self.lost_up:.1%}",
            f"{self.lost_down:.1%}",
            f"{self.gap_up_s:.2f} s",
            f"{self.gap_down_s:.2f} s",
            f"{100 * self.position_rmse_m:.1f} cm",
            "none" if math.isnan(self.feature_age_s) else f"{self.feature_age_s:.1f} s",
            "yes" if self.survived else f"no: {self.crash_reason}",
        )


def flights_with(traces: Sequence[str], scenario: str, choices: Choices) -> list[DropoutFlight]:
    """Return a flight for the perfect link and for each trace (all shipped ones if none are named).

    Raises
    ------
    ConfigError
        If a trace, the scenario or one of the choices cannot be used.
    """
    resolve(scenario, choices)
    names = traces or trace_names()
    for name in names:
        load_trace(name)
    return [DropoutFlight(name, scenario, choices) for name in (PERFECT, *names)]


def fly_one(job: DropoutFlight) -> DropoutRow:
    """Fly with one trace. Raises ConfigError."""
    config = with_pose_wait(resolve(job.scenario, job.choices))
    if job.trace == PERFECT:
        name, description, radio, deliveries = PERFECT, "Nothing is lost, nothing is late.", None, None
    else:
        trace = load_trace(job.trace)
        name, description, radio, deliveries = trace.name, trace.description, trace.radio, trace.deliveries
    config = config.model_copy(update={"radio": radio or type(config.radio)()})
    outcome = fly_lockstep(config, recorded=deliveries)
    found = figures(config, outcome.trace, outcome.crash_reason, outcome.deliveries)
    up, down = found.link["up"], found.link["down"]
    return DropoutRow(
        name,
        description,
        up.lost_share,
        down.lost_share,
        up.longest_gap_s,
        down.longest_gap_s,
        found.position_rmse_m,
        found.feature_age_median_s,
        found.survived,
        found.crash_reason,
    )


def fly_all(
    jobs: Sequence[DropoutFlight], workers: int, report: Callable[[DropoutRow], None] = lambda row: None
) -> list[DropoutRow]:
    """Fly side by side, in processes of their own; return the rows in the order of `jobs`.

    Parameters
    ----------
    report: called with each row when its flight is done.

    Raises
    ------
    ConfigError
        If a trace, the scenario or the controller cannot be used.
    """
    pool = LocalPool(workers)
    try:
        executor = pool.open()
        futures = {executor.submit(fly_one, job): number for number, job in enumerate(jobs)}
        rows: dict[int, DropoutRow] = {}
        for future in as_completed(futures):
            rows[futures[future]] = future.result()
            report(rows[futures[future]])
    finally:
        pool.close()
    return [rows[number] for number in range(len(jobs))]
