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
    "6f57d4315f74d0ce78465b7fec4f1e3a05390480f6b4e3f703d687f9bd6b6700": "99e9849d6f996dcd730c274a15212897",
    "51e435e99772e03cf5b4995fff2b65809337bd77eaafec1cf57b67539b5f2b75": "d81ad1c92504403acd4d183f0db30977",
    "bc7cabdb937dca917c7fb69ae04dd4175a4c175452eec586baab1cd932cf6ece": "38eb92672d15882aacf4316fe0da9c4f",
    "dc810a5ecafd84fefec0ed5141a1d1874785e093cfba527ba6d9c08ccec8bc6e": "426380f8fb3a29be0a2e3396134eb1e0",
    "4ad64298f03a5de11e0feb1e74d44c1b62392cf21bf73e1affd45b26363f073e": "58857a44b28f07b9ea388544cb6adc9d",
    "ffc77d1dfb02de53b169db684c41a99660862a9e232d495742c505a908b83f28": "e59921fec535c515e13f68827c75ed76",
    "ae8b1aacbf3d0eccc9f3bda0f298a560c45bc7e0e3608fd8437a0d54d29528b7": "5292544684dce3859aa6a85a14e75d87",
    "023dd4ca958e81d34185ff4484222f82af654fee2e5a3e8c1cfbaa5ed565c67f": "416a092163e40b4eee7bce77cec52e0d",
    "378a603306f67604ff9165a1d8b4067be2991a8a3281de16a706a4307cff21f7": "9deda86542896580058b123a1f9c0c9a",
    "6e142f3bac8738b1de1dfc4739405955ca6ee0ebf54f8d23e3177a7f8b1a86f6": "78e10a7405fd2d6527f90214e04f5bcf",
    "ee1db3d77086d401a80538ba01d3b729c3e53faed07e0d1e133dc52d6aa7b6cf": "e4925e3ccbcccd46eb857575bf0ba727",
    "f8b5b3e4d0682ab823f6867de46c53dcc6aea93ffba4970765d8e2a0ea1c907d": "51f875890c8a39140e9d8e89918608db",
    "0ebf3dd0a54231e98fa9206b308c17ae9cf617799e1bed71e3bf1cba2bfafa29": "075319b46fb0dbdf77fe678d130fcc6f",
}
"""Today's fingerprint of the campaigns in docs/data, by the one they were flown under: their files were arranged
differently then. Only settings are compared, not the code: protocol version 2 and the one value of gravity have changed
the flights themselves (docs/experiments.md).
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
