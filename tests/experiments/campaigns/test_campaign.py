"""Campaigns: their flights, interruption and continuation, and flights in real worker processes."""

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import pytest

from async_dmrac.command_line import build_parser
from configs.loader import CONFIG_DIRECTORY, ConfigError, fill, parse_yaml, read_tree
from experiments.campaigns.campaign import CampaignConfig, load_campaign
from experiments.campaigns.flight_jobs import FlightJob, unfold
from experiments.campaigns.flight_row import empty_row, recovery_s
from experiments.campaigns.runner import CampaignRun, Progress, open_store, prepare_folder, run_campaign
from experiments.campaigns.store import JOURNAL, PARQUET, CampaignStore, read_table
from experiments.campaigns.worker import FlightResult, fly_job
from experiments.campaigns.worker_pools import DaskWorkers, LocalPool
from experiments.flights.scenario import Choices, resolve
from tests.dask_cluster import running_cluster
from tests.experiments.inline_workers import InlineWorkers

TEXT = """
description: A test.
controllers: [none, pid]
cases:
  - {name: source, scenario: hover, duration_s: 6, swept: false}
  - name: chip
    scenario: rotor_chip
    duration_s: 8
    draws: [{path: vehicle.disturbances.0.onset_s, uniform: [3.0, 4.0]},
            {path: vehicle.disturbances.0.rotor, choice: [1, 2, 3, 4]}]
  - {name: warm, scenario: hover, duration_s: 6, experience: source, swept: false}
sweeps: [{name: factor, path: vehicle.disturbances.0.thrust_factor, values: [0.7, 0.9]}]
seeds: {count: 3}
"""


def campaign(text: str = TEXT) -> CampaignConfig:
    return fill(CampaignConfig, parse_yaml(text, "test"), "test")


def campaign_run(folder: Path, text: str = TEXT) -> CampaignRun:
    return CampaignRun(campaign(text), "test", folder)


def silent(progress: Progress) -> None:
    pass


def stop_after(count: int) -> Callable[[Progress], None]:
    def report(progress: Progress) -> None:
        if progress.flown == count:
            raise KeyboardInterrupt

    return report


def pretend(job: FlightJob) -> FlightResult:
    row = empty_row() | {"key": job.key, "case": job.case, "seed": job.seed, "survived": True}
    return FlightResult(job.key, row, experience=b"learnt" if job.keep_experience else None)


def fly_all(folder: Path, workers: Any, text: str = TEXT, report: Callable[[Progress], None] = silent) -> Progress:
    with open_store(folder) as store:
        return run_campaign(campaign_run(folder, text), store, workers, report)


def test_every_combination_is_flown_once() -> None:
    jobs = list(unfold(campaign(), "test"))
    keys = [job.key for job in jobs]
    assert len(set(keys)) == len(keys) == 3 * 2 * (1 + 2 + 1)
    assert "chip/factor=0.7/pid/1000" in keys
    assert keys.index("warm/none/1000") > max(i for i, key in enumerate(keys) if key.startswith("source/"))


def test_all_controllers_get_the_same_random_values() -> None:
    deliveries: dict[int, set[str]] = {}
    for job in unfold(campaign(), "test"):
        if job.case == "chip":
            drawn = [item for item in job.assignments if "thrust_factor" not in item]
            deliveries.setdefault(job.seed, set()).add(json.dumps(drawn))
    assert [len(delivery) for delivery in deliveries.values()] == [1, 1, 1]
    assert len(set.union(*deliveries.values())) == 3


def test_the_command_repeats_the_flight() -> None:
    job = next(job for job in unfold(campaign(), "test") if job.case == "chip")
    words = shlex.split(job.command())
    assert words[0] == "dmrac"
    given = build_parser("fly").parse_args(words[1:])
    assert given.lockstep
    again = resolve(given.scenario, Choices(given.controller, given.seed, given.duration, given.assignments))
    assert again == resolve(job.scenario, Choices(job.controller, job.seed, job.duration_s, job.assignments))
    assert again.vehicle.disturbances[0].thrust_factor == 0.7  # type: ignore[union-attr]


