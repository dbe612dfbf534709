"""The measurements of `dmrac bench`, one after the other.

A call takes several times longer once every 5 ms, with cold caches, than in a tight loop. So the step is measured in
both ways: the datagrams of a recorded flight are replayed into a new core at 200 Hz and back to back, with the log of a
flight. Wake-up jitter is measured in turns with a bare loop, because the machine causes most of it.
"""

import time
from collections.abc import Callable
from typing import Any, Final

from rich.table import Table

from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import FlightConfig
from experiments.timing.law_floor import law_floor_us
from experiments.timing.learning_speed import (
    BATCH_SIZE,
    BATCHES,
    CAPACITY,
    admission_ms,
    fleet_round_ms,
    training_round_ms,
)
from experiments.timing.start_up import start_onboard
from experiments.timing.step_timing import LAW, Quantiles, measure_step, record_flight
from experiments.timing.vehicle_speed import vehicle_speeds
from runtime.kernel import prepare_interpreter, request_realtime

Report = dict[str, Any]
FLEET: Final = 16
"""Vehicles that share the trainer in the time of their round."""


def measure(config: FlightConfig, seconds: float, show: Callable[[str | Table], None]) -> Report:
    """Measure everything and return the numbers.

    Parameters
    ----------
    seconds: flight time that is recorded and replayed.
    show: called with each result, a line or a table.
    """
    show(f"recording {seconds:g} s of {config.scenario} with {config.controller}, seed {config.seed} ...")
    recording = record_flight(config, seconds)
    start_up = start_onboard(config)
    show("; ".join(f"{grant}" for grant in request_realtime(config.onboard.realtime.priority)))
    prepare_interpreter()
    steps, lateness = measure_step(config, recording)
    show(step_table(steps, config.onboard.period_ns))
    show(lateness_table(lateness))
    law_us, floor_us = steps[LAW]["hot"][0], law_floor_us(config)
    ratio = f"{law_us / floor_us:.1f} x its bare numpy calls, {floor_us:.1f} us"
    show(f"control law of both channels, hot p50: {law_us:.1f} us, {ratio}")
    show(f"onboard process: ready after {start_up.ready_s:.2f} s, {start_up.rss_mb:.0f} MB ({start_up.granted})")
    vehicle = vehicle_speeds()
    show(f"simulated vehicle, steps/s: {'; '.join(f'{name} {rate:,.0f}' for name, rate in vehicle.items())}")
    learning = {"admission_ms": admission_ms()}
    try:
        learning["round_ms"] = training_round_ms(config)
        learning["fleet_round_ms"] = fleet_round_ms(config, FLEET)
        batches = f"{BATCHES} mini-batches of {BATCH_SIZE}"
        show(f"training round, {batches}: {learning['round_ms']:.0f} ms of a core")
        show(f"training round as configured, {FLEET} vehicles: {learning['fleet_round_ms']:.0f} ms of a core")
    except RuntimeError as nothing:
        show(f"training round: {nothing}")
    show(f"a sample into a full buffer of {CAPACITY}: {learning['admission_ms']:.2f} ms of a core")
    speed = {name: lockstep_speed(config, flag) for name, flag in (("without trainer", False), ("with trainer", True))}
    for name, multiple in speed.items():
        show(f"lockstep {name}: {multiple:.1f} x real time")
    return {
        "scenario": config.scenario,
        "controller": config.controller,
        "step_us": steps,
        "lateness_us": lateness,
        "law_hot_us": law_us,
        "law_floor_hot_us": floor_us,
        "start_s": start_up.ready_s,
        "rss_mb": start_up.rss_mb,
        "vehicle_steps_per_s": vehicle,
        "learning": learning,
        "lockstep": speed,
    }


def lockstep_speed(config: FlightConfig, with_offboard: bool) -> float:
    """Return the flight time per computing time of a lockstep flight."""
    start = time.perf_counter()
    outcome = fly_lockstep(config, with_offboard=with_offboard)
    return float(outcome.trace.time_s[-1]) / (time.perf_counter() - start)


def step_table(steps: dict[str, dict[str, Quantiles]], period_ns: int) -> Table:
    """Return a table of the blocks, with their share of the period."""
    title = f"onboard step, us of {period_ns / 1000:.0f}; share of paced p99"
    table = Table(title=title, box=None, pad_edge=False, title_justify="left")
    table.add_column("block", no_wrap=True)
    for way in ("paced", "hot"):
        for quantile in ("p50", "p99", "max"):
            table.add_column(f"{way} {quantile}", justify="right")
    table.add_column("share", justify="right")
    for name, ways in steps.items():
        numbers = [f"{value:.0f}" for way in ("paced", "hot") for value in ways[way]]
        table.add_row(name, *numbers, f"{100_000 * ways['paced'][1] / period_ns:.1f} %")
    return table


def lateness_table(lateness: dict[str, Quantiles]) -> Table:
    """Return a table of how late the loops woke up."""
    table = Table(title="wake-up lateness, us", box=None, pad_edge=False, title_justify="left")
    for name in ("loop", "p50", "p99", "max"):
        table.add_column(name, justify="left" if name == "loop" else "right")
    for name, values in lateness.items():
        table.add_row(name, *(f"{value:.0f}" for value in values))
    return table
