"""The flights of a campaign: cases x sweeps x controllers x seeds, as jobs for the workers.

Every controller flies the same seeds. The values drawn for a seed (onset, rotor, severity) are the same for all.
"""

import itertools
import json
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from experiments.campaigns.campaign import CampaignConfig, Case
from experiments.campaigns.draws import draw_all
from experiments.campaigns.flight_row import Row, empty_row
from experiments.flights.scenario import Choices, FlightConfig, resolve
from onboard.cores import NUMPY, core_option


@dataclass(frozen=True)
class FlightJob:
    """One flight, as it is sent to a worker."""

    campaign: str
    case: str
    controller: str
    seed: int
    point: tuple[tuple[str, Any], ...]
    """(sweep, value) of each sweep."""
    scenario: str
    duration_s: float | None
    assignments: tuple[str, ...]
    keep_trace: bool
    keep_experience: bool
    sources: tuple[str, ...] = ()
    """Keys of the flights that this one starts from: of the one whose experience it has, or of those of its memory."""
    memory: str = ""
    """Name of the memory that the sources teach; empty: there is one source, and its experience is taken as it is."""
    teaches: bool = False
    """Whether what is kept of this flight is a condition for a memory instead of an experience."""
    experience: bytes | None = None
    lessons: tuple[bytes, ...] = ()
    """What was kept of the sources of the memory."""
    core: str = NUMPY
    """The onboard core, one of onboard.cores.CORES."""

    @property
    def key(self) -> str:
        """Name of the flight within its campaign, and of its files."""
        swept = [f"{name}={value}" for name, value in self.point]
        return "/".join([self.case, *swept, Path(self.controller).stem, str(self.seed)])

    @property
    def file_stem(self) -> str:
        """The key as a file name."""
        return self.key.replace("/", "__")

    def command(self, out: Path | None = None) -> str:
        """Return the command that repeats this flight."""
        words = ["dmrac", "fly", self.scenario, "--lockstep", "--controller", self.controller, "--seed", str(self.seed)]
        words += core_option(self.core)
        if self.duration_s is not None:
            words += ["--duration", f"{self.duration_s:g}"]
        for assignment in self.assignments:
            words += ["--set", assignment]
        folder = out if out is not None else Path("OUT")
        if self.memory:
            words += ["--memory", str(memory_path(folder, self.memory))]
        elif self.sources:
            words += ["--set", f"experience={folder / 'experience' / self.sources[0].replace('/', '__')}.npz"]
        return shlex.join(words)

    def empty_row(self, out: Path | None = None) -> Row:
        """Return a row that identifies the flight and has no results yet."""
        names = ("key", "campaign", "case", "controller", "seed")
        row = empty_row() | {name: getattr(self, name) for name in names}
        return row | {"point": json.dumps(dict(self.point)), "command": self.command(out)}

    def configuration(self) -> FlightConfig:
        """Return the resolved configuration of the flight. Raises ConfigError."""
        return resolve(self.scenario, Choices(self.controller, self.seed, self.duration_s, self.assignments))


def memory_path(folder: Path, name: str) -> Path:
    """Return the file of a memory that flights of the campaign taught."""
    return folder / "memories" / f"{name}.npz"


def unfold(campaign: CampaignConfig, name: str, seeds: int | None = None, core: str = NUMPY) -> Iterator[FlightJob]:
    """Yield every flight: first those whose experience others need; seed by seed, so that any part is balanced.

    Parameters
    ----------
    seeds: number of seeds; None: the campaign's.
    core: the onboard core of all flights, one of onboard.cores.CORES.
    """
    needed = {other for case in campaign.cases for other in (case.experience, *case.memory) if other is not None}
    for source in (True, False):
        cases = [case for case in campaign.cases if (case.name in needed) is source]
        for number in range(campaign.seeds.count if seeds is None else seeds):
            for case in cases:
                keep = source or case.keep_experience
                for job in flights_of_seed(campaign, name, case, campaign.seeds.first + number, number, keep):
                    yield replace(job, core=core)


def flights_of_seed(
    campaign: CampaignConfig, name: str, case: Case, seed: int, number: int, keep_experience: bool
) -> Iterator[FlightJob]:
    """Yield a case's flights at every point and with every controller, for one seed, the number-th of the campaign."""
    drawn = draw_all(campaign.draws, case.draws, seed, case.scenario)
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
            others = (case.experience,) if case.experience else case.memory
            sources = tuple(_source(campaign.case(other), case, job) for other in others)
            memory = "__".join([*case.memory, str(seed)]) if case.memory else ""
            teaches = any(case.name in one.memory for one in campaign.cases)
            yield replace(job, sources=sources, memory=memory, teaches=teaches)


def _source(other: Case, case: Case, job: FlightJob) -> str:
    """The key of the flight of another case that a flight starts from."""
    controller = case.experience_controller or job.controller
    point = job.point if other.swept else ()
    return replace(job, case=other.name, controller=controller, point=point).key
