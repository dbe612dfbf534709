"""Published rows: they can be extended on another machine."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from configs.loader import CONFIG_DIRECTORY, ConfigError, read_tree
from experiments.campaigns import flown
from experiments.campaigns.flight_jobs import FlightJob
from experiments.campaigns.flight_row import SCHEMA, Row, empty_row
from experiments.campaigns.flown import CAMPAIGN_FILE, read_flown
from experiments.campaigns.provenance import by_place
from experiments.campaigns.runner import prepare_folder
from experiments.campaigns.store import CampaignStore
from experiments.campaigns.worker import FlightResult
from experiments.results import campaign_data
from experiments.results.campaign_data import load_data
from experiments.results.figure_plan import draw_all
from experiments.results.figure_style import new_figure, save
from experiments.results.reproduction import (
    OTHER_SETTINGS,
    Reproduction,
    copy_published,
    draw,
    fly,
    publish_rows,
    write_results,
)
from tests.experiments.inline_workers import InlineWorkers


def unflown_row(job: FlightJob) -> Row:
    return empty_row() | {
        "key": job.key,
        "case": job.case,
        "controller": job.controller,
        "seed": job.seed,
        "point": "{}",
    }


def published(folder: Path) -> Reproduction:
    """A page with two rows and a picture of the campaign `features`."""
    plan = Reproduction(folder / "flown", folder / "docs" / "results.md", quick=False, seeds=2, only=("features",))
    run = plan.run("features")
    prepare_folder(run, resume=False)
    store = CampaignStore(run.folder)
    for job in run.jobs():
        store.append(unflown_row(job))
    store.close()
    publish_rows(plan, "features")
    picture = folder / "docs" / "pictures" / "results" / "features_02_training.png"
    picture.parent.mkdir(parents=True)
    probe, training = (json.dumps(entry, sort_keys=True) for entry in run.campaign.figures)
    for name in ("features_01_features_position", "features_01_features_attitude"):
        save(new_figure(1.0, 1.0), picture.parent, name, probe)
    save(new_figure(1.0, 1.0), picture.parent, picture.stem, training)
    cells = {"caption": "Linear probe", "header": ["features", "accuracy"], "rows": [["after", "0.9"]]}
    (picture.parent / "features_01_features.json").write_text(json.dumps(cells))
    picture.with_name("features_of_others.png").write_bytes(b"another's")
    return plan


def test_published_rows_are_extended_on_another_machine(tmp_path: Path) -> None:
    """Another machine flies the missing rows, and the campaign records where each part was flown."""
    before = published(tmp_path)
    plan = replace(before, folder=tmp_path / "elsewhere", seeds=3)
    assert copy_published(plan, "features", extended=True) == 2
    assert copy_published(plan, "features", extended=True) == 0  # existing flights are not replaced
    flown: list[str] = []

    def fly_nothing(job: FlightJob) -> FlightResult:
        flown.append(job.key)
        return FlightResult(job.key, unflown_row(job))

    fly(plan, "features", lambda: InlineWorkers(fly_nothing), lambda progress: None)
    assert flown == ["regimes/dmrac/1002"]
    data = load_data(plan.folder / "features")
    assert [row["seed"] for row in data.rows] == [1000, 1001, 1002]
    assert len(data.flown_on) == 1
    assert "numpy" in data.flown_on[0]
    reported: list[str] = []
    pictures, tables = draw_all(data, plan.folder / "features" / "figures", reported.append)
    drawn = plan.page.parent / "pictures" / "results"
    assert [one.png.read_bytes() for one in pictures] == [(drawn / one.png.name).read_bytes() for one in pictures]
    assert len(pictures) == 3
    assert [table.rows for table in tables] == [(("after", "0.9"),)]
    assert all("not redrawn" in text for text in reported)


def test_published_rows_of_other_settings_are_not_extended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = replace(published(tmp_path), folder=tmp_path / "elsewhere")
    monkeypatch.setattr(flown, "fingerprint", lambda tree, core: "another")
    with pytest.raises(ConfigError, match=r"features.parquet: .* made with other settings.*--only features"):
        copy_published(plan, "features", extended=True)
    assert not (plan.folder / "features").exists()


def test_published_rows_of_other_settings_stay_on_the_page_which_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = replace(published(tmp_path), folder=tmp_path / "elsewhere", only=())
    assert copy_published(plan, "features", extended=False) == 2
    for fingerprints, said in (({}, False), ({"Then.": "another"}, True)):
        monkeypatch.setattr(campaign_data, "fingerprint", lambda one, f=fingerprints: f.get(one.description, "one"))
        folder = tmp_path / f"page {said}"
        shutil.copytree(plan.folder / "features", folder / "features")
        if said:
            about = read_tree(folder / "features" / CAMPAIGN_FILE)
            about["campaign"] |= {"title": "Then", "description": "Then."}
            (folder / "features" / CAMPAIGN_FILE).write_text(yaml.safe_dump(about), encoding="utf-8")
        here = replace(plan, folder=folder)
        write_results(here, [draw(here, "features", lambda text: None)])
        page = plan.page.read_text(encoding="utf-8")
        assert (OTHER_SETTINGS in page, "## Then" in page) == (said, said)


def test_other_campaigns_stay_on_the_page(tmp_path: Path) -> None:
    before = published(tmp_path)
    assert replace(before, only=("retention",)).shown == ("retention",)
    plan = replace(before, only=("retention",), extend=True)
    assert plan.shown == ("retention", "features")
    assert plan.command == "dmrac reproduce --extend --seeds 2 --only retention"


def test_machines_are_listed_once() -> None:
    here, elsewhere = "AMD EPYC, 2 cores; python 3.11.2", "AMD EPYC, 2 cores; python 3.11.7"
    lines = (f"{here}; commit 1a", elsewhere, f"{here}; commit 2b-dirty", f"{elsewhere}; commit 1a")
    assert by_place(lines) == (f"{here}; commit 1a, 2b-dirty", f"{elsewhere}; commit 1a")


def test_a_picture_of_another_entry_is_not_shown(tmp_path: Path) -> None:
    """Its name contains only the number of its entry and the kind: after a change of the entry it would be wrong."""
    plan = published(tmp_path)
    data = load_data(plan.folder / "features")
    pictures = plan.page.parent / "pictures" / "results"
    assert len(draw_all(data, pictures, lambda text: None)[0]) == 3
    changed = tuple(entry | {"case": "regimes", "controllers": ["mrac"]} for entry in data.config.figures[1:])
    figures = (*data.config.figures[:1], *changed)
    reported: list[str] = []
    kept, _ = draw_all(
        replace(data, config=data.config.model_copy(update={"figures": figures})), pictures, reported.append
    )
    assert len(kept) == 2
    assert "features_02_training: left out" in reported[-1]


def test_the_published_rows_are_read_with_the_columns_of_today() -> None:
    for file in sorted((CONFIG_DIRECTORY.parent / "docs" / "data").glob("*.parquet")):
        table = read_flown(file).table
        assert table.column_names == SCHEMA.names
        assert table.column("settled_rmse_m").null_count < table.num_rows
