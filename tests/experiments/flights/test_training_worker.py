"""A lockstep flight is the same whether its rounds of training run in a process of their own or not."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from async_dmrac.command_line import main
from experiments.flights import training_worker
from experiments.flights.lockstep_flight import LockstepOutcome, fly_lockstep
from experiments.flights.scenario import Choices, resolve
from experiments.flights.training_worker import TrainingWorker, training_for
from offboard.training.fleet import Fleet, FleetJob
from offboard.training.job import TrainingJob
from sim_vehicle.lockstep import train_at_once

AT_ONCE = ("offboard.trainer.minimum_samples=60",)
"""The first version does not wait: a flight is short."""
CONFIG = resolve("figure8_wind", Choices("dmrac", seed=4, duration_s=11.0, assignments=AT_ONCE))


@pytest.fixture(scope="module")
def at_once() -> LockstepOutcome:
    outcome = fly_lockstep(CONFIG)
    assert outcome.onboard["features"]["swaps"] >= 1, "the flight should learn"
    return outcome


def assert_same(one: LockstepOutcome, other: LockstepOutcome) -> None:
    assert one.trace_sha256 == other.trace_sha256
    assert one.events == other.events
    assert one.offboard == other.offboard
    assert one.learnt == other.learnt
    assert len(one.offboard_records) == len(other.offboard_records)
    for (kind, when, vector), (same_kind, same_when, same) in zip(
        one.offboard_records, other.offboard_records, strict=True
    ):
        assert (kind, when) == (same_kind, same_when)
        np.testing.assert_array_equal(vector, same)


def test_a_worker_changes_nothing(at_once: LockstepOutcome) -> None:
    with TrainingWorker() as worker:
        assert_same(at_once, fly_lockstep(CONFIG, train=worker))


def test_the_rounds_of_a_worker_that_dies_are_run_here(at_once: LockstepOutcome) -> None:
    rounds = 0
    with TrainingWorker() as worker:

        def killing(job: Any) -> Any:
            nonlocal rounds
            rounds += 1
            if rounds == 3:
                assert worker.process.pid is not None
                os.kill(worker.process.pid, signal.SIGKILL)
            return worker(job)

        outcome = fly_lockstep(CONFIG, train=killing)
    assert rounds > 3
    assert_same(at_once, outcome)


def test_the_results_of_two_rounds_are_told_apart() -> None:
    """Also if the one that was started later is asked for first."""
    jobs: list[TrainingJob] = []

    def noting(job: Any) -> Any:
        jobs.append(job)
        return train_at_once(job)

    fly_lockstep(CONFIG, train=noting)
    with TrainingWorker() as worker:
        first, second = worker(jobs[0]), worker(jobs[1])
        results = second(), first()
    for job, result in zip((jobs[1], jobs[0]), results, strict=True):
        np.testing.assert_array_equal(result.epoch_losses, job.run().epoch_losses)


def test_a_fleets_job_is_run_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    job = FleetJob(Fleet(), None)  # type: ignore[arg-type]
    monkeypatch.setattr(FleetJob, "run", lambda self: os.getpid())
    with TrainingWorker() as worker:
        assert worker(job)() == os.getpid()


def test_a_flight_that_learns_nothing_starts_no_process() -> None:
    with training_for(resolve("hover", Choices("pid", seed=1, duration_s=5.0))) as train:
        assert train is train_at_once
    with training_for(None) as train:
        assert train is train_at_once


@pytest.mark.parametrize(("cores", "kind"), [(1, type(train_at_once)), (2, TrainingWorker)])
def test_a_worker_needs_a_second_core(cores: int, kind: type, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training_worker, "cores", lambda: cores)
    with training_for(CONFIG) as train:
        assert type(train) is kind


def test_without_logs_the_summary_is_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["fly", "hover", "--lockstep", "--controller", "pid", "--duration", "6", "--core", "c"]
    assert main([*words, "--out", str(tmp_path / "logged")]) == 0
    assert main([*words, "--out", str(tmp_path / "plain"), "--no-log"]) == 0
    assert sorted(file.name for file in (tmp_path / "plain").iterdir()) == ["config.yaml", "summary.json"]
    logged, plain = ((tmp_path / name / "summary.json").read_text("utf-8") for name in ("logged", "plain"))
    assert "--no-log" in plain
    assert plain.replace(" --no-log", "") == logged
    capsys.readouterr()
    assert main(["fly", "hover", "--no-log"]) == 2
    assert "--no-log: only with --lockstep" in capsys.readouterr().err
    assert main([*words, "--no-log", "--remember", "--memory", str(tmp_path / "memory")]) == 2
    assert "--no-log: not with --remember" in capsys.readouterr().err


def test_the_program_of_a_user_runs_once(tmp_path: Path) -> None:
    program = """
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from experiments.flights.training_worker import TrainingWorker

print("running", __name__)
choices = Choices("dmrac", seed=4, duration_s=11.0, assignments=("offboard.trainer.minimum_samples=60",))
with TrainingWorker() as worker:
    fly_lockstep(resolve("figure8_wind", choices), train=worker)
print("trained in", worker.process.name, worker.process.exitcode)
"""
    (tmp_path / "program.py").write_text(program, encoding="utf-8")
    done = subprocess.run([sys.executable, tmp_path / "program.py"], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == ["running __main__", "trained in SpawnProcess-1 0"]
    assert done.stderr == ""
