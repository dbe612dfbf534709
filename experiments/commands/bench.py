"""`dmrac bench`: how long an onboard step takes, block by block, how punctual the loop is, how fast lockstep runs.

A call costs several times more once every 5 ms, with cold caches, than in a tight loop, so the step is measured both
ways: replaying the datagrams of a recorded flight into a fresh core, at 200 Hz and back to back. Wake-up jitter is
measured beside a bare loop in the same run, in turns, because it is the machine's as much as ours.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table

from configs.loader import ConfigError
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.realtime_flight import Child
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, FlightConfig, resolve
from experiments.timing.step_timing import (
    BLOCKS,
    LAW,
    STEP,
    Recording,
    Replay,
    quantiles_us,
    record_flight,
    run_hot,
    run_paced,
)
from protocol.signals import SIGNAL_COUNT
from shell.errors import StartError
from shell.kernel import ask_for_realtime, quiet_interpreter

START_LIMIT_S: Final = 20.0
FLOOR_CALLS: Final = 3000
Report = dict[str, Any]


def law_floor_us(config: FlightConfig) -> float:
    """p50 of the numpy calls alone that the control law of both channels consists of, in a tight loop.

    Inputs are selected, scaled and limited; each layer is a product and a tanh; then W'Phi and the law's update. All
    on two columns, the present state and the one looked ahead to.
    """
    calls = [_bare_law(features) for features in _features_like(config)]
    durations = []
    for _ in range(FLOOR_CALLS):
        start = time.perf_counter_ns()
        for call in calls:
            call()
        durations.append(time.perf_counter_ns() - start)
    return quantiles_us(durations)[0]


def _features_like(config: FlightConfig) -> list[tuple[int, ...]]:
    """Widths of each learnt network: inputs, hidden layers, features without the constant."""
    network = config.offboard.network
    hidden = (*network.hidden, network.features - 1)
    return [(len(network.inputs(channel)), *hidden) for channel in network.channels]


def _bare_law(widths: tuple[int, ...]) -> Callable[[], None]:
    rng = np.random.default_rng(1)
    weights = [rng.normal(size=(after, before + 1)) for before, after in pairwise(widths)]
    levels = [np.ones((width + 1, 2)) for width in widths]
    layers = [(W, below, above[:-1]) for W, below, above in zip(weights, levels, levels[1:], strict=False)]
    inputs, signals, chosen = levels[0][:-1], rng.normal(size=(SIGNAL_COUNT, 2)), np.arange(widths[0])
    offset, scale, limit = (np.ones_like(inputs) for _ in range(3))
    last, update = rng.normal(size=(levels[-1].shape[0], 3)), np.empty((levels[-1].shape[0], 3))
    error, PB, direction = np.ones(6), np.ones((6, 3)), np.zeros(3)

    def call() -> None:
        z = signals.take(chosen, axis=0)
        np.subtract(z, offset, out=z)
        np.multiply(z, scale, out=z)
        np.minimum(z, limit, out=z)
        np.maximum(z, limit, out=z)
        inputs[:] = z
        for W, below, above in layers:
            np.dot(W, below, out=above)
            np.tanh(above, out=above)
        Phi = levels[-1].copy()
        now = Phi[:, 0]
        now.dot(now)
        error.dot(PB)
        now.dot(last)
        np.multiply(now[:, None], direction, out=update)
        np.add(last, update, out=last)
        np.vdot(last, last)
        np.dot(last.T, Phi)

    return call


@dataclass(frozen=True, slots=True)
class StartUp:
    """The real onboard process, alone, with nobody to talk to."""

    ready_s: float
    """From the start of the process to its first tick."""
    rss_mb: float
    said: str
    """What it was granted."""


def start_onboard(config: FlightConfig) -> StartUp:
    """Start `python -m onboard`, let it tick for a second and end it.

    Raises
    ------
    StartError
        If it does not come up.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        path = out / "config.yaml"
        path.write_text(config.to_yaml(), encoding="utf-8")
        start = time.monotonic()
        child = Child("onboard", path, out)
        said: list[str] = []
        while not child.ready and child.running and time.monotonic() < start + START_LIMIT_S:
            said += [str(entry["text"]) for entry in child.lines() if entry.get("kind") == "event"]
            time.sleep(0.002)
        ready_s = time.monotonic() - start
        if not child.ready:
            child.kill()
            raise StartError(f"onboard did not start: {child.said()}")
        time.sleep(1.0)
        child.end(5.0)
        child.tidy()
        summary = json.loads((out / "onboard_summary.json").read_text(encoding="utf-8"))
    return StartUp(ready_s, float(summary["rss_mb"]), said[0] if said else "")


def lockstep_speed(config: FlightConfig, with_offboard: bool) -> float:
    """Flight seconds per second of computing."""
    start = time.perf_counter()
    outcome = fly_lockstep(config, with_offboard=with_offboard)
    return float(outcome.trace.time_s[-1]) / (time.perf_counter() - start)


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
    console.print("; ".join(f"{grant}" for grant in ask_for_realtime(config.onboard.realtime.priority)))
    quiet_interpreter()
    steps, lateness = measure_step(config, recording)
    console.print(step_table(steps, config.onboard.period_ns))
    console.print(lateness_table(lateness))
    law_us, floor_us = steps[LAW]["hot"][0], law_floor_us(config)
    ratio = f"{law_us / floor_us:.1f} x its bare numpy calls, {floor_us:.1f} us"
    console.print(f"control law of both channels, hot p50: {law_us:.1f} us, {ratio}")
    console.print(f"onboard process: ready after {start_up.ready_s:.2f} s, {start_up.rss_mb:.0f} MB ({start_up.said})")
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
        "lockstep": speed,
    }


Quantiles = tuple[float, float, float]


def measure_step(
    config: FlightConfig, recording: Recording
) -> tuple[dict[str, dict[str, Quantiles]], dict[str, Quantiles]]:
    """us: {block: {paced, hot: (p50, p99, max)}} and the lateness of the loop and of the bare loop.

    The whole tick is timed without the blocks' stopwatches, which cost a few us themselves.
    """
    period_ns, spin_ns = config.onboard.period_ns, config.onboard.realtime.spin_us * 1000
    steps: dict[str, dict[str, Quantiles]] = {name: {} for name in (STEP, *(name for name, _ in BLOCKS), LAW)}
    lateness: dict[str, Quantiles] = {}
    for blocks in (False, True):
        hot, paced = Replay(config, recording, blocks), Replay(config, recording, blocks)
        run_hot(hot)
        ours, bare = run_paced(paced, period_ns, spin_ns)
        if not blocks:
            lateness = {"onboard loop": quantiles_us(ours), "bare loop": quantiles_us(bare)}
        for name in steps if blocks else (STEP,):
            if name != STEP or not blocks:
                steps[name] = {"paced": paced.watch.quantiles_us(name), "hot": hot.watch.quantiles_us(name)}
    return steps, lateness


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
