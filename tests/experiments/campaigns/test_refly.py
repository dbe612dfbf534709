"""Repeated flights: the same to the bit, or different."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from async_dmrac.command_line import main
from configs.loader import ConfigError, fill, parse_yaml
from experiments.campaigns import flown as flown_module
from experiments.campaigns.campaign import CampaignConfig
from experiments.campaigns.flight_jobs import FlightJob
from experiments.campaigns.flight_row import Row, empty_row
from experiments.campaigns.flown import FlownCampaign, publish, read_flown
from experiments.campaigns.provenance import here, kernels_of, openblas_kernels, other_kernels
from experiments.campaigns.refly import Reflown, core_statistics, pick, refly
from experiments.campaigns.runner import CampaignRun, Progress, open_store, prepare_folder, run_campaign
from experiments.campaigns.worker import FlightResult, fly_job
from tests.experiments.inline_workers import InlineWorkers

TEXT = """
description: A test.
controllers: [none, pid]
cases:
  - {name: source, scenario: hover, duration_s: 5}
  - {name: warm, scenario: hover, duration_s: 5, experience: source}
seeds: {count: 3}
"""


def made_up(job: FlightJob, **other: Any) -> FlightResult:
    row = empty_row() | {"key": job.key, "case": job.case, "controller": job.controller, "seed": job.seed}
    row |= {"survived": True, "trace_sha256": f"hash of {job.key}", "position_rmse_m": 0.01} | other
    return FlightResult(job.key, row, experience=b"learnt" if job.keep_experience else None)


def flown(folder: Path, fly: Callable[[FlightJob], FlightResult] = made_up, text: str = TEXT) -> FlownCampaign:
    run = CampaignRun(fill(CampaignConfig, parse_yaml(text, "test"), "test"), "test", folder)
    prepare_folder(run, resume=False)
    with open_store(folder) as store:
        run_campaign(run, store, InlineWorkers(fly), silent)
    return read_flown(folder)


def silent(progress: Progress) -> None:
    pass


def test_a_repeated_flight_is_the_same_and_a_wrong_row_is_detected(tmp_path: Path) -> None:
    text = TEXT.replace("controllers: [none, pid]", "controllers: [pid]").replace("count: 3", "count: 1")
    campaign = flown(tmp_path / "flown", fly_job, text)
    (again,) = refly(campaign, ["source/pid/1000"], tmp_path / "again", InlineWorkers(fly_job), silent)
    assert again.same
    assert again.recorded["trace_sha256"]
    assert again.recorded["position_rmse_m"] == again.again["position_rmse_m"]

    recorded = again.recorded | {"trace_sha256": "0", "position_rmse_m": 0.5 * again.again["position_rmse_m"]}
    assert not replace(again, recorded=recorded).same


def test_the_source_of_an_experience_is_flown_first(tmp_path: Path) -> None:
    campaign = flown(tmp_path / "flown")
    workers = InlineWorkers(made_up)
    flights = refly(campaign, ["warm/pid/1001", "source/none/1002"], tmp_path / "again", workers, silent)
    assert workers.flown == ["source/pid/1001", "source/none/1002", "warm/pid/1001"]
    assert [flight.recorded["key"] for flight in flights] == ["warm/pid/1001", "source/none/1002"]
    assert all(flight.same for flight in flights)


def test_the_choice_is_repeatable_and_leaves_failed_flights_out(tmp_path: Path) -> None:
    def some_fail(job: FlightJob) -> FlightResult:
        return made_up(job, error="an error" if job.controller == "none" else "")

    campaign = flown(tmp_path / "flown", some_fail)
    assert pick(campaign, 3, 0) == pick(campaign, 3, 0)
    assert pick(campaign, 3, 0) != pick(campaign, 3, 1)
    every = [f"{case}/pid/{seed}" for case in ("source", "warm") for seed in (1000, 1001, 1002)]
    assert sorted(pick(campaign, 100, 0)) == every


def test_flights_of_every_controller_are_chosen(tmp_path: Path) -> None:
    """However few its flights are: a change of one law must not be missed."""
    text = TEXT.replace("{name: warm,", "{name: warm, controllers: [mrac],")
    campaign = flown(
        tmp_path / "flown", text=text.replace("experience: source", "experience: source, experience_controller: pid")
    )
    for seed in range(5):
        assert sorted(key.split("/")[1] for key in pick(campaign, None, seed)) == ["mrac", "none", "pid"]


def test_flights_of_other_first_seeds_are_found(tmp_path: Path) -> None:
    """`--resume` may continue with other seeds."""
    flown(tmp_path / "flown")
    run = CampaignRun(
        fill(CampaignConfig, parse_yaml(TEXT.replace("count: 3", "count: 1, first: 1010"), "t"), "t"),
        "test",
        tmp_path / "flown",
    )
    prepare_folder(run, resume=True)
    with open_store(run.folder) as store:
        run_campaign(run, store, InlineWorkers(made_up), silent)
    keys = ["source/pid/1000", "source/pid/1010"]
    flights = refly(read_flown(run.folder), keys, tmp_path / "again", InlineWorkers(made_up), silent)
    assert [flight.again["key"] for flight in flights] == keys


def test_a_machine_that_flies_nothing_is_not_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine is recorded if it flies, not by a `--resume` with nothing to fly."""
    assert len(flown(tmp_path / "flown").about.flown_on) == 1
    monkeypatch.setattr("experiments.campaigns.runner.here", lambda: "elsewhere")

    def resume(seeds: int) -> tuple[str, ...]:
        run = CampaignRun(fill(CampaignConfig, parse_yaml(TEXT, "t"), "t"), "test", tmp_path / "flown", seeds)
        prepare_folder(run, resume=True)
        with open_store(run.folder) as store:
            run_campaign(run, store, InlineWorkers(made_up), silent)
        return read_flown(run.folder).about.flown_on

    assert "elsewhere" not in resume(3)
    assert "elsewhere" in resume(4)


