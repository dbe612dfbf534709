"""Campaigns, searches and attacks with the onboard core in C: flown by it, named, and never mixed with numpy's."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from async_dmrac.command_line import main
from configs.loader import ConfigError, fill, parse_yaml
from experiments.attacks.attack_flight import fly_attack
from experiments.campaigns.campaign import CampaignConfig
from experiments.campaigns.fingerprint import fingerprint
from experiments.campaigns.flight_jobs import unfold
from experiments.campaigns.flown import read_flown
from experiments.campaigns.refly import refly
from experiments.campaigns.runner import CampaignRun, open_store, prepare_folder, run_campaign
from experiments.campaigns.tuning import Search, load_tuning, open_study, search_record, trial_jobs
from experiments.campaigns.worker import fly_job
from experiments.flights import lockstep_flight
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.cores import CORES, AnyCore, build_core
from tests.experiments.inline_workers import InlineWorkers

TEXT = """
description: A test.
controllers: [mrac]
cases:
  - {name: source, scenario: hover, duration_s: 5}
  - {name: warm, scenario: hover, duration_s: 5, experience: source}
seeds: {count: 1}
"""


def campaign(text: str = TEXT) -> CampaignConfig:
    return fill(CampaignConfig, parse_yaml(text, "test"), "test")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a campaign that the C core flew."""
    folder = tmp_path_factory.mktemp("campaign") / "flown"
    run = CampaignRun(campaign(), "test", folder, core="c")
    prepare_folder(run, resume=False)
    with open_store(folder) as store:
        run_campaign(run, store, InlineWorkers(fly_job), lambda progress: None)
    return folder


def test_the_c_core_flies_a_campaign_and_its_commands_name_it(flown: Path) -> None:
    rows = {row["case"]: row for row in read_flown(flown).table.to_pylist()}
    assert [row["error"] for row in rows.values()] == ["", ""]
    assert all("--core c" in row["command"] for row in rows.values())
    config = resolve("hover", Choices("mrac", seed=1000, duration_s=5.0))
    assert rows["source"]["trace_sha256"] == fly_lockstep(config, core="c").trace_sha256
    assert rows["warm"]["trace_sha256"] != rows["source"]["trace_sha256"], "it starts from what the other one learnt"


