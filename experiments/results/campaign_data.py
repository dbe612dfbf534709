"""The flights of a campaign, for tables and figures: rows grouped by case, controller and point, and traces."""

import io
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from configs.flight_tree import read_scenario
from configs.loader import CONFIG_DIRECTORY, ConfigError, load
from configs.vehicle import value_at
from experiments.campaigns.campaign import PRESENTATION, CampaignConfig
from experiments.campaigns.fingerprint import fingerprint
from experiments.campaigns.flight_row import Row, outcomes
from experiments.campaigns.flown import read_flown
from experiments.campaigns.provenance import by_place
from experiments.results.statistics import Estimate, median, paired_ratio, wilson
from onboard.cores import NUMPY, core_option
from protocol.conventions import Array

REPORT_SEED = 20_000
"""Seed of the resampling: each number has its own generator, so that a report is repeatable."""
OURS = "dmrac"
"""The controller that the others are compared with."""
TRAJECTORY = "onboard.guidance.trajectory."
CONTROLLER_ORDER = (
    *("none", "pid", "indi", "l1", "repetitive", "ilc"),
    *("bias", "paper_mrac", "mrac", "paper_dmrac", "dmrac"),
)


@dataclass(frozen=True)
class Group:
    """The flights of one case, controller and point."""

    case: str
    controller: str
    point: tuple[tuple[str, Any], ...]
    rows: tuple[Row, ...]

    @property
    def survivors(self) -> list[Row]:
        """Rows of the vehicles that survived."""
        return [row for row in self.rows if row["survived"]]

    @property
    def survival(self) -> Estimate:
        """Share of the vehicles that survived, with its Wilson interval."""
        return wilson(len(self.survivors), len(self.rows))

    @property
    def outcomes(self) -> dict[int, bool]:
        """Whether the vehicle survived, by seed."""
        return outcomes(self.rows)

    def values(self, metric: str) -> dict[int, float]:
        """Return the finite values of a metric of the survivors, by seed."""
        return {row["seed"]: float(row[metric]) for row in self.survivors if np.isfinite(row[metric])}

    def median(self, metric: str) -> float:
        """Return the median over the survivors; NaN for none."""
        values = list(self.values(metric).values())
        return float(np.median(values)) if values else math.nan

    def estimate(self, metric: str) -> Estimate:
        """Return the median over the survivors with its bootstrap interval."""
        return median(list(self.values(metric).values()), generator(self.case, self.controller, metric))

    def ratio(self, other: "Group", metric: str) -> Estimate:
        """Return the median ratio to another group, paired by seed, over the seeds that both survived."""
        rng = generator(self.case, self.controller, other.case, other.controller, metric)
        return paired_ratio(self.values(metric), other.values(metric), rng)


def generator(*names: str) -> np.random.Generator:
    """Return the generator for one number of the report, from its names."""
    return np.random.default_rng([REPORT_SEED, *"|".join(names).encode()])


