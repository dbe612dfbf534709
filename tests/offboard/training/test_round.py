"""A round of training: it is deterministic and bounded, learns, and can be continued."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from offboard.config import OffboardConfig
from offboard.data.buffer import TRAINING, VALIDATION, SampleTable
from offboard.training.evidence import squared_errors
from offboard.training.gate import Gate, Verdict
from offboard.training.gradient import Optimiser
from offboard.training.job import TrainingJob, TrainingResult
from offboard.training.vehicle_learner import VehicleLearner
from tests.offboard.flights import ROOT, figure8_through_jet, offboard_config

FLIGHT = figure8_through_jet(12.0, gust_m_s2=0.05)


def job_after(config: OffboardConfig, batches: int = 120) -> TrainingJob:
    learner = VehicleLearner(config)
    for batch in FLIGHT.batches()[:batches]:
        learner.receive(batch)
    job = learner.job(0)
    assert job is not None
    return job


def rounds(job: TrainingJob, count: int) -> TrainingResult:
    result = job.run()
    for _ in range(count - 1):
        result = replace(job, state=result.state).run()
    return result


def test_the_same_job_gives_the_same_result_bit_for_bit() -> None:
    job = job_after(offboard_config())
    first, second = job.run(), job.run()
    assert np.array_equal(first.epoch_losses, second.epoch_losses)
    for a, b in zip(first.state.network.weights, second.state.network.weights, strict=True):
        assert np.array_equal(a, b)
    other = replace(job, seed=job.seed + 1).run()
    assert not np.array_equal(first.epoch_losses, other.epoch_losses)


def test_a_job_does_not_change_its_inputs() -> None:
    job = job_after(offboard_config())
    before = [array.copy() for array in (*job.state.network.weights, job.newest.labels, job.buffer.signals)]
    job.run()
    after = (*job.state.network.weights, job.newest.labels, job.buffer.signals)
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize("optimiser", [{}, {"optimiser": "sgd", "learning_rate": 0.05}])
def test_ten_rounds_explain_most_of_the_uncertainty(optimiser: dict[str, object]) -> None:
    result = rounds(job_after(offboard_config(trainer=optimiser)), 10)
    signals = FLIGHT.signals.astype(np.float32)
    unexplained = squared_errors(result.candidate, signals, FLIGHT.delta).mean(axis=0)
    power = np.square(FLIGHT.delta).sum(axis=2).mean(axis=0)
    assert (unexplained / power < (0.1, 0.15)).all()
    assert result.epoch_losses.shape == (offboard_config().trainer.epochs, 3, 2)
    assert np.isfinite(result.epoch_losses[:, :2]).all()
    assert result.evidence.numpy_difference < 1e-5
    assert max(result.evidence.spectral_norms) <= offboard_config().features.trained.spectral_norm_max


def test_without_the_projection_the_spectral_bound_is_exceeded() -> None:
    """The safeguard is needed: without the projection, the same training exceeds the bound."""
    bound = offboard_config().features.trained.spectral_norm_max
    loose = job_after(offboard_config(features={"trained": {"spectral_norm_max": 1e3, "first_layer_gain": 4.0}}))
    assert max(rounds(loose, 2).evidence.spectral_norms) > bound


def test_a_diverged_round_is_undone() -> None:
    job = job_after(offboard_config(trainer={"optimiser": "sgd", "learning_rate": 1e6, "momentum": 0.99}))
    result = job.run()
    assert not np.isfinite(result.epoch_losses[-1, 0]).all()
    assert all(
        np.array_equal(a, b) for a, b in zip(result.state.network.weights, job.state.network.weights, strict=True)
    )
    assert result.state.rounds == job.state.rounds + 1
    config = offboard_config()
    gate = Gate(config.gate, config.features.trained)
    verdict = gate.judge(result.candidate, result.evidence, 10**10)
    assert verdict is Verdict.NOT_FINITE


def test_dropout_and_one_channel_and_mrgen_train_too() -> None:
    trained = {"dropout": 0.2, "channels": ["attitude"], "scaling": "data"}
    config = offboard_config(features={"trained": trained}, labels={"kind": "mrgen"})
    result = rounds(job_after(config), 3)
    assert result.candidate.position is None
    assert result.candidate.attitude is not None
    assert np.isnan(result.epoch_losses[:, :, 0]).all()
    assert result.evidence.candidate_errors[:, 1].mean() < 0.8 * result.evidence.flying_errors[:, 1].mean()


def test_validation_samples_are_not_trained_on() -> None:
    """With useless labels of the held-out samples the result is the same, apart from the choice of ridge."""
    job = job_after(offboard_config(trainer={"ridges": [0.03]}))
    corrupted = [corrupt(table) for table in (job.buffer, job.newest)]
    first, second = job.run(), replace(job, buffer=corrupted[0], newest=corrupted[1]).run()
    for a, b in zip(first.state.network.weights, second.state.network.weights, strict=True):
        assert np.array_equal(a, b)
    assert second.epoch_losses[-1, 1, 0] > 100.0 * first.epoch_losses[-1, 1, 0]


def corrupt(table: SampleTable) -> SampleTable:
    assert {TRAINING, VALIDATION} <= set(table.split.tolist())
    labels = np.where((table.split == TRAINING)[:, None, None], table.labels, 100.0).astype(np.float32)
    return replace(table, labels=labels)


def test_adam_takes_the_same_steps_as_torch() -> None:
    config = offboard_config(trainer={"weight_decay": 1e-3}).trainer
    rng = np.random.default_rng(0)
    mine = torch.from_numpy(rng.normal(size=50).astype(np.float32))
    theirs = mine.clone().requires_grad_(True)
    reference = torch.optim.Adam([theirs], lr=config.learning_rate, weight_decay=config.weight_decay)
    optimiser = Optimiser(config, 50, (), 0)
    for _ in range(30):
        gradient = torch.from_numpy(rng.normal(size=50).astype(np.float32))
        theirs.grad = gradient.clone()
        reference.step()  # type: ignore[no-untyped-call]
        optimiser.step(mine, gradient)
        optimiser = Optimiser(config, 50, optimiser.moments, optimiser.steps)  # as between rounds
    assert torch.allclose(mine, theirs.detach(), atol=1e-6)


def test_a_sample_without_a_label_of_a_channel_does_not_count_for_it_and_counts_for_the_other() -> None:
    """Half of the attitude labels are missing: the position channel is trained as if they were there."""
    job = job_after(offboard_config())
    partly = [without_attitude(table) for table in (job.buffer, job.newest)]
    full, part = job.run(), replace(job, buffer=partly[0], newest=partly[1]).run()
    # Apart from Adam's and the spectral bound's rounding, which act on all parameters at once, nothing is shared.
    assert part.epoch_losses[:, :, 0] == pytest.approx(full.epoch_losses[:, :, 0], rel=1e-2, nan_ok=True)
    assert not np.allclose(part.epoch_losses[:, :, 1], full.epoch_losses[:, :, 1], rtol=1e-2, equal_nan=True)
    assert np.isfinite(part.epoch_losses[:, :2]).all()
    assert np.isnan(part.evidence.candidate_errors[:, 1]).sum() == np.isnan(partly_labels(partly)).sum() > 0
    again = replace(job, state=part.state, buffer=partly[0], newest=partly[1])
    better = rounds(again, 6)
    errors = squared_errors(better.candidate, FLIGHT.signals.astype(np.float32), FLIGHT.delta).mean(axis=0)
    assert (errors < 0.25 * np.square(FLIGHT.delta).sum(axis=2).mean(axis=0)).all(), "and what is there is enough"


def without_attitude(table: SampleTable) -> SampleTable:
    labels = table.labels.copy()
    labels[(table.time_ns // 20_000_000) % 2 == 0, 1] = np.nan
    return replace(table, labels=labels)


def partly_labels(tables: list[SampleTable]) -> np.ndarray:
    """Attitude labels, first axis, of the held-out samples, each sample once."""
    both = tables[0].joined(tables[1])
    held_out = both.take(both.split == VALIDATION)
    _, first = np.unique(held_out.time_ns, return_index=True)
    return held_out.take(first).labels[:, 1, 0]


def test_a_channel_without_any_label_keeps_its_last_layer() -> None:
    job = rounds_state(job_after(offboard_config()), 2)
    labels = [table.labels.copy() for table in (job.buffer, job.newest)]
    for one in labels:
        one[:, 1] = np.nan
    silent = replace(
        job, buffer=replace(job.buffer, labels=labels[0]), newest=replace(job.newest, labels=labels[1])
    ).run()
    before, after = job.state.network.last_layer, silent.state.network.last_layer
    assert np.abs(before[1]).max() > 0.1
    assert np.abs(after[1]).sum() == pytest.approx(np.abs(before[1]).sum(), rel=0.2)
    assert np.isnan(silent.evidence.label_power[1])
    gate = Gate(offboard_config().gate, offboard_config().features.trained)
    assert gate.judge(silent.candidate, silent.evidence, 10**10) is Verdict.TOO_FEW_SAMPLES


def rounds_state(job: TrainingJob, count: int) -> TrainingJob:
    return replace(job, state=rounds(job, count).state)


@pytest.mark.parametrize("dropout", [0.0, 0.2])
def test_torchs_default_dtype_does_not_matter(dropout: float) -> None:
    job = job_after(offboard_config(features={"trained": {"dropout": dropout}}))
    expected = job.run()
    torch.set_default_dtype(torch.float64)
    try:
        found = job.run()
    finally:
        torch.set_default_dtype(torch.float32)
    assert np.array_equal(found.epoch_losses, expected.epoch_losses)
    for a, b in zip(found.state.network.weights, expected.state.network.weights, strict=True):
        assert a.dtype == np.float32
        assert np.array_equal(a, b)


def test_a_library_user_keeps_torchs_threads_and_the_process_takes_one() -> None:
    lines = (
        "import torch; torch.set_num_threads(3)",
        "import offboard.training.round; assert torch.get_num_threads() == 3, 'changed by an import'",
        "from types import SimpleNamespace as N; from offboard.command import _load_torch",
        "_load_torch([N(config=N(experience=N(mode='learn')))]); assert torch.get_num_threads() == 1",
    )
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True, cwd=ROOT, timeout=120)