@pytest.mark.parametrize("core", CORES)
def test_a_worker_flies_the_core_of_its_job(core: str, monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[str] = []

    def note(name: str, *others: Any) -> AnyCore:
        built.append(name)
        return build_core(name, *others)

    monkeypatch.setattr(lockstep_flight, "build_core", note)
    job = next(unfold(campaign(), "test", core=core))
    assert fly_job(job).row["error"] == ""
    assert built == [core]


def test_the_command_of_a_row_repeats_its_flight(flown: Path, tmp_path: Path) -> None:
    row = next(row for row in read_flown(flown).table.to_pylist() if row["case"] == "source")
    assert main([*shlex.split(row["command"])[1:], "--out", str(tmp_path / "again")]) == 0
    summary = yaml.safe_load((tmp_path / "again" / "summary.json").read_text(encoding="utf-8"))
    assert summary["trace_sha256"] == row["trace_sha256"]


def test_a_repeated_flight_is_flown_by_the_same_core(flown: Path, tmp_path: Path) -> None:
    again = refly(
        read_flown(flown), ["warm/mrac/1000"], tmp_path / "again", InlineWorkers(fly_job), lambda progress: None
    )
    assert [flight.same for flight in again] == [True]


@pytest.mark.parametrize(("first", "then"), [("c", "numpy"), ("numpy", "c")])
def test_flights_of_two_cores_are_not_mixed(first: str, then: str, tmp_path: Path) -> None:
    prepare_folder(CampaignRun(campaign(), "test", tmp_path, core=first), resume=False)
    prepare_folder(CampaignRun(campaign(), "test", tmp_path, core=first), resume=True)
    with pytest.raises(ConfigError, match=rf"--core {then}: the flights in .* were flown with --core {first}"):
        prepare_folder(CampaignRun(campaign(), "test", tmp_path, core=then), resume=True)
    about = tmp_path / "campaign.yaml"
    about.write_text(about.read_text(encoding="utf-8").replace(f"core: {first}", f"core: {then}"), encoding="utf-8")
    with pytest.raises(ConfigError, match="other settings"):  # the fingerprint names the core as well
        prepare_folder(CampaignRun(campaign(), "test", tmp_path, core=then), resume=True)


def test_rows_of_before_there_were_two_cores_are_numpys(tmp_path: Path) -> None:
    prepare_folder(CampaignRun(campaign(), "test", tmp_path), resume=False)
    about = tmp_path / "campaign.yaml"
    about.write_text(about.read_text(encoding="utf-8").replace("core: numpy\n", ""), encoding="utf-8")
    prepare_folder(CampaignRun(campaign(), "test", tmp_path), resume=True)
    assert fingerprint(campaign()) == fingerprint(campaign(), "numpy") != fingerprint(campaign(), "c")


def test_a_controller_that_c_does_not_have_is_refused_before_the_first_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = "from onboard.control.cascade import CascadedController\nclass Mine(CascadedController):\n    pass\n"
    (tmp_path / "mine_for_two_cores.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    tree = parse_yaml(Path("configs/controllers/pid.yaml").read_text(encoding="utf-8"), "pid")
    own = tmp_path / "own.yaml"
    own.write_text(yaml.safe_dump(tree | {"class": "mine_for_two_cores:Mine"}), encoding="utf-8")
    run = CampaignRun(campaign(TEXT.replace("[mrac]", f"[pid, {own}]")), "test", tmp_path / "out", core="c")
    with pytest.raises(ConfigError, match=r"--core c: controller\.class: .*is not in the C core"):
        prepare_folder(run, resume=False)
    assert not (tmp_path / "out").exists()
    prepare_folder(replace(run, core="numpy"), resume=False)


def test_a_flight_with_wrong_settings_is_left_to_its_row(tmp_path: Path) -> None:
    wrong = campaign(TEXT.replace("duration_s: 5}", "duration_s: 5, set: {vehicle.no_such_key: 1}}"))
    prepare_folder(CampaignRun(wrong, "test", tmp_path, core="c"), resume=False)


def test_a_search_flies_its_core_and_has_its_own_journal(tmp_path: Path) -> None:
    config = load_tuning("tune")[0].model_copy(update={"corners": (), "starts": ()})
    by_numpy = Search(config, "tune", "pid", 3)
    by_c = replace(by_numpy, core="c")
    gains = {one.name: one.low for one in config.space("pid")}
    assert {job.core for _, job in trial_jobs(by_c, gains, 0)} == {"c"}
    assert {job.core for _, job in trial_jobs(by_numpy, gains, 0)} == {"numpy"}
    study = open_study(by_c, tmp_path)
    study.tell(study.ask(), 0.1)
    assert len(open_study(by_numpy, tmp_path).trials) == 1, "the other core's search begins at its start"
    assert sorted(file.name for file in tmp_path.glob("*.journal")) == ["pid.journal", "pid_core_c.journal"]
    assert search_record(by_c, study)[0].endswith("--trials 3 --core c")


def test_numpys_jobs_name_no_core() -> None:
    assert all("--core" not in job.command() for job in unfold(campaign(), "test"))


def test_the_c_core_withstands_a_bad_learner() -> None:
    outcome = fly_attack("steep", 1, core="c")
    assert not outcome.lost
    assert outcome.refused


@pytest.mark.parametrize(
    "command", [["campaign", "rotor_chip"], ["tune", "tune", "--controller", "pid", "--trials", "1"]]
)
def test_an_unknown_core_is_refused(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([*command, "--core", "fortran"])
    assert "invalid choice: 'fortran'" in capsys.readouterr().err
