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
    "6f57d4315f74d0ce78465b7fec4f1e3a05390480f6b4e3f703d687f9bd6b6700": "15f037f84df6cc65cebfe08b87cee020",
    "51e435e99772e03cf5b4995fff2b65809337bd77eaafec1cf57b67539b5f2b75": "b4510f303dd68bc3177fd1374255db6e",
    "bc7cabdb937dca917c7fb69ae04dd4175a4c175452eec586baab1cd932cf6ece": "0ed418b36dafae589cda9e160c3b66ea",
    "dc810a5ecafd84fefec0ed5141a1d1874785e093cfba527ba6d9c08ccec8bc6e": "d1204063d3ee60a475db876385de1563",
    "4ad64298f03a5de11e0feb1e74d44c1b62392cf21bf73e1affd45b26363f073e": "8b2b952b044bff690361afd939e07329",
    "ffc77d1dfb02de53b169db684c41a99660862a9e232d495742c505a908b83f28": "690fefeaeac1e3887effec0089c56739",
    "ae8b1aacbf3d0eccc9f3bda0f298a560c45bc7e0e3608fd8437a0d54d29528b7": "d89f0ef0894324f7be7825961aed9a6d",
    "023dd4ca958e81d34185ff4484222f82af654fee2e5a3e8c1cfbaa5ed565c67f": "f11cba757bd99af8f204aede5fbb829e",
    "378a603306f67604ff9165a1d8b4067be2991a8a3281de16a706a4307cff21f7": "aff868e9093e9ef46d14386069cf1bb4",
    "6e142f3bac8738b1de1dfc4739405955ca6ee0ebf54f8d23e3177a7f8b1a86f6": "c7ecea706b59d2a5a09e723b0a17d3ba",
    "ee1db3d77086d401a80538ba01d3b729c3e53faed07e0d1e133dc52d6aa7b6cf": "def79e2950e5505ef8c97b335ea26acf",
    "f8b5b3e4d0682ab823f6867de46c53dcc6aea93ffba4970765d8e2a0ea1c907d": "74642580261c48de939f80d8354519fe",
    "0ebf3dd0a54231e98fa9206b308c17ae9cf617799e1bed71e3bf1cba2bfafa29": "6d8d5d434df3a0794c1e529c41d253a5",
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