def test_a_case_cannot_start_from_an_unknown_case() -> None:
    with pytest.raises(ConfigError, match="there is no case elsewhere"):
        campaign(TEXT.replace("experience: source", "experience: elsewhere"))


def test_an_interrupted_campaign_resumes_without_repeating_or_losing_flights(tmp_path: Path) -> None:
    expected = sorted(job.key for job in unfold(campaign(), "test"))

    kept: list[str] = []
    for count in (1, 5, 9):
        with pytest.raises(KeyboardInterrupt):
            fly_all(tmp_path, InlineWorkers(pretend), report=stop_after(count))
        now = read_table(tmp_path).column("key").to_pylist()
        assert now[: len(kept)] == kept
        assert len(set(now)) == len(now) == len(kept) + count
        kept = now
    workers = InlineWorkers(pretend)
    progress = fly_all(tmp_path, workers)
    assert progress.done == progress.total == len(expected)
    assert sorted(kept + workers.flown) == expected
    assert sorted(read_table(tmp_path).column("key").to_pylist()) == expected
    assert (tmp_path / PARQUET).exists()
    assert not (tmp_path / JOURNAL).exists()


def test_experience_of_the_source_reaches_the_flight(tmp_path: Path) -> None:
    given: dict[str, bytes | None] = {}

    def fly(job: FlightJob) -> FlightResult:
        given[job.key] = job.experience
        return pretend(job)

    fly_all(tmp_path, InlineWorkers(fly))
    assert given["warm/pid/1001"] == b"learnt"
    assert given["source/pid/1001"] is None


def test_a_flight_is_tried_again_if_its_worker_dies(tmp_path: Path) -> None:
    deaths: dict[str, int] = {}

    def fly(job: FlightJob) -> FlightResult:
        if job.key == "source/pid/1000" or (job.key == "source/none/1001" and job.key not in deaths):
            deaths[job.key] = deaths.get(job.key, 0) + 1
            raise BrokenProcessPool("a process was terminated")
        return pretend(job)

    progress = fly_all(tmp_path, InlineWorkers(fly))
    rows = {row["key"]: row for row in read_table(tmp_path).to_pylist()}
    assert deaths == {"source/pid/1000": 2, "source/none/1001": 1}
    assert "worker failed" in rows["source/pid/1000"]["error"]
    assert "left no experience" in rows["warm/pid/1000"]["error"]
    assert rows["source/none/1001"]["error"] == ""
    assert progress.errors == 2


def test_a_flight_that_kills_its_worker_affects_no_other(tmp_path: Path) -> None:
    """A broken pool loses all flights under way: they are tried again one by one."""

    class Pool(InlineWorkers):
        def open(self) -> Executor:
            self.opened += 1
            broken: list[bool] = []
            waiting: list[tuple[FlightJob, Future[FlightResult]]] = []

            def answer() -> None:
                jobs, waiting[:] = list(waiting), []
                broken.extend(job.key == "source/none/1001" for job, _ in jobs)
                for job, future in jobs:
                    if any(broken):
                        future.set_exception(BrokenProcessPool("a process was terminated"))
                    else:
                        future.set_result(pretend(job))

            class Together(Executor):
                def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> "Future[Any]":
                    if any(broken):
                        raise BrokenProcessPool("broken before")
                    future: Future[Any] = Future()
                    waiting.append((args[0], future))
                    threading.Timer(0.1, answer).start()
                    return future

            return Together()

    progress = fly_all(tmp_path, Pool(pretend))
    rows = read_table(tmp_path).to_pylist()
    # The second flight starts from what the first would have learnt.
    assert [row["key"] for row in rows if row["error"]] == ["source/none/1001", "warm/none/1001"]
    assert progress.done == progress.total == len(rows)


def test_a_source_without_its_experience_is_repeated_for_others(tmp_path: Path) -> None:
    """Published rows come without the experience that other flights start from."""
    workers = InlineWorkers(pretend)
    with pytest.raises(KeyboardInterrupt):
        fly_all(tmp_path, workers, report=stop_after(4))
    shutil.rmtree(tmp_path / "experience")
    sources, again = list(workers.flown), InlineWorkers(pretend)
    progress = fly_all(tmp_path, again)
    rows = read_table(tmp_path).to_pylist()
    assert len({row["key"] for row in rows}) == len(rows) == progress.total == progress.done
    assert not any(row["error"] for row in rows)
    assert {key for key in sources if key.startswith("source/pid")} <= set(again.flown)
    assert fly_all(tmp_path, again).flown == 0