def test_other_linear_algebra_kernels_are_reported() -> None:
    """They are the most frequent reason why a flight is not the same to the bit on another machine."""
    place = here()
    assert kernels_of(place) == openblas_kernels()
    assert "numpy" in place
    older = "AMD EPYC, 2 cores in use, Linux 6; python 3.11.7, numpy 2.4.6; commit 234f4bd"
    line = "AMD EPYC, 2 cores in use, Linux 6, OpenBLAS kernels SkylakeX; python 3.11.7; commit 234f4bd"
    assert [kernels_of(text) for text in (older, line)] == ["", "SkylakeX"]
    assert other_kernels([older, line], "SkylakeX") == ""
    assert other_kernels([older], "Haswell") == ""
    assert "OPENBLAS_CORETYPE=SkylakeX" in other_kernels([older, line], "Haswell")


def test_differences_are_reported(tmp_path: Path) -> None:
    campaign = flown(tmp_path / "flown")
    told: list[str] = []
    outcomes: list[Row] = [
        {"trace_sha256": "other", "position_rmse_m": 0.012},
        {"trace_sha256": "other", "survived": False},
        {"trace_sha256": "", "error": "it broke"},
    ]
    for number, outcome in enumerate(outcomes):
        workers = InlineWorkers(lambda job, outcome=outcome: made_up(job, **outcome))
        (flight,) = refly(campaign, ["source/pid/1000"], tmp_path / str(number), workers, silent)
        assert not flight.same
        told.append(flight.difference)
    mm = "with a position RMSE of"
    assert told[0] == f"survived {mm} 10.00 mm, now survived {mm} 12.00 mm"
    assert told[1] == f"survived {mm} 10.00 mm, now lost {mm} 10.00 mm"
    assert told[2] == "failed: it broke"


def test_the_other_core_flies_the_same_flights_and_the_statistics_are_compared(tmp_path: Path) -> None:
    campaign = flown(tmp_path / "flown")
    keys, cores = pick(campaign, 100, 0), set[str]()

    def almost(job: FlightJob) -> FlightResult:
        cores.add(job.core)
        far = job.controller == "pid" and job.case == "source"
        lost = job.controller == "none" and job.case == "warm" and job.seed == 1001
        return made_up(job, position_rmse_m=0.0102 if far else 0.01005, survived=not lost, trace_sha256="other")

    flights = refly(campaign, keys, tmp_path / "again", InlineWorkers(almost), silent, "c")
    rows = {(row.case, row.controller): row for row in core_statistics(flights)}
    assert cores == {"c"}
    assert all(row.flights == 3 for row in rows.values())
    assert {key for key, row in rows.items() if not row.same} == {("source", "pid"), ("warm", "none")}
    assert rows["warm", "none"].survived == (3, 2)
    assert rows["source", "pid"].median_m == pytest.approx((0.01, 0.0102))


