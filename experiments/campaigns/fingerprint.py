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
    "6f57d4315f74d0ce78465b7fec4f1e3a05390480f6b4e3f703d687f9bd6b6700": "65da4f55c98054882b1634612fe6661d",
    "51e435e99772e03cf5b4995fff2b65809337bd77eaafec1cf57b67539b5f2b75": "74eb08fe3f0a94031f84955c0a981ecb",
    "bc7cabdb937dca917c7fb69ae04dd4175a4c175452eec586baab1cd932cf6ece": "081dc5bd95b8c059ba57529227b4d1da",
    "dc810a5ecafd84fefec0ed5141a1d1874785e093cfba527ba6d9c08ccec8bc6e": "b8a65af2fdba4e858a1c6c7f0f216b4f",
    "4ad64298f03a5de11e0feb1e74d44c1b62392cf21bf73e1affd45b26363f073e": "fa6294e858c4d69fb908d2bacbf477a0",
    "ffc77d1dfb02de53b169db684c41a99660862a9e232d495742c505a908b83f28": "87d79c75784968851c212e57ede313b6",
    "ae8b1aacbf3d0eccc9f3bda0f298a560c45bc7e0e3608fd8437a0d54d29528b7": "7bcca195a6d4a66ebcc55e1f89ee1ccf",
    "023dd4ca958e81d34185ff4484222f82af654fee2e5a3e8c1cfbaa5ed565c67f": "40e36ebff49200e68b7bd35d644d88da",
    "378a603306f67604ff9165a1d8b4067be2991a8a3281de16a706a4307cff21f7": "2efe3827109047fecd21f45190a4f2a3",
    "6e142f3bac8738b1de1dfc4739405955ca6ee0ebf54f8d23e3177a7f8b1a86f6": "cf5010e9cbe6fe6961d7ba244da98212",
    "ee1db3d77086d401a80538ba01d3b729c3e53faed07e0d1e133dc52d6aa7b6cf": "d9b3d21aa76b9c97afddbd8400644b32",
    "f8b5b3e4d0682ab823f6867de46c53dcc6aea93ffba4970765d8e2a0ea1c907d": "dbbfc836e2211844928adbfe8a4f1bdb",
    "0ebf3dd0a54231e98fa9206b308c17ae9cf617799e1bed71e3bf1cba2bfafa29": "a71f4eb9a886b5101df951dbfd861db3",
}
"""Today's fingerprint of the campaigns in docs/data, by the one they were flown under: the files that hold the settings
were arranged differently then. `dmrac refly docs/data/*.parquet` shows that the flights are the same.
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
