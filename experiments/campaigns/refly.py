"""Flies some of a campaign's flights again: are its rows what this code gives on this machine?"""

import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from configs.loader import ConfigError
from experiments.campaigns.flight_row import Row
from experiments.campaigns.flown import FlownCampaign, check_fingerprint
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
        before, now = (row["position_rmse_m"] for row in (self.recorded, self.again))
        fates = [("survived" if row["survived"] else "lost") for row in (self.recorded, self.again)]
        fate = f"{fates[0]}, now {fates[1]}; " if fates[0] != fates[1] else ""
        return f"{fate}position RMSE {before * 1e3:.2f} mm, now {now * 1e3:.2f} mm ({now / before - 1.0:+.1%})"


def pick(flown: FlownCampaign, sample: int, seed: int) -> list[str]:
    """Keys of so many flights, drawn without regard to what came out; of fewer, all. Failed ones are left out.

    Raises ConfigError if there is none.
    """
    rows = flown.table.select(["key", "error"]).to_pylist()
    keys = sorted(row["key"] for row in rows if not row["error"])
    if not keys:
        raise ConfigError(f"{flown.place}: holds no flights yet")
    return keys if sample >= len(keys) else random.Random(seed).sample(keys, sample)


def refly(
    flown: FlownCampaign, keys: list[str], folder: Path, workers: Workers, report: Callable[[Progress], None]
) -> list[Reflown]:
    """Flies these flights again, and before them those whose experience they start from.

    Parameters
    ----------
    folder: for what the flights leave; empty.

    Raises
    ------
    ConfigError
        If the campaign was flown with other settings than those of today.
    """
    check_fingerprint(flown.fingerprint, flown.config, str(flown.place), "they cannot be flown again with these")
    recorded = {row["key"]: row for row in flown.table.to_pylist()}
    first = flown.config.seeds.first
    seeds = 1 + max(row["seed"] for row in recorded.values()) - first
    untraced = flown.config.model_copy(update={"traces": 0})
    run = CampaignRun(untraced, flown.name, folder, seeds, frozenset(keys))
    with open_store(folder) as store:
        run_campaign(run, store, workers, report)
    again = {row["key"]: row for row in read_table(folder).to_pylist()}
    return [Reflown(recorded[key], again[key]) for key in keys]
