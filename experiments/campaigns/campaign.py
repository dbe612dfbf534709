"""Campaigns: cases x controllers x sweeps x seeds, and the flights they unfold into.

A campaign file names scenarios and lays assignments over them by path, as `dmrac fly --set` does. Every controller
flies the same seeds, and what is drawn at random for a seed (onset, rotor, severity) is the same for all of them.
"""

import itertools
import json
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from configs.flight_tree import read_scenario
from configs.loader import CONFIG_DIRECTORY, ConfigError, ConfigRecord, load
from configs.vehicle import read_vehicle

DRAW_STREAM = 401
VEHICLE_ROOT = "vehicle."
PRESENTATION = (
    "title",
    "description",
    "seeds",
    "quick_seeds",
    "compare_to",
    "same_conditions",
    "metrics",
    "targets",
    "figures",
    "traces",
)
"""Keys of a campaign that change no flight."""
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w.+-]*$")]
Assignments = dict[str, Any]
"""Value by path on the resolved tree."""


class Draw(ConfigRecord):
    """A value drawn anew for each seed, the same for all controllers."""

    path: str
    uniform: tuple[float, float] | None = None
    """Low and high."""
    choice: tuple[Any, ...] | None = None
    """One of these, all equally likely."""
    range: Literal["vehicle"] | None = None
    """The range that the vehicle's file gives for the value at `path`, which starts with `vehicle.`."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if [self.uniform, self.choice, self.range].count(None) != 2:
            raise ValueError("give one of uniform, choice and range")
        if self.range is not None and not self.path.startswith(VEHICLE_ROOT):
            raise ValueError(f"path: {self.path!r}: expected one that starts with {VEHICLE_ROOT}, as range is given")
        return self

    def value(self, rng: np.random.Generator, scenario: str) -> Any:
        """The value for one seed. Raises ConfigError if the scenario's vehicle has no such range."""
        if self.choice is not None:
            return self.choice[int(rng.integers(len(self.choice)))]
        if self.uniform is not None:
            return round(float(rng.uniform(*self.uniform)), 6)
        vehicle = read_vehicle(read_scenario(scenario).vehicle)
        return vehicle.drawn(self.path.removeprefix(VEHICLE_ROOT), float(rng.uniform()))


class Case(ConfigRecord):
    """A scenario with what is laid over it."""

    name: Name
    label: str = ""
    """For tables and figures; empty: the name."""
    scenario: str
    duration_s: Annotated[float, Field(ge=5, le=3600)] | None = None
    set: Assignments = Field(default_factory=dict)
    draws: tuple[Draw, ...] = ()
    controllers: tuple[str, ...] = ()
    """Empty: the campaign's."""
    experience: Name | None = None
    """The case whose flight, with the same controller and seed, is flown first and hands on what it learnt."""
    experience_controller: str | None = None
    """The controller that flies the other case; left out: the same one."""
    swept: bool = True
    """False: flown once, not at every point of the sweeps."""
    keep_experience: bool = False
    """Keep what each flight learnt, in the folder's experience/."""


class Sweep(ConfigRecord):
    """One axis: either `path` and `values`, or named points that each assign several values."""

    name: Name
    label: str = ""
    """Axis label with unit; empty: the name."""
    path: str = ""
    values: tuple[Any, ...] = ()
    points: dict[str, Assignments] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if bool(self.points) == bool(self.path and self.values):
            raise ValueError("give either path and values, or points")
        return self

    def steps(self) -> list[tuple[Any, Assignments]]:
        """(value or name of the point, what it assigns)."""
        if self.points:
            return list(self.points.items())
        return [(value, {self.path: value}) for value in self.values]


class Seeds(ConfigRecord):
    """Seeds of a campaign. 0 to 999 are for tuning, evaluation starts at 1000."""

    first: Annotated[int, Field(ge=0)] = 1000
    count: Annotated[int, Field(ge=1, le=100_000)]


class Flown(ConfigRecord):
    """Names a group of flights: a case, a controller, and where in the sweeps."""

    case: str
    controller: str
    point: dict[str, Any] = Field(default_factory=dict)


class Target(ConfigRecord):
    """A ratio that is to be reached: median of ours / theirs, paired by seed."""

    label: str
    ours: Flown
    theirs: Flown
    metric: str
    at_most: float


class CampaignConfig(ConfigRecord):
    """A campaign file."""

    description: str
    title: str = ""
    controllers: tuple[str, ...] = Field(min_length=1)
    cases: tuple[Case, ...] = Field(min_length=1)
    sweeps: tuple[Sweep, ...] = ()
    seeds: Seeds
    quick_seeds: Annotated[int, Field(ge=1)] = 2
    """Seeds with `dmrac reproduce --quick`."""
    traces: Annotated[int, Field(ge=0)] = 0
    """Of so many seeds, at every point, the columns are kept for figures."""
    compare_to: str = ""
    """Controller that ratios are formed against; empty: the last one named."""
    same_conditions: tuple[tuple[Name, ...], ...] = ()
    """Cases that differ in how the vehicle is controlled only: their controllers are compared with each other."""
    metrics: tuple[str, ...] = ("first_lap_rmse_m", "settled_rmse_m", "attitude_rmse_rad")
    """Columns of flights.parquet that the table shows."""
    targets: tuple[Target, ...] = ()
    figures: tuple[dict[str, Any], ...] = ()
    """What `dmrac figures` draws: experiments.results.figure_plan."""

    @model_validator(mode="after")
    def _names_known(self) -> Self:
        names = [case.name for case in self.cases]
        if len(set(names)) != len(names):
            raise ValueError("two cases have the same name")
        for case in self.cases:
            if case.experience is not None and case.experience not in names:
                raise ValueError(f"case {case.name}: experience: there is no case {case.experience}")
            if case.experience is not None and self.case(case.experience).experience is not None:
                raise ValueError(f"case {case.name}: experience: {case.experience} itself starts from another case")
        together = [name for cases in self.same_conditions for name in cases]
        for name in together:
            if name not in names or together.count(name) > 1:
                fault = "stands there twice" if name in names else f"is none; allowed are {', '.join(names)}"
                raise ValueError(f"same_conditions: case {name} {fault}")
        return self

    def case(self, name: str) -> Case:
        """The case of that name."""
        return next(case for case in self.cases if case.name == name)


