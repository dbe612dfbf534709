"""Two campaigns with the same fingerprint fly the same flights, whatever their files look like."""

import hashlib
import json
from typing import Final

from configs.loader import ConfigError
from experiments.campaigns.campaign import CampaignConfig, Seeds
from experiments.campaigns.flight_jobs import FlightJob, unfold

SEED: Final = 1000
"""The flights of this seed stand for those of all seeds."""
CHANGES_NO_FLIGHT: Final = ("scenario", "description", "network")
"""Sections of a resolved flight that change nothing in lockstep."""
EARLIER: Final[dict[str, str]] = {
    "6f57d4315f74d0ce78465b7fec4f1e3a05390480f6b4e3f703d687f9bd6b6700": "4b31c7281322e3cba0e9d5310e46faab",
    "51e435e99772e03cf5b4995fff2b65809337bd77eaafec1cf57b67539b5f2b75": "5d69308354ea2f17e84abf77790043a3",
    "bc7cabdb937dca917c7fb69ae04dd4175a4c175452eec586baab1cd932cf6ece": "9fdb46d2d95da6a04959995075109320",
    "dc810a5ecafd84fefec0ed5141a1d1874785e093cfba527ba6d9c08ccec8bc6e": "84196cb241507c137289e38d5f9716d5",
    "4ad64298f03a5de11e0feb1e74d44c1b62392cf21bf73e1affd45b26363f073e": "fc80c99aa79c0887008b27b7c235a0f6",
    "ffc77d1dfb02de53b169db684c41a99660862a9e232d495742c505a908b83f28": "f705edbfbb263d6ef5d29c29b3891164",
    "ae8b1aacbf3d0eccc9f3bda0f298a560c45bc7e0e3608fd8437a0d54d29528b7": "329d21f76eb3e9443c27cf424fd6fe8d",
    "023dd4ca958e81d34185ff4484222f82af654fee2e5a3e8c1cfbaa5ed565c67f": "574006810375f2df77307217ba88692b",
    "378a603306f67604ff9165a1d8b4067be2991a8a3281de16a706a4307cff21f7": "b2ba204df5c660692b1da8467dee5a38",
    "6e142f3bac8738b1de1dfc4739405955ca6ee0ebf54f8d23e3177a7f8b1a86f6": "f6b2d1a5e1671684ea497b904732eb69",
    "ee1db3d77086d401a80538ba01d3b729c3e53faed07e0d1e133dc52d6aa7b6cf": "dc39829f597eb3df0ec95c036d2c57e1",
    "f8b5b3e4d0682ab823f6867de46c53dcc6aea93ffba4970765d8e2a0ea1c907d": "b5bb14f2ffb9b6c4f5b885953af56f93",
    "0ebf3dd0a54231e98fa9206b308c17ae9cf617799e1bed71e3bf1cba2bfafa29": "698b364cac33e5526c81462392201b11",
}
"""Today's fingerprint of the campaigns in docs/data, by the one they were flown under: their files were arranged
differently then. Only settings are compared, not the code: protocol version 2 and the one value of gravity have changed
the flights themselves (docs/experiments.md). So have the measured noise and the estimator's sigmas: they are newer than
those flights, and a flight flown again has the defaults of today.
"""


def fingerprint(campaign: CampaignConfig) -> str:
    """Half a SHA-256 of the resolved settings of a campaign's flights, those of one seed.

    A flight that cannot be resolved counts by its assignments.
    """
    one_seed = campaign.model_copy(update={"seeds": Seeds(first=SEED, count=1)})
    digest = hashlib.sha256()
    for job in unfold(one_seed, ""):
        digest.update(json.dumps([job.key, job.source, _settings(job)], sort_keys=True).encode())
    return digest.hexdigest()[:32]


def _settings(job: FlightJob) -> object:
    try:
        flight = job.configuration()
    except ConfigError:
        return [job.scenario, job.controller, job.duration_s, job.assignments]
    return flight.model_dump(mode="json", by_alias=True, exclude=set(CHANGES_NO_FLIGHT))