@dataclass(frozen=True)
class CampaignData:
    """The content of a campaign's folder."""

    folder: Path
    name: str
    config: CampaignConfig
    rows: tuple[Row, ...]
    """Flights without those that failed."""
    failed: tuple[Row, ...] = field(default=())
    flown_on: tuple[str, ...] = ()
    """One line for each machine and set of versions, with the commits that flew there."""
    core: str = NUMPY
    """The onboard core of all flights, one of onboard.cores.CORES."""
    as_today: bool = True
    """Whether the campaign's file of today flies the same flights; True if there is none."""

    @property
    def command(self) -> str:
        """The command that flies the same flights."""
        seeds = {row["seed"] for row in (*self.rows, *self.failed)}
        return " ".join([f"dmrac campaign {self.name} --seeds {len(seeds)}", *core_option(self.core)])

    @cached_property
    def groups(self) -> list[Group]:
        """All groups, in the order of the campaign file."""
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
        """Controllers that flew, in the order of CONTROLLER_ORDER."""
        return sorted({row["controller"] for row in self.rows}, key=rank)

    def select(
        self, case: str | None = None, controller: str | None = None, point: dict[str, Any] | None = None
    ) -> list[Group]:
        """Return the groups with this case, controller and point; None fits all."""
        wanted = (point or {}).items()
        return [
            group
            for group in self.groups
            if (case is None or group.case == case)
            and (controller is None or group.controller == controller)
            and all(dict(group.point).get(name) == value for name, value in wanted)
        ]

    def same_conditions(self, case: str) -> tuple[str, ...]:
        """Return the case and those that differ from it only in how the vehicle is controlled."""
        together = [cases for cases in self.config.same_conditions if case in cases]
        return together[0] if together else (case,)

    def _together(self, case: str) -> list[Group]:
        """Return the groups of a case and of those under the same conditions."""
        return [group for one in self.same_conditions(case) for group in self.select(one)]

    def rivals(self, ours: Group) -> list[Group]:
        """Return the other controllers' groups under the same conditions, at the same point or not swept at all."""
        groups = self._together(ours.case)
        return [group for group in groups if group.point in (ours.point, ()) and group.controller != ours.controller]

    def flown_once(self, case: str) -> list[Group]:
        """Return the groups under the same conditions that are not swept."""
        return [group for group in self._together(case) if not group.point]

    @property
    def title(self) -> str:
        """Title of the campaign."""
        return self.config.title or self.name

    def label(self, case: str) -> str:
        """Return the name of a case for tables and figures."""
        return self.config.case(case).label or case

    def condition(self, group: Group) -> str:
        """Return case and point of a group in words."""
        return ", ".join([self.label(group.case), *(f"{name} {value}" for name, value in group.point)])

    def one_path(self, case: str) -> bool:
        """Return whether all seeds of a case fly the same path."""
        flown = self.config.case(case)
        drawn = any(one.path.startswith(TRAJECTORY) for one in (*self.config.draws, *flown.draws))
        kind = value_at(read_scenario(flown.scenario).guidance, "trajectory.path.kind")
        return not drawn and kind != "lissajous"

    def cases(self) -> list[str]:
        """Return the cases that have flights."""
        return list(dict.fromkeys(group.case for group in self.groups))

    def traces(self, group: Group) -> list["Trace"]:
        """Return the traces of a group, of the flights that have one."""
        found = []
        for row in group.rows:
            path = self.folder / "traces" / f"{row['key'].replace('/', '__')}.npz"
            if path.exists():
                found.append(Trace.read(path, row))
        return found


def rank(controller: str) -> tuple[int, str]:
    """Return the sort key of a controller in tables and legends."""
    known = CONTROLLER_ORDER.index(controller) if controller in CONTROLLER_ORDER else len(CONTROLLER_ORDER)
    return known, controller


def load_data(folder: Path) -> CampaignData:
    """Read a campaign's folder.

    Raises
    ------
    ConfigError
        If the folder is not a campaign's or has no flights.
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
    config, as_today = _presented(flown.config, name)
    return CampaignData(folder, name, config, good, failed, by_place(flown.about.flown_on), flown.about.core, as_today)


def _presented(config: CampaignConfig, name: str) -> tuple[CampaignConfig, bool]:
    """Return the campaign as flown, with titles, metrics, targets and figures from its file of today.

    Also whether that file flies the same flights; if not, the campaign is returned as it was flown.
    """
    path = CONFIG_DIRECTORY / "campaigns" / f"{name}.yaml"
    if not path.is_file():
        return config, True
    now = load(CampaignConfig, path)
    if fingerprint(now) != fingerprint(config):
        return config, False
    return config.model_copy(update={key: getattr(now, key) for key in PRESENTATION if key != "seeds"}), True


@dataclass(frozen=True)
class Trace:
    """Columns of one flight, at 50 Hz."""

    row: Row
    columns: dict[str, Array]

    @classmethod
    def read(cls, path: Path, row: Row) -> "Trace":
        """Read a trace file."""
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            return cls(row, {name: archive[name].astype(np.float64) for name in archive.files})

    def __getitem__(self, name: str) -> Array:
        """Return one column, [n]."""
        return self.columns[name]

    def vector(self, name: str, axes: Sequence[str]) -> Array:
        """Return the columns name_axis, [n, len(axes)]."""
        return np.stack([self.columns[f"{name}_{axis}"] for axis in axes], axis=1)

    @property
    def time_s(self) -> Array:
        """Time of each row, [n], s."""
        return self.columns["time_s"]
