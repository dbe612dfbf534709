"""Cases that start from the memory of other cases' flights."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from configs.loader import ConfigError, fill, parse_yaml
from experiments.campaigns.campaign import CampaignConfig, load_campaign
from experiments.campaigns.flight_jobs import FlightJob, memory_path, unfold
from experiments.campaigns.flight_row import empty_row
from experiments.campaigns.runner import CampaignRun, open_store, run_campaign
from experiments.campaigns.worker import FlightResult
from tests.experiments.inline_workers import InlineWorkers

TEXT = """
description: A test.
controllers: [dmrac]
cases:
  - {name: jet, scenario: figure8_wind, duration_s: 6, controllers: [l1]}
  - {name: calm, scenario: hover, duration_s: 6, controllers: [l1]}
  - {name: cold, scenario: hover, duration_s: 6}
  - {name: warm, scenario: hover, duration_s: 6, memory: [jet, calm], experience_controller: l1}
seeds: {count: 2}
"""


def campaign(text: str = TEXT) -> CampaignConfig:
    return fill(CampaignConfig, parse_yaml(text, "test"), "test")


def flown(folder: Path, fly: Callable[[FlightJob], FlightResult]) -> dict[str, FlightJob]:
    jobs: dict[str, FlightJob] = {}

    def noted(job: FlightJob) -> FlightResult:
        jobs[job.key] = job
        return fly(job)

    with open_store(folder) as store:
        run_campaign(CampaignRun(campaign(), "test", folder), store, InlineWorkers(noted), lambda progress: None)
    return jobs


def pretend(job: FlightJob) -> FlightResult:
    row = empty_row() | {"key": job.key, "case": job.case, "seed": job.seed, "survived": True}
    taught = f"lesson of {job.key}".encode() if job.keep_experience else None
    return FlightResult(job.key, row, experience=taught, memory=b"memory" if job.memory else None)


def test_the_lessons_of_all_sources_reach_the_flight(tmp_path: Path) -> None:
    jobs = flown(tmp_path, pretend)
    warm = jobs["warm/dmrac/1001"]
    assert warm.lessons == (b"lesson of jet/l1/1001", b"lesson of calm/l1/1001")
    assert warm.experience is None
    assert jobs["jet/l1/1001"].teaches
    assert not jobs["cold/dmrac/1001"].sources
    assert memory_path(tmp_path, warm.memory).read_bytes() == b"memory"
    assert f"--memory {memory_path(tmp_path, warm.memory)}" in warm.command(tmp_path)


def test_sources_fly_first(tmp_path: Path) -> None:
    order = list(flown(tmp_path, pretend))
    assert max(order.index(f"{case}/l1/{seed}") for case in ("jet", "calm") for seed in (1000, 1001)) < min(
        order.index(f"warm/dmrac/{seed}") for seed in (1000, 1001)
    )


def test_a_source_that_teaches_nothing_fails_the_flight(tmp_path: Path) -> None:
    jobs = flown(tmp_path, lambda job: replace(pretend(job), experience=None) if job.case == "calm" else pretend(job))
    assert "warm/dmrac/1000" not in jobs


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            TEXT.replace("memory: [jet, calm]", "memory: [jet, elsewhere]"),
            "case warm: memory: there is no case elsewhere",
        ),
        (TEXT.replace("memory: [jet,", "experience: jet, memory: ["), "memory: not allowed with experience"),
        (
            TEXT.replace("name: cold, scenario: hover", "name: cold, memory: [warm], scenario: hover"),
            "case cold: memory: warm itself starts from another case",
        ),
        (
            TEXT.replace("name: cold, scenario: hover", "name: cold, experience: jet, scenario: hover"),
            "case warm: memory: jet is the experience of another case",
        ),
    ],
)
def test_a_memory_of_unsuitable_cases_is_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        campaign(text)


def test_the_shipped_campaign_starts_each_memory_from_other_vehicles_and_places() -> None:
    shipped, _ = load_campaign("memory")
    jobs = {job.key: job for job in unfold(shipped, "memory", 1)}
    for job in jobs.values():
        if job.memory:
            assert job.sources
            assert all(jobs[source].teaches and jobs[source].controller == "l1" for source in job.sources)
