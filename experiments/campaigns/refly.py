"""Flies some of a campaign's flights again: are its rows what this code gives on this machine?"""

import random
from collections.abc import Callable
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from configs.loader import ConfigError
from experiments.campaigns.campaign import Seeds
from experiments.campaigns.flight_row import Row
from experiments.campaigns.flown import FlownCampaign
from experiments.campaigns.runner import CampaignRun, Progress, Workers, open_store, run_campaign
from experiments.campaigns.store import read_table


@dataclass(frozen=True)
class Reflown:
    """One flight, as recorded and as flown again."""

    recorded: Row
    again: Row

    @property
    def same(self) -> bool:
        """Whether all datagrams were the same to the bit."""
        return bool(self.recorded["trace_sha256"] == self.again["trace_sha256"])

    @property
    def difference(self) -> str:
        """What came out otherwise, in words."""
        if self.again["error"]:
            return f"failed: {self.again['error']}"
        before, now = (_outcome(row) for row in (self.recorded, self.again))
        return f"{before}, now {now}"


def _outcome(row: Row) -> str:
    return f"{'survived' if row['survived'] else 'lost'} with a position RMSE of {row['position_rmse_m'] * 1e3:.2f} mm"


def pick(flown: FlownCampaign, sample: int | None, seed: int) -> list[str]:
    """Keys of so many flights, drawn without regard to what came out and from all controllers alike.

    Parameters
    ----------
    sample: None: one of each controller. If there are fewer, all are picked; failed flights are left out.

    Raises
    ------
    ConfigError
        If the settings have changed since, so that these flights cannot be flown again, or if there is none.
    """
    flown.about.check_settings(flown.config, str(flown.place), "they cannot be flown again with these")
    keys: dict[str, list[str]] = {}
    for row in flown.table.select(["key", "controller", "error"]).sort_by("key").to_pylist():
        if not row["error"]:
            keys.setdefault(row["controller"], []).append(row["key"])
    if not keys:
        raise ConfigError(f"{flown.place}: holds no flights yet")
    rng = random.Random(seed)
    for of_controller in keys.values():
        rng.shuffle(of_controller)
    in_turn = [key for turn in zip_longest(*keys.values()) for key in turn if key is not None]
    return in_turn[: len(keys) if sample is None else sample]


def refly(
    flown: FlownCampaign, keys: list[str], folder: Path, workers: Workers, report: Callable[[Progress], None]
) -> list[Reflown]:
    """Flies these flights again, and before them those whose experience they start from.

    Parameters
    ----------
    keys: as `pick` gives them.
    folder: for what the flights leave; empty.
    """
    recorded = {row["key"]: row for row in flown.table.to_pylist()}
    seeds = [row["seed"] for row in recorded.values()]
    first = min(seeds)
    config = flown.config.model_copy(update={"traces": 0, "seeds": Seeds(first=first, count=1 + max(seeds) - first)})
    run = CampaignRun(config, flown.about.name, folder, only=frozenset(keys))
    with open_store(folder) as store:
        run_campaign(run, store, workers, report)
    again = {row["key"]: row for row in read_table(folder).to_pylist()}
    return [Reflown(recorded[key], again[key]) for key in keys]
