"""The fingerprint of a campaign: equal for the same flights, different for others."""

from typing import Any

import pytest

from configs.loader import fill
from experiments.campaigns.campaign import CampaignConfig
from experiments.campaigns.fingerprint import fingerprint

CASE = {"name": "calm", "scenario": "hover", "duration_s": 5, "set": {"vehicle.drag.linear_n_s_m": 0.02}}


def campaign(case: dict[str, Any] | None = None, **over: Any) -> CampaignConfig:
    tree = {"description": "A test.", "controllers": ["none"], "seeds": {"count": 2}, "cases": [CASE | (case or {})]}
    return fill(CampaignConfig, tree | over, "test")


@pytest.mark.parametrize(
    "other",
    [
        campaign(seeds={"count": 9}, title="Other", traces=1),
        campaign({"label": "still air"}),
        campaign({"set": {"vehicle.drag": {"linear_n_s_m": 0.02}}}),
        campaign({"set": {"vehicle.drag.linear_n_s_m": 0.02, "network.ground": "127.0.0.1:9"}}),
    ],
)
def test_the_same_flights_have_the_same_fingerprint(other: CampaignConfig) -> None:
    assert fingerprint(other) == fingerprint(campaign())


@pytest.mark.parametrize(
    "other",
    [
        campaign(controllers=["pid"]),
        campaign({"duration_s": 6}),
        campaign({"set": {"vehicle.drag.linear_n_s_m": 0.021}}),
        campaign({"set": {"vehicle.drag.no_such_key": 1}}),
        campaign({"set": {"vehicle.physics": "rotorpy"}}),
        campaign({"set": {"vehicle.physics": "rotorpy", "vehicle.rotorpy": {"flapping_m": 0.01}}}),
        campaign({"draws": [{"path": "vehicle.body.mass_kg", "uniform": [0.06, 0.07]}]}),
        campaign(sweeps=[{"name": "mass", "path": "vehicle.body.mass_kg", "values": [0.06]}]),
    ],
)
def test_other_flights_have_another_fingerprint(other: CampaignConfig) -> None:
    assert fingerprint(other) != fingerprint(campaign())
