"""The folder of a campaign that nobody flew."""

from pathlib import Path

import pytest

from configs.loader import fill, parse_yaml
from experiments.campaigns.campaign import CampaignConfig
from experiments.campaigns.flight_jobs import unfold
from experiments.campaigns.flight_row import empty_row
from experiments.campaigns.runner import CampaignRun, note_place, prepare_folder
from experiments.campaigns.store import CampaignStore
from runtime.files import write_atomically
from tests.experiments.results.made_up import TEXT, made_up_row, made_up_trace


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    config = fill(CampaignConfig, parse_yaml(TEXT, "test"), "test")
    prepare_folder(CampaignRun(config, "made_up", folder), resume=False)
    note_place(folder)
    store = CampaignStore(folder)
    (folder / "traces").mkdir()
    for job in unfold(config, "made_up"):
        store.append(made_up_row(job))
        if job.keep_trace:
            write_atomically(folder / "traces" / f"{job.file_stem}.npz", made_up_trace())
    store.append(empty_row() | {"key": "broken", "error": "a worker died", "command": "dmrac fly x"})
    store.close()
    return folder
