"""The inner layers learnt from conditions describe conditions that were not among them."""

from dataclasses import replace

import numpy as np
import pytest

from offboard.data.buffer import SampleTable
from offboard.memory.config import MemoryConfig
from offboard.memory.memory import Condition, Memory, Prior, UnusableMemoryError, last_layers
from offboard.memory.meta_learning import learn
from offboard.training.network import InputPlan, feature_set, initial_state, phi
from tests.offboard.memory.conditions import FEATURES, condition

JETS = [condition(f"jet {seed}", jet=2.0 * (-1.0) ** seed, seed=seed) for seed in range(8)]
SPREADS = 0.6, 3.0
UNSEEN = condition("unseen", jet=-1.5, seed=50)


def left(memory: Memory, one: Condition) -> float:
    """Share of the labels of a condition's second half that the last layer of its first half leaves."""
    half = one.samples.rows // 2
    first = replace(one, samples=one.samples.take(slice(0, half)))
    W = last_layers(memory.prior, memory.features, [first])[0, 0]
    channel = feature_set(memory.prior.network, InputPlan.of(memory.features), 1, 0, 0).channels[0]
    rest = one.samples.take(slice(half, one.samples.rows))
    return float(np.linalg.norm(rest.labels[:, 0] - phi(channel, rest.signals) @ W) / np.linalg.norm(rest.labels[:, 0]))


def test_learnt_inner_layers_need_fewer_samples_than_random_ones() -> None:
    learnt = learn(FEATURES, JETS, SPREADS, MemoryConfig(steps=300))
    random = learn(FEATURES, JETS, SPREADS, MemoryConfig(steps=0))
    assert left(learnt, UNSEEN) < 0.75 * left(random, UNSEEN)
    assert learnt.learnt == len(JETS)


def test_learning_repeats_to_the_bit_and_keeps_the_bound() -> None:
    config = MemoryConfig(steps=30)
    first, second = (learn(FEATURES, JETS[:3], SPREADS, config) for _ in range(2))
    for W, V in zip(first.prior.network.weights, second.prior.network.weights, strict=True):
        np.testing.assert_array_equal(W, V)
        assert np.linalg.norm(W, 2, axis=(1, 2)).max() <= FEATURES.spectral_norm_max
    assert (first.prior.noise > 0.0).all()


def test_no_steps_keep_the_inner_layers_of_the_start() -> None:
    start = learn(FEATURES, JETS[:2], SPREADS, MemoryConfig(steps=5))
    again = learn(FEATURES, JETS[:3], SPREADS, MemoryConfig(steps=0), start)
    for W, V in zip(start.prior.network.weights, again.prior.network.weights, strict=True):
        np.testing.assert_array_equal(W, V)
    assert again.learnt == 3


def test_without_samples_there_is_nothing_to_learn() -> None:
    empty = Condition("empty", 1, SampleTable.empty(0))
    with pytest.raises(UnusableMemoryError, match="no samples to learn from"):
        learn(FEATURES, [empty], SPREADS, MemoryConfig())


def test_the_loss_is_the_evidence_of_the_labels() -> None:
    """-2 log p of a Gaussian with covariance s Phi Phi' + r I, but for constants."""
    import torch

    from offboard.memory.meta_learning import _Learner

    config = MemoryConfig(conditions_per_step=1, samples_per_condition=8)
    learner = _Learner(FEATURES, initial_state(FEATURES, np.random.default_rng(0)), JETS[:1], SPREADS, config)
    z, y = learner._drawn(np.random.default_rng(1))
    with torch.no_grad():
        loss = float(learner._loss(z, y))
        Phi = learner._phi(z).double().numpy()[:, 0]
    total = 0.0
    for row in range(2):
        s, r = float(learner._relative[row]), float(learner._log_noise[row].detach().exp())
        C = s * Phi[row] @ Phi[row].T + r * np.eye(8)
        labels = y[row, 0].double().numpy()
        k = Phi.shape[2]
        quadratic = np.trace(labels.T @ np.linalg.solve(C, labels))
        total += quadratic + 3.0 * (np.linalg.slogdet(C)[1] - k * np.log(s))
    assert loss == pytest.approx(total / 8, rel=1e-3)


def test_the_prior_is_in_units_of_the_labels() -> None:
    prior: Prior = learn(FEATURES, JETS[:2], SPREADS, MemoryConfig(steps=0)).prior
    np.testing.assert_allclose(prior.variance, np.square(SPREADS))
