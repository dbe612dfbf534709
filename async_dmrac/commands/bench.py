"""`dmrac bench`: how long an onboard step takes, how punctual the loop is, how fast vehicle, trainer
and lockstep run.

A call costs several times more once every 5 ms, with cold caches, than in a tight loop, so the step is measured both
ways: replaying the datagrams of a recorded flight into a fresh core, at 200 Hz and back to back, its log written as in
flight. Wake-up jitter is measured beside a bare loop in the same run, in turns, because it is the machine's as much as
ours.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from configs.loader import ConfigError
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, FlightConfig, resolve
from experiments.timing.law_floor import law_floor_us
from experiments.timing.learning_speed import BATCH_SIZE, BATCHES, CAPACITY, admission_ms, training_round_ms
from experiments.timing.start_up import start_onboard
from experiments.timing.step_timing import LAW, Quantiles, measure_step, record_flight
from experiments.timing.vehicle_speed import vehicle_speeds
from runtime.kernel import prepare_interpreter, request_realtime

Report = dict[str, Any]


EXAMPLES: Final = """examples:
  dmrac bench
  dmrac bench figure8_wind --controller mrac --seconds 30 --json bench.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac bench`."""
    parser.add_argument("scenario", nargs="?", default=DEFAULT_SCENARIO, help="scenario to fly (default: %(default)s)")
    parser.add_argument("--controller", help="another controller than the scenario's")
    parser.add_argument("--seconds", type=float, default=15.0, help="flight time to measure, 2 to 600 s")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change the configuration")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers there as well")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print; returns the exit status (0, or 2 for a bad configuration)."""
    if not 2.0 <= arguments.seconds <= 600.0:
        print(f"--seconds {arguments.seconds:g}: allowed are 2 to 600", file=sys.stderr)
        return 2
    choices = Choices(arguments.controller, None, max(arguments.seconds, 5.0), tuple(arguments.set))
    try:
        config = resolve(arguments.scenario, choices)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    report = measure(config, arguments.seconds, Console(highlight=False, soft_wrap=True))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return 0


def measure(config: FlightConfig, seconds: float, console: Console) -> Report:
    """All measurements, printed as they come."""
    console.print(f"recording {seconds:g} s of {config.scenario} with {config.controller}, seed {config.seed} ...")
    recording = record_flight(config, seconds)
    start_up = start_onboard(config)
    console.print("; ".join(f"{grant}" for grant in request_realtime(config.onboard.realtime.priority)))
    prepare_interpreter()
    steps, lateness = measure_step(config, recording)
    console.print(step_table(steps, config.onboard.period_ns))
    console.print(lateness_table(lateness))
    law_us, floor_us = steps[LAW]["hot"][0], law_floor_us(config)
    ratio = f"{law_us / floor_us:.1f} x its bare numpy calls, {floor_us:.1f} us"
    console.print(f"control law of both channels, hot p50: {law_us:.1f} us, {ratio}")
    console.print(
        f"onboard process: ready after {start_up.ready_s:.2f} s, {start_up.rss_mb:.0f} MB ({start_up.granted})"
    )
    vehicle = vehicle_speeds()
    console.print(f"simulated vehicle, steps/s: {'; '.join(f'{name} {rate:,.0f}' for name, rate in vehicle.items())}")
    learning = {"admission_ms": admission_ms()}
    try:
        learning["round_ms"] = training_round_ms(config)
        console.print(
            f"training round, {BATCHES} mini-batches of {BATCH_SIZE}: {learning['round_ms']:.0f} ms of a core"
        )
    except RuntimeError as nothing:
        console.print(f"training round: {nothing}")
    console.print(f"a sample into a full buffer of {CAPACITY}: {learning['admission_ms']:.2f} ms of a core")
    speed = {name: lockstep_speed(config, flag) for name, flag in (("without trainer", False), ("with trainer", True))}
    for name, multiple in speed.items():
        console.print(f"lockstep {name}: {multiple:.1f} x real time")
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
    """Flight seconds per second of computing."""
    start = time.perf_counter()
    outcome = fly_lockstep(config, with_offboard=with_offboard)
    return float(outcome.trace.time_s[-1]) / (time.perf_counter() - start)


def step_table(steps: dict[str, dict[str, Quantiles]], period_ns: int) -> Table:
    """Block by block, with its share of the period."""
    table = Table(
        title=f"onboard step, us of {period_ns / 1000:.0f}; share of paced p99",
        box=None,
        pad_edge=False,
        title_justify="left",
    )
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
    """How late the loops woke."""
    table = Table(title="wake-up lateness, us", box=None, pad_edge=False, title_justify="left")
    for name in ("loop", "p50", "p99", "max"):
        table.add_column(name, justify="left" if name == "loop" else "right")
    for name, values in lateness.items():
        table.add_row(name, *(f"{value:.0f}" for value in values))
    return table