def test_statistics_without_survivors_have_no_median() -> None:
    lost = {"case": "a", "controller": "pid", "survived": False, "position_rmse_m": 1.0}
    (row,) = core_statistics([Reflown(lost, lost)])
    assert row.same
    assert math.isnan(row.median_m[0])


def test_only_flights_of_the_named_controllers_are_chosen(tmp_path: Path) -> None:
    campaign = flown(tmp_path / "flown")
    assert {key.split("/")[1] for key in pick(campaign, 100, 0, ["pid"])} == {"pid"}
    with pytest.raises(ConfigError, match=r"holds no flights of 'mrac'; it has pid"):
        pick(campaign, None, 0, ["pid", "mrac"])


def test_flights_of_other_settings_are_not_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = flown(tmp_path / "flown")
    monkeypatch.setattr(flown_module, "fingerprint", lambda tree, core: "another")
    with pytest.raises(ConfigError, match=r"flown: its flights were made with other settings.*cannot be repeated"):
        pick(campaign, None, 0)
    places = ("one machine; commit abc1234, abc1235-dirty", "another; commit def5678")
    published = replace(campaign, about=campaign.about.model_copy(update={"flown_on": places}))
    with pytest.raises(ConfigError, match=r"these; check out commit abc1234 or def5678, which flew them$"):
        pick(published, None, 0)


def test_nothing_is_flown_if_one_place_is_bad(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flown(tmp_path / "flown")
    empty = tmp_path / "empty"
    prepare_folder(CampaignRun(read_flown(tmp_path / "flown").config, "test", empty), resume=False)
    assert main(["refly", str(tmp_path / "flown"), str(empty)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == f"dmrac refly: {empty}: holds no flights yet\n"


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("campaign.yaml", b"- a list", "campaign.yaml: holds list, expected a mapping"),
        ("campaign.yaml", b"name: test", "campaign.yaml: fingerprint"),
        ("campaign.yaml", b"\xff\xfe", "campaign.yaml: cannot be read"),
        ("flights.parquet", b"junk", "its rows cannot be read"),
    ],
)
def test_a_damaged_folder_is_a_plain_error(file: str, content: bytes, message: str, tmp_path: Path) -> None:
    flown(tmp_path / "flown")
    (tmp_path / "flown" / file).write_bytes(content)
    with pytest.raises(ConfigError, match=message):
        read_flown(tmp_path / "flown")


def test_parquet_of_something_else_is_a_plain_error(tmp_path: Path) -> None:
    campaign = flown(tmp_path / "flown")
    about = {b"campaign.yaml": campaign.about.file_content()}
    file = tmp_path / "other.parquet"
    other = pa.table({"x": [1.0]})
    pq.write_table(other, file)
    with pytest.raises(ConfigError, match="name no campaign"):
        read_flown(file)
    pq.write_table(other.replace_schema_metadata(about), file)
    with pytest.raises(ConfigError, match="not flights of a campaign"):
        read_flown(file)


def test_published_rows_equal_those_of_the_folder(tmp_path: Path) -> None:
    campaign = flown(tmp_path / "flown")
    publish(tmp_path / "flown", tmp_path / "rows.parquet")
    published = read_flown(tmp_path / "rows.parquet")
    assert repr(published.table.to_pylist()) == repr(campaign.table.to_pylist())  # NaN equals itself there
    assert replace(published, place=campaign.place, table=campaign.table) == campaign


@pytest.mark.full
def test_the_command_flies_in_processes_and_returns_its_status(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = TEXT.replace("controllers: [none, pid]", "controllers: [pid]").replace("count: 3", "count: 1")
    flown(tmp_path / "flown", fly_job, text)
    publish(tmp_path / "flown", tmp_path / "rows.parquet")
    assert main(["refly", str(tmp_path / "flown"), str(tmp_path / "rows.parquet"), "--sample", "1"]) == 0
    out = capsys.readouterr().out
    assert out.count("test: 1 of 2 flights flown again, 1 of them the same to the bit") == 2

    table = pq.read_table(tmp_path / "rows.parquet")
    rows = [row | {"trace_sha256": "0"} for row in table.to_pylist()]
    pq.write_table(type(table).from_pylist(rows, schema=table.schema), tmp_path / "rows.parquet")
    assert main(["refly", str(tmp_path / "rows.parquet"), "--sample", "1"]) == 1
    assert "0 of them the same to the bit" in capsys.readouterr().out
