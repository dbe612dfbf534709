"""A memory: inner layers shared by all flights and vehicles, and a last layer for each condition.

A condition is one flight of one vehicle: its own wind, faults and mass. The disturbance there is modelled as

    Delta(x) = W_c' Phi(x),   W_c ~ N(theta, S0)   in each axis,

with inner layers Phi shared by all conditions. A new flight starts from theta and learns its own W_c. theta is the mean
of the W_c, times the share f of it that holds for conditions that it was not made from (`agreement`): what is common to
all flights is kept, and the jet of one place, which the next flight may not meet, is not.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import Final

import numpy as np

from offboard.data.buffer import SampleTable
from offboard.training.network import InputPlan, NetworkState, feature_set, initial_state, phi
from protocol.conventions import Array
from protocol.feature_config import TrainedFeatures
from protocol.feature_set import FeatureSet
from protocol.signals import CHANNELS

CONDITIONS_MAX: Final = 512
SAMPLES_PER_CONDITION: Final = 600
"""A longer flight is thinned evenly to so many."""
CONDITION_COLUMNS: Final = ("time_ns", "signals", "labels")
"""What a memory stores of a sample."""
INDEPENDENT_S: Final = 0.12
"""s; labels closer together in time share their smoothing window (offboard.config.LabelConfig)."""


class UnusableMemoryError(Exception):
    """A memory that cannot be used. The message states the reason."""


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """What was measured on one flight of one vehicle."""

    name: str
    """For people: the flight's folder, or its scenario and seed."""
    vehicle: int
    """offboard.vehicle_id."""
    samples: SampleTable
    """In order of time, each with the labels of both channels: their CONDITION_COLUMNS are what counts."""

    @property
    def duration_s(self) -> float:
        """Time with samples: pauses do not count."""
        if self.samples.rows < 2:
            return 0.0
        steps = np.diff(self.samples.time_ns) * 1e-9
        return float(np.minimum(steps, 3.0 * np.median(steps)).sum())

    @property
    def independent_samples(self) -> float:
        """Labels that do not share a smoothing window."""
        return min(float(self.samples.rows), self.duration_s / INDEPENDENT_S)

    @property
    def digest(self) -> str:
        """The same for the same samples: a condition is in a memory once, whatever its name."""
        state = blake2b(digest_size=8)
        for column in CONDITION_COLUMNS:
            state.update(np.ascontiguousarray(getattr(self.samples, column)).tobytes())
        return state.hexdigest()


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What a new flight starts from."""

    network: NetworkState
    """Shared inner layers; its last layer is theta."""
    variance: Array
    """[C]: S0 = variance I of each channel, (m/s^2)^2 and (rad/s^2)^2."""
    noise: Array
    """[C]: variance of a label about W_c'Phi, the same units."""


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """A prior and the conditions it was learnt from."""

    features: TrainedFeatures
    """Inputs, scales and widths of the networks."""
    prior: Prior
    conditions: tuple[Condition, ...]
    learnt: int
    """Conditions that the inner layers were learnt from; later ones have changed theta only."""

    def version(self) -> FeatureSet:
        """Inner layers and theta as a feature version, number 1."""
        return feature_set(self.prior.network, InputPlan.of(self.features), 1, 0, self.samples)

    @property
    def samples(self) -> int:
        """Samples of all conditions."""
        return sum(condition.samples.rows for condition in self.conditions)

    def with_condition(self, condition: Condition) -> "Memory":
        """The memory with one more condition: theta is computed anew, the inner layers stay."""
        if condition.samples.rows == 0 or condition.digest in {one.digest for one in self.conditions}:
            return self
        conditions = joined_conditions([(*self.conditions, condition)])
        return replace(self, prior=with_theta(self.prior, self.features, conditions), conditions=conditions)


def unlearnt(features: TrainedFeatures) -> Memory:
    """A memory without conditions; its inner layers are random, and no flight starts from them."""
    network = initial_state(features, np.random.default_rng(0))
    ones = np.ones(network.offset.shape[0])
    return Memory(features, Prior(network, ones, ones), (), 0)


def thinned(samples: SampleTable) -> SampleTable:
    """At most SAMPLES_PER_CONDITION of the samples that have all labels, evenly spread."""
    samples = samples.take(np.flatnonzero(np.isfinite(samples.labels).all(axis=(1, 2))))
    if samples.rows <= SAMPLES_PER_CONDITION:
        return samples
    return samples.take(np.linspace(0, samples.rows - 1, SAMPLES_PER_CONDITION).round().astype(np.intp))


