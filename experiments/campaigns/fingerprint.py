"""Two campaigns with the same fingerprint fly the same flights, whatever their files look like."""

import hashlib
import json
from typing import Any, Final

from configs.loader import ConfigError
from configs.named_class import UntrustedClassError
from experiments.campaigns.campaign import CampaignConfig, Seeds
from experiments.campaigns.flight_jobs import FlightJob, unfold
from onboard.cores import NUMPY, core_option

SEED: Final = 1000
"""The flights of this seed stand for those of all seeds."""
CHANGES_NO_FLIGHT: Final[dict[str, Any]] = {
    **dict.fromkeys(("scenario", "description", "network"), True),
    "offboard": {"experience": {"versions_kept"}},
}
"""Sections and values of a resolved flight that change nothing in lockstep."""


def fingerprint(campaign: CampaignConfig, core: str = NUMPY) -> str:
    """Half a SHA-256 of the resolved settings of a campaign's flights, those of one seed.

    A flight that cannot be resolved counts by its assignments. The core counts where it is not numpy's, so that rows
    of before there were two keep their fingerprint.

    Parameters
    ----------
    core: the onboard core of the flights, one of onboard.cores.CORES.
    """
    one_seed = campaign.model_copy(update={"seeds": Seeds(first=SEED, count=1)})
    digest = hashlib.sha256(" ".join(core_option(core)).encode())
    for job in unfold(one_seed, ""):
        digest.update(json.dumps([job.key, "".join(job.sources), _settings(job)], sort_keys=True).encode())
    return digest.hexdigest()[:32]


def _settings(job: FlightJob) -> object:
    try:
        flight = job.configuration()
    except UntrustedClassError:
        raise
    except ConfigError:
        return [job.scenario, job.controller, job.duration_s, job.assignments]
    settings: dict[str, Any] = flight.model_dump(mode="json", by_alias=True, exclude=CHANGES_NO_FLIGHT)
    if flight.vehicle.physics != "rotorpy":
        del settings["vehicle"]["rotorpy"]  # then it is None; rows of before it was a key keep their fingerprint
    return settings
