"""The measurements of `dmrac bench core`: the core in C beside numpy's, and what it makes of lockstep and campaigns.

All of them in one run on one machine, so that the ratios hold whatever else it does. Speeds are those of the best of a
few runs, which the rest of the machine disturbed least.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, Final

from experiments.campaigns.campaign import CampaignConfig, Case, Seeds
from experiments.campaigns.runner import CampaignRun, Progress, open_store, prepare_folder, run_campaign
from experiments.campaigns.store import read_table
from experiments.campaigns.worker_pools import LocalPool
from experiments.flights.lockstep_flight import ONBOARD_SESSION, build, fly_lockstep
from experiments.flights.scenario import Choices, FlightConfig, resolve
from experiments.flights.training_worker import training_for
from experiments.timing import rotorpy_loop
from experiments.timing.both_cores import INSIDE, measure_cores
from experiments.timing.step_timing import Stopwatch, record_flight
from offboard.training.job import TrainingResult
from onboard.core import OnboardCore
from onboard.cores import NUMPY
from sim_vehicle.lockstep import Training, train_at_once

SCENARIO: Final = "figure8_wind"
LEARNER: Final = "dmrac"
FIXED: Final = "l1"
"""The controller of flights without trainer; offboard relays its poses."""
SEED: Final = 3
RUNS: Final = 3
JOBS: Final = 2
FLIGHTS_PER_JOB: Final = 8
CAMPAIGN_FLIGHT_S: Final = 20.0
VEHICLES: Final = (1, 4, 16, 64)
FLEET_TICKS: Final = 200
"""Measured ticks of each vehicle of a fleet."""

TICK_US_MAX: Final = 30.0
TICK_RATIO_MAX: Final = 1.0 / 15.0
LOCKSTEP_MIN: Final = 40.0
OVER_ROTORPY_MIN: Final = 20.0
WITH_TRAINER_MIN: Final = 7.0
FLIGHTS_PER_S_MIN: Final = 4.0
VEHICLE_RATIO_MAX: Final = 1.25
"""Cost of a vehicle among the most against that of a single one: linear, but for the caches."""


@dataclass(frozen=True)
class Figure:
    """One measured number, and its target."""

    name: str
    value: float | None
    """None: not measured; `note` says why."""
    unit: str
    target: float | None = None
    at_most: bool = True
    """Whether the target is the largest value that is good; else the smallest."""
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without a value or a target."""
        if self.value is None or self.target is None:
            return None
        return self.value <= self.target if self.at_most else self.value >= self.target

    def as_json(self) -> dict[str, Any]:
        """For JSON: its members, and `met`."""
        return asdict(self) | {"met": self.met}

    def text(self) -> str:
        """One line."""
        if self.value is None:
            return f"{self.name}: not measured ({self.note})"
        line = f"{self.name}: {self.value:.3g} {self.unit}".rstrip()
        if self.target is not None:
            bound = "at most" if self.at_most else "at least"
            line += f" (target {bound} {self.target:.3g}: {'met' if self.met else 'MISSED'})"
        return line + (f"; {self.note}" if self.note else "")


def measure(seconds: float, vehicles: int, show: Callable[[str], None]) -> list[Figure]:
    """Measure everything; returns the figures.

    Parameters
    ----------
    seconds: flight time of each lockstep flight.
    vehicles: most vehicles in one process.
    show: called with each figure's line.

    Raises
    ------
    ConfigError
        If the C core cannot be built.
    """
    figures: list[Figure] = []

    def note(*measured: Figure) -> None:
        figures.extend(measured)
        for one in measured:
            show(one.text())

    note(*tick_figures())
    note(*lockstep_figures(seconds))
    note(campaign_figure())
    note(*vehicle_figures([count for count in VEHICLES if count < vehicles] + [vehicles]))
    return figures


def tick_figures(seconds: float = 7.0, rounds: int = 3) -> list[Figure]:
    """The p50 of a tick of each core, and of the part of it that is in C, on the datagrams of one flight."""
    spent = {name: quantiles[0] for name, quantiles in measure_cores(LEARNER, seconds, rounds).items()}
    apart = numpy_without_mavlink_us(seconds)
    inside = spent[INSIDE]
    return [
        Figure(f"tick of the C core ({LEARNER}), p50", spent["c"], "us", note="with MAVLink and telemetry in Python"),
        Figure("the calls of C in it, p50", inside, "us", TICK_US_MAX),
        Figure("the same part of numpy's core, p50", apart, "us"),
        Figure("calls of C / the same part of numpy's core", inside / apart, "", TICK_RATIO_MAX),
        Figure("tick of the C core / tick of numpy's core", spent["c"] / spent[NUMPY], ""),
    ]