def test_rows_of_an_incomplete_journal(tmp_path: Path) -> None:
    lines = [json.dumps(empty_row() | {"key": key}) + "\n" for key in ("a", "b")]
    (tmp_path / JOURNAL).write_text("".join(lines) + '{"key": "c", "surv', encoding="utf-8")
    assert read_table(tmp_path).column("key").to_pylist() == ["a", "b"]
    again = CampaignStore(tmp_path)
    assert again.done == {"a", "b"}
    again.append(empty_row() | {"key": "c"})
    again.close()
    assert read_table(tmp_path).column("key").to_pylist() == ["a", "b", "c"]


def test_a_row_in_both_files_counts_once(tmp_path: Path) -> None:
    """The process died between renaming the Parquet file and deleting the journal."""
    store = CampaignStore(tmp_path)
    store.append(empty_row() | {"key": "a", "swaps": 3})
    journal = (tmp_path / JOURNAL).read_bytes()
    store.close()
    (tmp_path / JOURNAL).write_bytes(journal)
    assert read_table(tmp_path).column("swaps").to_pylist() == [3]


def test_two_campaigns_do_not_share_a_folder(tmp_path: Path) -> None:
    with (
        open_store(tmp_path),
        pytest.raises(ConfigError, match="another campaign is writing there"),
        open_store(tmp_path),
    ):
        pass


@pytest.mark.parametrize("listed", ["[a/mine.yaml, b/mine.yaml]", "[pid, pid]", "[none, my/none.yaml]"])
def test_two_controllers_of_the_same_name_are_refused_because_their_flights_would_be_one(listed: str) -> None:
    with pytest.raises(ConfigError, match=r"controllers: .* and .* have the same name"):
        campaign(TEXT.replace("[none, pid]", listed))


@pytest.mark.parametrize(
    ("together", "message"),
    [
        ("[[chip, ghost]]", "case ghost does not exist; allowed are source, chip, warm"),
        ("[[chip], [chip]]", "chip is listed"),
    ],
)
def test_cases_under_the_same_conditions_exist_and_are_listed_once(together: str, message: str) -> None:
    with pytest.raises(ConfigError, match=f"same_conditions: .*{message}"):
        campaign(TEXT + f"same_conditions: {together}\n")


def test_a_folder_is_for_one_campaign(tmp_path: Path) -> None:
    prepare_folder(campaign_run(tmp_path), resume=False)
    with pytest.raises(ConfigError, match="add --resume"):
        prepare_folder(campaign_run(tmp_path), resume=False)
    prepare_folder(campaign_run(tmp_path, TEXT.replace("count: 3", "count: 5")), resume=True)
    with pytest.raises(ConfigError, match="changed"):
        prepare_folder(campaign_run(tmp_path, TEXT.replace("0.7", "0.75")), resume=True)


def test_recovery_ends_at_the_start_of_the_first_second_of_small_error() -> None:
    import numpy as np

    since = np.arange(-1.0, 5.0, 0.005)
    error = np.where((since > 0.2) & (since < 0.6), 0.3, 0.01)
    assert recovery_s(since, error) == pytest.approx(0.6, abs=0.01)
    error[(since > 1.5) & (since < 1.6)] = 0.3  # relapse before the second was full
    assert recovery_s(since, error) == pytest.approx(1.6, abs=0.01)
    assert recovery_s(since, np.full(since.size, 0.01)) == 0.0
    assert np.isnan(recovery_s(since, np.full(since.size, 0.3)))