@dataclass(frozen=True)
class FlightJob:
    """One flight, ready to be sent to a worker."""

    campaign: str
    case: str
    controller: str
    seed: int
    point: tuple[tuple[str, Any], ...]
    """(sweep, value)."""
    scenario: str
    duration_s: float | None
    assignments: tuple[str, ...]
    keep_trace: bool
    keep_experience: bool
    source: str = ""
    """Key of the flight whose experience this one starts from; empty: none."""
    experience: bytes | None = None

    @property
    def key(self) -> str:
        """Names the flight within its campaign, and its files."""
        swept = [f"{name}={value}" for name, value in self.point]
        return "/".join([self.case, *swept, Path(self.controller).stem, str(self.seed)])

    @property
    def file_stem(self) -> str:
        """The key as a file name."""
        return self.key.replace("/", "__")

    def command(self, out: Path | None = None) -> str:
        """The one command that flies it again."""
        words = ["dmrac", "fly", self.scenario, "--lockstep", "--controller", self.controller, "--seed", str(self.seed)]
        if self.duration_s is not None:
            words += ["--duration", f"{self.duration_s:g}"]
        for assignment in self.assignments:
            words += ["--set", assignment]
        if self.source:
            folder = out if out is not None else Path("OUT")
            words += ["--set", f"experience={folder / 'experience' / self.source.replace('/', '__')}.npz"]
        return shlex.join(words)

    def with_experience(self, experience: bytes) -> "FlightJob":
        """The job with what it starts from."""
        return replace(self, experience=experience)


def load_campaign(name: str) -> tuple[CampaignConfig, Path]:
    """A campaign by its name in configs/campaigns, or by its file. Raises ConfigError."""
    path = Path(name) if name.endswith((".yaml", ".yml")) else CONFIG_DIRECTORY / "campaigns" / f"{name}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(file.stem for file in (CONFIG_DIRECTORY / "campaigns").glob("*.yaml")))
        raise ConfigError(f"unknown campaign {name!r}: allowed are {known}, or the path of a .yaml file")
    return load(CampaignConfig, path), path


def unfold(campaign: CampaignConfig, name: str, seeds: int | None = None) -> Iterator[FlightJob]:
    """Every flight, sources of experience first; seeds vary slowest, so that an interrupted campaign is balanced.

    Parameters
    ----------
    seeds: so many instead of the campaign's own number.
    """
    needed = {case.experience for case in campaign.cases if case.experience is not None}
    for source in (True, False):
        cases = [case for case in campaign.cases if (case.name in needed) is source]
        for number in range(campaign.seeds.count if seeds is None else seeds):
            for case in cases:
                keep = source or case.keep_experience
                yield from flights_of_seed(campaign, name, case, campaign.seeds.first + number, number, keep)


def flights_of_seed(
    campaign: CampaignConfig, name: str, case: Case, seed: int, number: int, keep_experience: bool
) -> Iterator[FlightJob]:
    """A case's flights at every point and with every controller, for the number-th seed."""
    drawn = {
        draw.path: draw.value(np.random.default_rng([seed, DRAW_STREAM, index]), case.scenario)
        for index, draw in enumerate(case.draws)
    }
    sweeps = campaign.sweeps if case.swept else ()
    for steps in itertools.product(*(sweep.steps() for sweep in sweeps)):
        values = dict(case.set)
        for _, assigned in steps:
            values |= assigned
        values |= {path: value for path, value in drawn.items() if path not in values}
        point = tuple((sweep.name, value) for sweep, (value, _) in zip(sweeps, steps, strict=True))
        for controller in case.controllers or campaign.controllers:
            job = FlightJob(
                campaign=name,
                case=case.name,
                controller=controller,
                seed=seed,
                point=point,
                scenario=case.scenario,
                duration_s=case.duration_s,
                assignments=tuple(f"{path}={json.dumps(value)}" for path, value in values.items()),
                keep_trace=number < campaign.traces,
                keep_experience=keep_experience,
            )
            yield replace(job, source=_source(campaign, case, job)) if case.experience else job


def _source(campaign: CampaignConfig, case: Case, job: FlightJob) -> str:
    assert case.experience is not None
    other = campaign.case(case.experience)
    controller = case.experience_controller or job.controller
    point = job.point if other.swept else ()
    return replace(job, case=other.name, controller=controller, point=point).key
