"""Repeats some of a campaign's flights: with the same core, to check whether this code on this machine gives the same
rows, or with the other one, to compare the statistics of both.
"""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from statistics import median
from typing import Final

from configs.loader import ConfigError
from configs.named_class import UntrustedClassError
from experiments.campaigns.campaign import Seeds
from experiments.campaigns.flight_row import Row
from experiments.campaigns.flown import FlownCampaign
from experiments.campaigns.provenance import commits_of
from experiments.campaigns.runner import CampaignRun, Progress, open_store, run_campaign
from experiments.campaigns.store import read_table
from experiments.campaigns.worker_pools import Workers

MEDIAN_SHARE_MAX: Final = 0.01
"""Two cores give the same statistics if their median errors differ by at most this share."""


@dataclass(frozen=True)
class Reflown:
    """One flight, as recorded and as repeated."""

    recorded: Row
    again: Row

    @property
    def same(self) -> bool:
        """Whether all datagrams are the same to the bit."""
        return bool(self.recorded["trace_sha256"] == self.again["trace_sha256"])

    @property
    def difference(self) -> str:
        """Description of the difference."""
        if self.again["error"]:
            return f"failed: {self.again['error']}"
        before, now = (_outcome(row) for row in (self.recorded, self.again))
        return f"{before}, now {now}"


def _outcome(row: Row) -> str:
    return f"{'survived' if row['survived'] else 'lost'} with a position RMSE of {row['position_rmse_m'] * 1e3:.2f} mm"


@dataclass(frozen=True)
class CoreStatistics:
    """The flights of one controller in one case, by two cores."""

    case: str
    controller: str
    flights: int
    survived: tuple[int, int]
    """By the recorded core, and by the other."""
    median_m: tuple[float, float]
    """Median of the position RMSE of the flights that survived with both, m; nan if none did."""

    @property
    def same(self) -> bool:
        """Whether as many survive, and the medians differ by at most MEDIAN_SHARE_MAX."""
        before, now = self.median_m
        alike = abs(now - before) <= MEDIAN_SHARE_MAX * before if max(self.survived) else True
        return self.survived[0] == self.survived[1] and alike


def core_statistics(flights: Sequence[Reflown]) -> list[CoreStatistics]:
    """Statistics by case and controller, in the order of the flights."""
    groups: dict[tuple[str, str], list[Reflown]] = {}
    for flight in flights:
        groups.setdefault((flight.recorded["case"], flight.recorded["controller"]), []).append(flight)
    return [_statistics(case, controller, group) for (case, controller), group in groups.items()]


def _statistics(case: str, controller: str, group: Sequence[Reflown]) -> CoreStatistics:
    pairs = [(flight.recorded, flight.again) for flight in group]
    both = [pair for pair in pairs if pair[0]["survived"] and pair[1]["survived"]]
    before, now = (median([pair[i]["position_rmse_m"] for pair in both]) if both else float("nan") for i in (0, 1))
    survived = sum(bool(one["survived"]) for one, _ in pairs), sum(bool(one["survived"]) for _, one in pairs)
    return CoreStatistics(case, controller, len(pairs), survived, (before, now))


def pick(flown: FlownCampaign, sample: int | None, seed: int, controllers: Sequence[str] | None = None) -> list[str]:
    """Return the keys of random flights, in equal numbers from all controllers, whatever their results.

    Parameters
    ----------
    sample: number of flights (all if there are fewer); None: one of each controller. Failed flights are left out.
    controllers: only theirs; None: of all.

    Raises
    ------
    ConfigError
        If the settings have changed, so that the flights cannot be repeated, or if there is no flight of a controller.
    """
    commits = [one for one in commits_of(flown.about.flown_on) if not one.endswith("-dirty")]
    advice = f"; check out commit {' or '.join(commits)}, which flew them" if commits else ""
    flown.about.check_settings(flown.config, str(flown.place), f"the flights cannot be repeated with these{advice}")
    keys: dict[str, list[str]] = {}
    for row in flown.table.select(["key", "controller", "error"]).sort_by("key").to_pylist():
        if not row["error"] and (controllers is None or row["controller"] in controllers):
            keys.setdefault(row["controller"], []).append(row["key"])
    if not keys and not controllers:
        raise ConfigError(f"{flown.place}: holds no flights yet")
    if missing := [name for name in controllers or () if name not in keys]:
        raise ConfigError(f"{flown.place}: holds no flights of {missing[0]!r}; it has {', '.join(keys) or 'none'}")
    rng = random.Random(seed)
    for of_controller in keys.values():
        rng.shuffle(of_controller)
    in_turn = [key for turn in zip_longest(*keys.values()) for key in turn if key is not None]
    picked = in_turn[: len(keys) if sample is None else sample]
    _require_classes(flown, frozenset(picked))
    return picked


def _require_classes(flown: FlownCampaign, keys: frozenset[str]) -> None:
    """Build the configurations here, where the classes that they name are checked; the workers import them."""
    for job in _run(flown, keys, Path()).jobs():
        try:
            job.configuration()
        except UntrustedClassError:
            raise
        except ConfigError:
            continue  # the flight fails, and its row says so


def _run(flown: FlownCampaign, keys: frozenset[str], folder: Path, core: str | None = None) -> CampaignRun:
    """The run that repeats the flights, with another core if one is given."""
    seeds = flown.table.column("seed").to_pylist()
    first = min(seeds)
    config = flown.config.model_copy(update={"traces": 0, "seeds": Seeds(first=first, count=1 + max(seeds) - first)})
    return CampaignRun(config, flown.about.name, folder, only=keys, core=core or flown.about.core)


def refly(
    flown: FlownCampaign,
    keys: list[str],
    folder: Path,
    workers: Workers,
    report: Callable[[Progress], None],
    core: str | None = None,
) -> list[Reflown]:
    """Repeat flights, after those whose experience they start from.

    Parameters
    ----------
    keys: from `pick`.
    folder: an empty folder for the repeated flights.
    core: one of onboard.cores.CORES; None: the core that flew.
    """
    recorded = {row["key"]: row for row in flown.table.to_pylist()}
    run = _run(flown, frozenset(keys), folder, core)
    with open_store(folder) as store:
        run_campaign(run, store, workers, report)
    again = {row["key"]: row for row in read_table(folder).to_pylist()}
    return [Reflown(recorded[key], again[key]) for key in keys]
