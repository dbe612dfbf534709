"""The configuration of a campaign: cases x sweeps x controllers x seeds.

A campaign file names scenarios and assigns values to them by path, as `dmrac fly --set` does.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from configs.loader import CONFIG_DIRECTORY, ConfigError, ConfigRecord, load
from experiments.campaigns.draws import Draw

PRESENTATION = (
    *("title", "description", "seeds", "quick_seeds", "compare_to", "same_conditions"),
    *("metrics", "targets", "figures", "traces"),
)
"""Keys of a campaign that change no flight."""
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w.+-]*$")]
Assignments = dict[str, Any]
"""Value by path of the resolved configuration."""


class Case(ConfigRecord):
    """A scenario and the values that are changed in it."""

    name: Name
    label: str = ""
    """For tables and figures; empty: the name."""
    scenario: str
    duration_s: Annotated[float, Field(ge=5, le=3600)] | None = None
    set: Assignments = Field(default_factory=dict)
    draws: tuple[Draw, ...] = ()
    """Beside those of the campaign."""
    controllers: tuple[str, ...] = ()
    """Empty: those of the campaign."""
    experience: Name | None = None
    """A case that is flown first, with the same controller and seed; this one starts from what it learnt."""
    memory: tuple[Name, ...] = ()
    """Cases that are flown first, with the same seed; this one starts from the memory that their flights teach."""
    experience_controller: str | None = None
    """Controller that flies the other cases; None: the same one."""
    swept: bool = True
    """False: flown once instead of at every point of the sweeps."""
    keep_experience: bool = False
    """Whether to store what each flight learnt, in the folder's experience/."""


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
        """Return (value or name of the point, its assignments) for each step."""
        if self.points:
            return list(self.points.items())
        return [(value, {self.path: value}) for value in self.values]


class Seeds(ConfigRecord):
    """Seeds of a campaign. Seeds below 1000 are for tuning, the others for evaluation."""

    first: Annotated[int, Field(ge=0)] = 1000
    count: Annotated[int, Field(ge=1, le=100_000)]


class Flown(ConfigRecord):
    """Names a group of flights: a case, a controller and a point of the sweeps."""

    case: str
    controller: str
    point: dict[str, Any] = Field(default_factory=dict)


class Rivals(ConfigRecord):
    """Names one group of flights, or those of several controllers: then the one with the least median counts."""

    case: str
    controller: str | Annotated[tuple[str, ...], Field(min_length=2)]
    point: dict[str, Any] = Field(default_factory=dict)

    @property
    def flown(self) -> tuple[Flown, ...]:
        """The groups."""
        names = (self.controller,) if isinstance(self.controller, str) else self.controller
        return tuple(Flown(case=self.case, controller=name, point=self.point) for name in names)


class Target(ConfigRecord):
    """A target for a ratio: median of ours / theirs, paired by seed."""

    label: str
    ours: Flown
    theirs: Rivals
    metric: str
    at_most: float


class CampaignConfig(ConfigRecord):
    """A campaign file."""

    description: str
    title: str = ""
    controllers: tuple[str, ...] = Field(min_length=1)
    cases: tuple[Case, ...] = Field(min_length=1)
    draws: tuple[Draw, ...] = ()
    """Of every case, beside its own."""
    sweeps: tuple[Sweep, ...] = ()
    seeds: Seeds
    quick_seeds: Annotated[int, Field(ge=1)] = 2
    """Number of seeds with `dmrac reproduce --quick`."""
    traces: Annotated[int, Field(ge=0)] = 0
    """Number of seeds, at every point, whose columns are stored for figures."""
    compare_to: str = ""
    """Controller, case or point that ratios are formed with; empty: the last controller."""
    same_conditions: tuple[tuple[Name, ...], ...] = ()
    """Cases that differ only in how the vehicle is controlled: their controllers are compared with each other."""
    metrics: tuple[str, ...] = ("first_lap_rmse_m", "settled_rmse_m", "attitude_rmse_rad")
    """Columns of flights.parquet that the tables show."""
    targets: tuple[Target, ...] = ()
    figures: tuple[dict[str, Any], ...] = ()
    """Entries for experiments.results.figure_plan."""

    @model_validator(mode="after")
    def _names_known(self) -> Self:
        names = [case.name for case in self.cases]
        if len(set(names)) != len(names):
            raise ValueError("two cases have the same name")
        for controllers in (self.controllers, *(case.controllers for case in self.cases)):
            _check_controllers(controllers)
        for case in self.cases:
            if case.experience is not None and case.experience not in names:
                raise ValueError(f"case {case.name}: experience: there is no case {case.experience}")
            if case.experience is not None and self.case(case.experience).experience is not None:
                raise ValueError(f"case {case.name}: experience: {case.experience} itself starts from another case")
            for other in case.memory:
                _check_memory(case, other, names, self)
        together = [name for cases in self.same_conditions for name in cases]
        for name in together:
            if name not in names or together.count(name) > 1:
                fault = "is listed twice" if name in names else f"does not exist; allowed are {', '.join(names)}"
                raise ValueError(f"same_conditions: case {name} {fault}")
        return self

    def case(self, name: str) -> Case:
        """Return the case of that name."""
        return next(case for case in self.cases if case.name == name)


def _check_controllers(controllers: Sequence[str]) -> None:
    """Raise ValueError if two have the same name, which is that of their flights."""
    first: dict[str, str] = {}
    for one in controllers:
        name = Path(one).stem
        if name in first:
            raise ValueError(f"controllers: {first[name]} and {one} have the same name, {name}")
        first[name] = one


def _check_memory(case: Case, other: str, names: Sequence[str], campaign: CampaignConfig) -> None:
    """Raise ValueError if a case cannot start from what the flights of another one teach."""
    if other not in names:
        raise ValueError(f"case {case.name}: memory: there is no case {other}")
    if case.experience is not None:
        raise ValueError(f"case {case.name}: memory: not allowed with experience")
    if campaign.case(other).experience is not None or campaign.case(other).memory:
        raise ValueError(f"case {case.name}: memory: {other} itself starts from another case")
    if other in {one.experience for one in campaign.cases}:
        raise ValueError(f"case {case.name}: memory: {other} is the experience of another case")


def load_campaign(name: str) -> tuple[CampaignConfig, Path]:
    """Load a campaign by its name in configs/campaigns, or by its file; return it and its path. Raises ConfigError."""
    path = campaign_file(name)
    return load(CampaignConfig, path), path


def campaign_file(name: str) -> Path:
    """Return the file of a campaign. Raises ConfigError if there is none."""
    path = Path(name) if name.endswith((".yaml", ".yml")) else CONFIG_DIRECTORY / "campaigns" / f"{name}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(file.stem for file in (CONFIG_DIRECTORY / "campaigns").glob("*.yaml")))
        raise ConfigError(f"unknown campaign {name!r}: allowed are {known}, or the path of a .yaml file")
    return path