def joined_conditions(memories: Iterable[Iterable[Condition]]) -> tuple[Condition, ...]:
    """The conditions of all memories in order, each once.

    Raises
    ------
    UnusableMemoryError
        If there are more than CONDITIONS_MAX.
    """
    found = {condition.digest: condition for conditions in memories for condition in conditions}
    if len(found) > CONDITIONS_MAX:
        raise UnusableMemoryError(f"{len(found)} conditions; allowed are at most {CONDITIONS_MAX}")
    return tuple(found.values())


def last_layers(prior: Prior, features: TrainedFeatures, conditions: Iterable[Condition]) -> Array:
    """W_c of each condition, [conditions, C, k, 3]: the posterior mean from its samples alone, for a prior mean of 0.

    In directions that a condition did not excite, its W_c is 0.
    """
    found = [[fit.last_layer for fit in _fits(prior, features, one)] for one in conditions]
    return np.array(found)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """One condition and channel."""

    Phi: Array
    """[n, k]"""
    Delta: Array
    """[n, 3]"""
    last_layer: Array
    """W_c, [k, 3]."""


def _fits(prior: Prior, features: TrainedFeatures, condition: Condition) -> list[Fit]:
    plan, samples = InputPlan.of(features), condition.samples
    channels = feature_set(prior.network, plan, 1, 0, 0).channels
    weight = condition.independent_samples / max(samples.rows, 1)
    fits = []
    for row, (at, channel) in enumerate(zip(plan.channels, channels, strict=True)):
        Phi, Delta = phi(channel, samples.signals), samples.labels[:, at].astype(np.float64)
        share = weight * prior.variance[row] / prior.noise[row]
        fits.append(Fit(Phi, Delta, posterior_mean(Phi, Delta, np.zeros((Phi.shape[1], 3)), share)))
    return fits


def posterior_mean(Phi: Array, Delta: Array, theta: Array, share: float) -> Array:
    """E[W | samples] for W ~ N(theta, S0 I) in each axis and Delta = W'Phi + N(0, R / w), [k, 3].

    W = theta + (Phi'Phi share + I)^-1 Phi' (Delta - Phi theta) share,  share = w S0 / R

    Parameters
    ----------
    Phi: [n, k]. Delta: [n, 3]. theta: [k, 3].
    share: with the weight w of a sample below 1 where neighbours in time are not independent.
    """
    gram = share * (Phi.T @ Phi) + np.eye(Phi.shape[1])
    W: Array = theta + np.linalg.solve(gram, share * (Phi.T @ (Delta - Phi @ theta)))
    return W


def with_theta(prior: Prior, features: TrainedFeatures, conditions: Sequence[Condition]) -> Prior:
    """The prior with theta = f mean(W_c), f per channel and axis (`agreement`)."""
    fits = [_fits(prior, features, one) for one in conditions]
    channels = range(len(InputPlan.of(features).channels))
    theta = np.array([_theta([one[row] for one in fits]) for row in channels]).astype(np.float32)
    network = replace(prior.network, last_layer=theta[:, :-1].copy(), last_bias=theta[:, -1:].copy())
    return replace(prior, network=network)


def _theta(fits: Sequence[Fit]) -> Array:
    """theta of one channel, [k, 3]."""
    mean: Array = np.mean([fit.last_layer for fit in fits], axis=0)
    return mean * agreement(fits)


def agreement(fits: Sequence[Fit]) -> Array:
    """f [3]: the share of the mean of the other conditions that is right in a condition that it was not made from.

    With p_c = W_-c'Phi, W_-c the mean over the conditions but c, f minimises the sum over all conditions of
    |Delta - f p_c|^2: f = sum(Delta p_c) / sum(p_c^2), in [0, 1], each condition weighing the same. Its standard error
    over the conditions is subtracted. 0 for a single condition: nothing says what of it another flight will meet.
    """
    n = len(fits)
    if n < 2:
        return np.zeros(3)
    total = np.sum([fit.last_layer for fit in fits], axis=0)
    match, power = np.zeros((n, 3)), np.zeros((n, 3))
    for row, fit in enumerate(fits):
        others = fit.Phi @ ((total - fit.last_layer) / (n - 1))
        match[row], power[row] = (fit.Delta * others).mean(axis=0), np.square(others).mean(axis=0)
    whole = np.maximum(power.sum(axis=0), 1e-12)
    f = match.sum(axis=0) / whole
    error = np.sqrt(np.square(match - f * power).sum(axis=0) * n / (n - 1)) / whole
    share: Array = np.clip(f - error, 0.0, 1.0)
    return share


def channel_names(features: TrainedFeatures) -> tuple[str, ...]:
    """The learnt channels in the order of every array with an axis C."""
    return tuple(CHANNELS[at] for at in InputPlan.of(features).channels)
