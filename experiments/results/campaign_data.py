"""A flown campaign, for tables and figures: its rows, selected by case, controller and point, and its kept traces."""

import io
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from configs.loader import CONFIG_DIRECTORY, ConfigError, load
from experiments.campaigns.campaign import PRESENTATION, CampaignConfig
from experiments.campaigns.fingerprint import fingerprint
from experiments.campaigns.flight_row import Row, outcomes
from experiments.campaigns.flown import read_flown
from experiments.campaigns.provenance import by_place
from experiments.results.statistics import Estimate, median, paired_ratio, wilson
from protocol.conventions import Array

REPORT_SEED = 20_000
"""Resampling draws from generators of its own, so that a report is the same whenever it is made."""
CONTROLLER_ORDER = ("none", "pid", "indi", "l1", "bias", "paper_mrac", "mrac", "paper_dmrac", "dmrac")


@dataclass(frozen=True)
class Group:
    """Flights of one case, controller and point."""

    case: str
    controller: str
    point: tuple[tuple[str, Any], ...]
    rows: tuple[Row, ...]

    @property
    def survivors(self) -> list[Row]:
        """Rows of vehicles that survived."""
        return [row for row in self.rows if row["survived"]]

    @property
    def survival(self) -> Estimate:
        """Share of vehicles that survived, Wilson interval."""
        return wilson(len(self.survivors), len(self.rows))

    @property
    def outcomes(self) -> dict[int, bool]:
        """Whether the vehicle survived, by seed."""
        return outcomes(self.rows)

    def values(self, metric: str) -> dict[int, float]:
        """Metric of the survivors, by seed."""
        return {row["seed"]: float(row[metric]) for row in self.survivors if np.isfinite(row[metric])}

    def estimate(self, metric: str) -> Estimate:
        """Median over survivors with its bootstrap interval."""
        return median(list(self.values(metric).values()), generator(self.case, self.controller, metric))

    def ratio(self, other: "Group", metric: str) -> Estimate:
        """Ratio to another group, paired by seed, over seeds both survived."""
        rng = generator(self.case, self.controller, other.case, other.controller, metric)
        return paired_ratio(self.values(metric), other.values(metric), rng)


def generator(*names: str) -> np.random.Generator:
    """A generator for one number of the report."""
    return np.random.default_rng([REPORT_SEED, *"|".join(names).encode()])


@dataclass(frozen=True)
class CampaignData:
    """Everything a campaign's folder holds."""

    folder: Path
    name: str
    config: CampaignConfig
    rows: tuple[Row, ...]
    """Flights that were flown; failed ones are in `failed`."""
    failed: tuple[Row, ...] = field(default=())
    flown_on: tuple[str, ...] = ()
    """Machines and versions, a line each, with the commits that flew there."""

    @property
    def command(self) -> str:
        """The command that flies the same."""
        seeds = {row["seed"] for row in (*self.rows, *self.failed)}
        return f"dmrac campaign {self.name} --seeds {len(seeds)}"

    @cached_property
    def groups(self) -> list[Group]:
        """All groups, in the campaign's order."""
        sorted_rows: dict[tuple[str, str, str], list[Row]] = {}
        for row in self.rows:
            sorted_rows.setdefault((row["case"], row["point"], row["controller"]), []).append(row)
        groups = [
            Group(case, controller, tuple(json.loads(point).items()), tuple(sorted(rows, key=lambda row: row["seed"])))
            for (case, point, controller), rows in sorted_rows.items()
        ]
        cases = [case.name for case in self.config.cases]
        return sorted(
            groups, key=lambda group: (cases.index(group.case), self._place(group.point), rank(group.controller))
        )

    def _place(self, point: tuple[tuple[str, Any], ...]) -> list[int]:
        steps = {sweep.name: [value for value, _ in sweep.steps()] for sweep in self.config.sweeps}
        return [steps[name].index(value) for name, value in point]

    @cached_property
    def controllers(self) -> list[str]:
        """Controllers that flew, in the usual order."""
        return sorted({row["controller"] for row in self.rows}, key=rank)

    def select(
        self, case: str | None = None, controller: str | None = None, point: dict[str, Any] | None = None
    ) -> list[Group]:
        """Groups that fit."""
        wanted = (point or {}).items()
        return [
            group
            for group in self.groups
            if (case is None or group.case == case)
            and (controller is None or group.controller == controller)
            and all(dict(group.point).get(name) == value for name, value in wanted)
        ]

    def same_conditions(self, case: str) -> tuple[str, ...]:
        """The case and those that differ from it only in how the vehicle is controlled."""
        together = [cases for cases in self.config.same_conditions if case in cases]
        return together[0] if together else (case,)

    def label(self, case: str) -> str:
        """What a case is called in tables and figures."""
        return self.config.case(case).label or case

    def cases(self) -> list[str]:
        """Cases that have flights."""
        return list(dict.fromkeys(group.case for group in self.groups))

    def traces(self, group: Group) -> list["Trace"]:
        """Kept traces of a group."""
        found = []
        for row in group.rows:
            path = self.folder / "traces" / f"{row['key'].replace('/', '__')}.npz"
            if path.exists():
                found.append(Trace.read(path, row))
        return found


def rank(controller: str) -> tuple[int, str]:
    """Where a controller stands in tables and legends."""
    known = CONTROLLER_ORDER.index(controller) if controller in CONTROLLER_ORDER else len(CONTROLLER_ORDER)
    return known, controller


def load_data(folder: Path) -> CampaignData:
    """Reads a campaign's folder.

    Raises
    ------
    ConfigError
        If it is not one, or holds no flights.
    """
    if folder.is_file():
        raise ConfigError(f"{folder}: not a campaign's folder")
    flown = read_flown(folder)
    table = flown.table.to_pylist()
    rows = [{name: math.nan if value is None else value for name, value in row.items()} for row in table]
    if not rows:
        raise ConfigError(f"{folder}: holds no flights yet")
    name = flown.about.name
    good = tuple(row for row in rows if not row["error"])
    failed = tuple(row for row in rows if row["error"])
    return CampaignData(folder, name, _presented(flown.config, name), good, failed, by_place(flown.about.flown_on))


def _presented(config: CampaignConfig, name: str) -> CampaignConfig:
    """The campaign as flown, with titles, metrics, targets and figures as its file lists them now."""
    path = CONFIG_DIRECTORY / "campaigns" / f"{name}.yaml"
    if not path.is_file():
        return config
    now = load(CampaignConfig, path)
    if fingerprint(now) != fingerprint(config):
        return config
    return config.model_copy(update={key: getattr(now, key) for key in PRESENTATION if key != "seeds"})


@dataclass(frozen=True)
class Trace:
    """Columns of one flight at 50 Hz."""

    row: Row
    columns: dict[str, Array]

    @classmethod
    def read(cls, path: Path, row: Row) -> "Trace":
        """From its file."""
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            return cls(row, {name: archive[name].astype(np.float64) for name in archive.files})

    def __getitem__(self, name: str) -> Array:
        """One column."""
        return self.columns[name]

    def vector(self, name: str, axes: Sequence[str]) -> Array:
        """[n, len(axes)]: the columns name_axis."""
        return np.stack([self.columns[f"{name}_{axis}"] for axis in axes], axis=1)

    @property
    def time_s(self) -> Array:
        """[n]."""
        return self.columns["time_s"]
