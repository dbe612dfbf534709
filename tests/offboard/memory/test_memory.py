"""Conditions, last layers, and what of their mean a new flight starts from."""

from dataclasses import replace

import numpy as np
import pytest

from offboard.memory import memory as module
from offboard.memory.memory import (
    CONDITIONS_MAX,
    SAMPLES_PER_CONDITION,
    Memory,
    UnusableMemoryError,
    joined_conditions,
    last_layers,
    posterior_mean,
    thinned,
    unlearnt,
    with_theta,
)
from offboard.training.network import InputPlan, feature_set, phi
from protocol.conventions import Array
from tests.offboard.memory.conditions import FEATURES, condition, random_prior


def theta_of(conditions: list[module.Condition]) -> Array:
    network = with_theta(random_prior(), FEATURES, conditions).network
    return np.concatenate([network.last_layer, network.last_bias], axis=1).astype(np.float64)


def left(theta: Array, one: module.Condition) -> float:
    """Share of the labels that theta leaves, position channel."""
    channel = feature_set(random_prior().network, InputPlan.of(FEATURES), 1, 0, 0).channels[0]
    Delta = one.samples.labels[:, 0]
    return float(np.linalg.norm(Delta - phi(channel, one.samples.signals) @ theta[0]) / np.linalg.norm(Delta))


def test_the_posterior_mean_is_the_minimum_of_misfit_and_prior() -> None:
    rng = np.random.default_rng(0)
    Phi, Delta, theta, share = rng.normal(size=(30, 5)), rng.normal(size=(30, 3)), rng.normal(size=(5, 3)), 0.7

    def cost(W: Array) -> float:
        return float(share * np.square(Delta - Phi @ W).sum() + np.square(W - theta).sum())

    W = posterior_mean(Phi, Delta, theta, share)
    assert all(cost(W) < cost(W + 1e-3 * rng.normal(size=W.shape)) for _ in range(20))
    np.testing.assert_allclose(posterior_mean(Phi[:0], Delta[:0], theta, share), theta)


def test_a_single_condition_teaches_no_theta() -> None:
    """Nothing says which part of it another flight will meet."""
    assert not theta_of([condition("jet", jet=2.0)]).any()


def test_theta_keeps_what_all_conditions_share() -> None:
    same = [condition(f"wind {seed}", constant=1.0, seed=seed) for seed in range(6)]
    assert left(theta_of(same), condition("another", constant=1.0, seed=9)) < 0.2


def test_theta_drops_what_they_do_not_share() -> None:
    """A jet that blows west in half of the conditions: theta must not help the one and harm the other."""
    mixed = [condition(f"jet {seed}", jet=2.0 * (-1.0) ** seed, seed=seed) for seed in range(6)]
    assert left(theta_of(mixed), condition("east", jet=2.0, seed=9)) < 1.02
    assert left(theta_of(mixed), condition("west", jet=-2.0, seed=9)) < 1.02


def test_without_the_agreement_the_mean_of_two_conditions_would_do_harm(monkeypatch: pytest.MonkeyPatch) -> None:
    """The safeguard is needed: the plain mean of a jet and of still air is a phantom jet in still air."""
    pair = [condition("jet", jet=2.0, seed=1), condition("calm", constant=0.1, seed=2)]
    calm = condition("calm again", constant=0.1, seed=3)
    assert left(theta_of(pair), calm) < 1.02
    monkeypatch.setattr(module, "agreement", lambda fits: np.ones(3))
    assert left(theta_of(pair), calm) > 2.0


def test_a_last_layer_explains_its_own_condition_alone() -> None:
    east, west = condition("east", jet=2.0, seed=1), condition("west", jet=-2.0, seed=2)
    layers = last_layers(random_prior(), FEATURES, [east, west])
    assert left(layers[0], east) < 0.5
    assert left(layers[1], east) > 1.2


def test_a_condition_counts_once() -> None:
    one, again = condition("jet", jet=1.0, seed=1), replace(condition("jet", jet=1.0, seed=1), name="copy")
    other = condition("calm", seed=2)
    assert len(joined_conditions([[one, other], [again]])) == 2
    memory = Memory(FEATURES, random_prior(), (one, other), 2)
    assert memory.with_condition(again) is memory
    more = memory.with_condition(condition("wind", constant=1.0, seed=3))
    assert [item.name for item in more.conditions] == ["jet", "calm", "wind"]
    assert more.learnt == 2


def test_too_many_conditions_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CONDITIONS_MAX", 2)
    with pytest.raises(UnusableMemoryError, match="3 conditions; allowed are at most 2"):
        joined_conditions([[condition("c", seed=seed, rows=10) for seed in range(3)]])
    assert CONDITIONS_MAX > 2


def test_a_long_flight_is_thinned_evenly_and_keeps_its_duration() -> None:
    long = condition("long", rows=4 * SAMPLES_PER_CONDITION)
    short = replace(long, samples=thinned(long.samples))
    assert short.samples.rows == SAMPLES_PER_CONDITION
    assert short.duration_s == pytest.approx(long.duration_s, rel=0.02)
    assert short.independent_samples == pytest.approx(long.independent_samples, rel=0.02)


def test_a_pause_adds_no_time() -> None:
    one = condition("pause", rows=200)
    one.samples.time_ns[100:] += 10**12
    assert one.duration_s == pytest.approx(200 * 0.02, rel=0.05)


def test_a_memory_without_conditions_has_a_version_that_predicts_nothing() -> None:
    version = unlearnt(FEATURES).version()
    assert all(not channel.last_layer.any() for channel in version.channels)