@pytest.mark.parametrize("path", sorted((CONFIG_DIRECTORY / "campaigns").glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_campaigns_resolve(path: Path) -> None:
    if "own" in read_tree(path):
        pytest.skip("a tuning campaign: test_tuning.py")
    config, _ = load_campaign(str(path))
    seen = set()
    for job in unfold(config, path.stem, seeds=1):
        kind = (job.case, job.point and json.dumps(job.point))
        if kind not in seen or job.controller not in seen:
            seen |= {kind, job.controller}
            resolve(job.scenario, Choices(job.controller, job.seed, job.duration_s, job.assignments))


SHORT = """
description: A flight, and one that cannot be flown.
controllers: [none]
cases:
  - {name: hover, scenario: hover, duration_s: 6}
  - {name: wrong, scenario: hover, set: {onboard.guidance.look_ahead_s: -1.0}}
seeds: {count: 2}
traces: 1
"""


def test_flights_in_worker_processes(tmp_path: Path) -> None:
    progress = fly_all(tmp_path, LocalPool(1), SHORT.replace("count: 2", "count: 1"))
    rows = {row["key"]: row for row in read_table(tmp_path).to_pylist()}
    good, wrong = rows["hover/none/1000"], rows["wrong/none/1000"]
    assert (progress.flown, progress.errors) == (2, 1)
    assert good["survived"]
    assert 0.0 < good["position_rmse_m"] < 0.2
    assert good["up_bytes_s"] > 1000.0
    assert good["flown_s"] == pytest.approx(6.0, abs=0.01)
    assert "look_ahead_s" in wrong["error"]
    assert wrong["command"].startswith("dmrac fly hover --lockstep")
    here = fly_job(next(unfold(campaign(SHORT), "test")))
    assert here.row["trace_sha256"] == good["trace_sha256"]
    assert (tmp_path / "traces" / "hover__none__1000.npz").exists()


@pytest.mark.full
def test_killed_campaign_resumes(tmp_path: Path) -> None:
    """SIGKILL to a whole `dmrac campaign`, then --resume."""
    file = tmp_path / "short.yaml"
    file.write_text(SHORT.replace("count: 2", "count: 6"), encoding="utf-8")
    command = [sys.executable, "-m", "async_dmrac", "campaign", str(file)]
    command += ["--jobs", "2", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(
        command, cwd=Path(__file__).resolve().parents[3], start_new_session=True, stdout=subprocess.DEVNULL
    )
    journal = tmp_path / "out" / JOURNAL
    while not journal.exists() or journal.stat().st_size < 3000:
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = read_table(tmp_path / "out").column("key").to_pylist()
    assert 0 < len(before) < 12
    assert subprocess.run([*command, "--resume"], stdout=subprocess.DEVNULL, check=False).returncode == 1
    keys = read_table(tmp_path / "out").column("key").to_pylist()
    assert keys[: len(before)] == before
    assert sorted(keys) == sorted({job.key for job in unfold(campaign(SHORT), "test", seeds=6)})


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[str]:
    pytest.importorskip("distributed")
    with running_cluster(tmp_path) as address:
        yield address


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
def test_the_same_flights_on_a_cluster(cluster: str, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    short = SHORT.replace("count: 2", "count: 1")
    fly_all(here, LocalPool(1), short)
    fly_all(there, DaskWorkers(cluster), short)
    hashes = [{row["key"]: row["trace_sha256"] for row in read_table(folder).to_pylist()} for folder in (here, there)]
    assert hashes[0] == hashes[1]
    assert len(hashes[0]) == 2


def test_no_scheduler_is_a_plain_error() -> None:
    pytest.importorskip("distributed")
    with pytest.raises(ConfigError, match="no scheduler answers"):
        DaskWorkers("tcp://127.0.0.1:9")


WITHOUT_TORCH = """
import sys
sys.modules["torch"] = None  # any import of it now fails
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
outcome = fly_lockstep(resolve("hover", Choices(sys.argv[1], 1, 12.0, ("offboard.trainer.minimum_samples=100",))))
print(len(outcome.trace.time_s))
"""


@pytest.mark.parametrize(("controller", "flies"), [("mrac", True), ("dmrac", False)])
def test_only_flights_that_train_import_torch(controller: str, flies: bool) -> None:
    command = [sys.executable, "-c", WITHOUT_TORCH, controller]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (result.stdout == "2400\n") is flies, result.stderr
    assert flies or "torch" in result.stderr