def numpy_without_mavlink_us(seconds: float) -> float:
    """p50 of numpy's tick, us, without what is Python beside the C core too: MAVLink, telemetry, arming checks."""
    config = resolve(SCENARIO, Choices(LEARNER, SEED, seconds + 5.0))
    recording = record_flight(config, seconds)
    core: Any = OnboardCore(config.onboard, ONBOARD_SESSION, None)
    watch, whole, part = Stopwatch(), "whole", "MAVLink and checks"
    watch.expect(part)
    for owner, methods in (
        (core._vehicle_link, ("receive", "encode_motors")),
        (core._ground_link, ("poll",)),
        (core._arming, ("refusal", "receive_pose")),
    ):
        for method in methods:
            _add(watch, owner, method, part)
    watch.wrap(core, "tick", whole)
    for index, now_ns in enumerate(recording.now_ns):
        core.tick(now_ns, recording.vehicle[index], recording.offboard[index])
        watch.end_tick()
    differences = sorted(
        all_ns - part_ns for all_ns, part_ns in zip(watch.ticks[whole], watch.ticks[part], strict=True)
    )
    return differences[len(differences) // 2] * 1e-3


def _add(watch: Stopwatch, owner: object, method: str, name: str) -> None:
    """Count the calls of a method into a sum that others count into as well."""
    kept = watch.ticks[name]
    watch.wrap(owner, method, name)
    watch.ticks[name] = kept


def lockstep_figures(seconds: float) -> list[Figure]:
    """How many times faster than real time lockstep is, and against RotorPy's own loop."""
    fixed, learner = (resolve(SCENARIO, Choices(name, SEED, seconds)) for name in (FIXED, LEARNER))
    plain, alone = _best(lambda: lockstep_speed(fixed, "c"))
    numpys, numpys_alone = _best(lambda: lockstep_speed(fixed, NUMPY))
    name = f"lockstep without trainer ({FIXED}), C core"
    figures = [
        Figure(name, plain, "x real time", LOCKSTEP_MIN, at_most=False, note=_alone(alone)),
        Figure("the same, numpy's core", numpys, "x real time", note=_alone(numpys_alone)),
    ]
    name = "lockstep without trainer / RotorPy's own loop"
    if rotorpy_loop.is_installed():
        peer = max(rotorpy_loop.rotorpy_speed(seconds) for _ in range(RUNS))
        figures.append(Figure("RotorPy's own loop at 200 Hz", peer, "x real time"))
        figures.append(Figure(name, plain / peer, "", OVER_ROTORPY_MIN, at_most=False))
    else:
        absent = "RotorPy is not installed: extra `rotorpy`"
        figures.append(Figure(name, None, "", OVER_ROTORPY_MIN, at_most=False, note=absent))
    with training_for(learner) as train:  # its process is ready before the second flight
        speed, alone = _best(lambda: lockstep_speed(learner, "c", train))
    name = f"lockstep with trainer ({LEARNER}), C core"
    note = f"{alone:.3g} by processor time of the flight, whose rounds of training another process runs"
    return [*figures, Figure(name, speed, "x real time", WITH_TRAINER_MIN, at_most=False, note=note)]


def _alone(speed: float) -> str:
    return f"{speed:.3g} by processor time: what a machine without other work gives"


def _best(speed: Callable[[], tuple[float, float]]) -> tuple[float, float]:
    by_wall, by_processor = zip(*(speed() for _ in range(RUNS)), strict=True)
    return max(by_wall), max(by_processor)


def lockstep_speed(
    config: FlightConfig, core: str, train: Training[TrainingResult] = train_at_once
) -> tuple[float, float]:
    """Return the flight time of a lockstep flight per wall time, and per processor time of this process.

    Its start and its end are included.
    """
    start, used = time.perf_counter(), time.process_time()
    outcome = fly_lockstep(config, core=core, train=train)
    flown_s = float(outcome.trace.time_s[-1])
    return flown_s / (time.perf_counter() - start), flown_s / (time.process_time() - used)


def campaign_figure(jobs: int = JOBS, flights_per_job: int = FLIGHTS_PER_JOB) -> Figure:
    """Flights per second of a campaign on `jobs` cores, after every worker's first flight, which loads the program."""
    count = jobs * flights_per_job
    case = Case(name="wind", scenario=SCENARIO, duration_s=CAMPAIGN_FLIGHT_S)
    campaign = CampaignConfig(
        description="For dmrac bench core.", controllers=(FIXED,), cases=(case,), seeds=Seeds(count=count)
    )
    landed: list[float] = []

    def report(progress: Progress) -> None:
        if progress.flown:
            landed.append(time.perf_counter())

    with TemporaryDirectory(prefix="dmrac_bench_") as folder:
        run = CampaignRun(campaign, "bench", Path(folder) / "campaign", core="c")
        prepare_folder(run, resume=False)
        with open_store(run.folder) as store:
            result = run_campaign(run, store, LocalPool(jobs), report)
        used_s = read_table(run.folder)["cpu_s"].to_pylist()
    if result.errors:
        return Figure(_campaign_name(jobs), None, "flights/s", note=f"{result.errors} flights failed")
    rate = (count - 2 * jobs) / (landed[-1] - landed[2 * jobs - 1])
    alone = _alone(jobs / median(used_s))
    return Figure(_campaign_name(jobs), rate, "flights/s", FLIGHTS_PER_S_MIN, at_most=False, note=alone)


def _campaign_name(jobs: int) -> str:
    return f"campaign of {CAMPAIGN_FLIGHT_S:g} s flights without trainer ({FIXED}) on {jobs} cores"


def vehicle_figures(counts: list[int], ticks: int = FLEET_TICKS) -> list[Figure]:
    """The cost of a tick of a vehicle among so many in one process, each with its C core; they take turns."""
    costs = [vehicle_cost_us(count, ticks) for count in counts]
    figures = [
        Figure(f"tick of a whole vehicle among {count} in one process", cost, "us")
        for count, cost in zip(counts, costs, strict=True)
    ]
    name = f"the same, {counts[-1]} vehicles / {counts[0]}"
    return [*figures, Figure(name, costs[-1] / costs[0], "", VEHICLE_RATIO_MAX)]


def vehicle_cost_us(count: int, ticks: int = FLEET_TICKS) -> float:
    """Return the wall time, us, of a tick of one of `count` lockstep flights that take turns, in the best part."""
    flights = [build(resolve(SCENARIO, Choices(FIXED, SEED + number, 60.0)), core="c")[0] for number in range(count)]
    best_s = float("inf")
    for _ in range(RUNS + 1):  # the first part counts as well: the best one is taken
        start = time.perf_counter()
        for _ in range(ticks):
            for flight in flights:
                flight.step()
        best_s = min(best_s, time.perf_counter() - start)
    return best_s / (ticks * count) * 1e6
