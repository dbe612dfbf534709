"""The learner of the flight on any data: `fit` trains features off line, `update` adapts the last layer on line.

    y = W' Phi(x) + b          x: m named inputs, Phi: k features of a deep network, y: q named outputs

It is the trainer, the laws and the swap that fly (offboard.training, onboard.control.laws), without a vehicle: any
signals by name, any rate, any number of outputs. docs/python.md has a tutorial.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp
from typing import Any, Final

import numpy as np

from async_dmrac.learning.laws import KalmanLaw, Law, swap
from async_dmrac.learning.signals import matrix, vector
from async_dmrac.learning.training import OwnJob, OwnNetworks, sample_table, training_rows, usual_size
from offboard.config import TrainerConfig
from offboard.data.buffer import VALIDATION
from offboard.training.job import TrainerState
from offboard.training.network import channel_features, phi
from onboard.control.feature_swap import RecentStates, SwapConfig, SwapPlan
from onboard.control.features import NetworkFeatures
from onboard.control.laws.last_layer import lyapunov_p, tracking_weights
from protocol.conventions import Array
from protocol.feature_set import ChannelFeatures

__all__ = ["Fit", "Learner", "Tracking"]

RECENT_STATES: Final = 40
"""States that a swap is planned with, at most."""
RECENT_S: Final = 1.0
"""s that they cover."""
COLLECTED_MAX: Final = 20_000
"""Newest samples of `update` that `fit` trains on."""
SAMPLES_MIN: Final = 60
"""Fewest labelled samples to train on. A flight waits for more, because it soon is where it has not been."""


@dataclass(frozen=True)
class Tracking:
    """Reference model of the loop that the learner is in, per output: for laws with a tracking term.

    Raises ValueError on construction if a pole is not stable or the lengths differ.
    """

    natural_frequency_rad_s: tuple[float, ...]
    damping: tuple[float, ...]
    """Of each output."""
    error_weight: tuple[float, float] = (1.0, 0.1)
    """Diagonal of Q: for the first and the second half of e."""

    def __post_init__(self) -> None:
        if len(self.damping) != len(self.natural_frequency_rad_s):
            raise ValueError(f"damping: {len(self.damping)} values, expected {len(self.natural_frequency_rad_s)}")
        if min((*self.damping, *self.natural_frequency_rad_s, *self.error_weight), default=0.0) <= 0.0:
            raise ValueError("natural_frequency_rad_s, damping and error_weight: expected values above 0")

    def weights(self) -> Array:
        """PB, [2 q, q], of the Lyapunov equation A_rm' P + P A_rm + Q = 0."""
        omega, zeta = np.array(self.natural_frequency_rad_s), np.array(self.damping)
        q = omega.size
        A_rm = np.block([[np.zeros((q, q)), np.eye(q)], [-np.diag(omega**2), -np.diag(2.0 * zeta * omega)]])
        P = lyapunov_p(A_rm, np.diag(np.repeat(self.error_weight, q)))
        return tracking_weights(P, self.natural_frequency_rad_s)


@dataclass(frozen=True, eq=False)
class Fit:
    """The result of `Learner.fit`."""

    version: int
    """From 1."""
    features: ChannelFeatures
    """The trained networks with their last layer; `Learner.swap` takes them into use."""
    losses: Array
    """[epochs, 3]: mean squared error on training, validation and test samples, summed over the outputs."""
    rmse: dict[str, float]
    """Of each output, on the held-out (validation) samples, in its units; NaN without any."""
    samples: int
    """Labelled samples that it was trained on."""
    swap: SwapPlan | None = None
    """The swap, if `fit` has carried it out or was refused."""


class Learner:
    """Features, last layer, trainer and swap for m inputs and q outputs."""

    def __init__(
        self,
        inputs: Sequence[str],
        outputs: Sequence[str],
        *,
        rate_hz: float,
        law: Law | None = None,
        hidden: Sequence[int] = (32, 32),
        features: int = 20,
        residual_filter_s: float = 0.0,
        tracking: Tracking | None = None,
        trainer: TrainerConfig | None = None,
        jump_max: float = 3.0,
        block_s: float = 0.3,
        input_scales: Mapping[str, tuple[float, float]] | None = None,
        output_scales: Mapping[str, float] | None = None,
        seed: int = 1,
    ) -> None:
        """Nothing is learnt yet; torch is imported by the first `fit`, its settings are left alone.

        Parameters
        ----------
        inputs, outputs: names of the signals, in the order of arrays.
        rate_hz: of the samples and updates.
        law: of the last layer, `KalmanLaw`, `GradientLaw` or one of your own; None: `KalmanLaw()`.
        hidden: widths of the inner layers. features: k, the constant included.
        residual_filter_s: time constant of a low-pass on the residuals of `update`; 0: none.
        tracking: reference model, for laws that use the tracking error; None: no tracking error.
        jump_max: largest jump of the output at a swap, in units of the outputs' usual size; larger ones are refused.
        block_s: samples within so many s are trained on, or held out, together.
        input_scales, output_scales: (offset, scale) of each input and usual size of each output. None: from the first
            `fit`; with both, `update` works before it.

        Raises ValueError that names the argument, its value and what is allowed.
        """
        self.inputs, self.outputs = _names(inputs, "inputs"), _names(outputs, "outputs")
        _check_sizes(rate_hz, residual_filter_s, features, hidden)
        if tracking is not None and len(tracking.damping) != len(self.outputs):
            raise ValueError(f"tracking: for {len(tracking.damping)} outputs, expected {len(self.outputs)}")
        self.rate_hz, self._dt, self._seed = float(rate_hz), 1.0 / rate_hz, seed
        self.law: Law = law or KalmanLaw()
        self._shape = tuple(hidden), features
        self._trainer = trainer or TrainerConfig(minimum_samples=SAMPLES_MIN)
        self._PB = np.zeros((2 * len(outputs), len(outputs))) if tracking is None else tracking.weights()
        self._share = 1.0 - exp(-self._dt / residual_filter_s) if residual_filter_s > 0.0 else 1.0
        self._block_s = block_s
        period = min(max(round(RECENT_S * rate_hz / RECENT_STATES), 1), 100)
        self._swap_config = SwapConfig(jump_max=jump_max, ring_period_ticks=period, ring_size=RECENT_STATES)
        self._collected: deque[tuple[Array, Array]] = deque(maxlen=COLLECTED_MAX)
        self.version = 0
        self._now: Array
        self._residual: Array
        self._ticks: int
        self._forget()
        self._networks: OwnNetworks | None = None
        self._state: TrainerState | None = None
        self._features: NetworkFeatures | None = None
        self.output_scales: Array | None = None
        """[q], usual size of each output; the law works in these units."""
        if input_scales is not None and output_scales is not None:
            scales = np.array([_of(input_scales, name, "input_scales") for name in self.inputs])
            sizes = np.array([_of(output_scales, name, "output_scales") for name in self.outputs])
            self._begin(scales[:, 0], scales[:, 1], sizes)

    # --- off line -------------------------------------------------------------------------------------------------

    def fit(self, signals: Any = None, labels: Any = None, *, rounds: int = 30, use: bool = True) -> Fit:
        """Train the features and their last layer, from those of the `fit` before.

        Parameters
        ----------
        signals: name -> [n] (a mapping, a DataFrame, a Table) or an array [n, m], in the order of time at `rate_hz`.
        labels: the same for the outputs, [n, q]; a row with NaN has no label. Without both: the samples of `update`.
        rounds: of training; each is `trainer.batches` mini-batches.
        use: swap to them at once; False: `swap` does it later.

        Raises
        ------
        ValueError
            If columns, lengths or values do not fit, or there are too few samples.
        """
        from offboard.training.round import train_networks

        x, y = self._samples(signals, labels)
        if self._networks is None:
            spread = x.std(axis=0)
            self._begin(x.mean(axis=0), np.where(spread > 0.0, spread, 1.0), usual_size(y))
        assert self._networks is not None
        assert self._state is not None
        assert self.output_scales is not None
        table = sample_table(x, y, self._dt, self._block_s, self._seed)
        enough, given = self._trainer.minimum_samples, training_rows(table)
        if given < enough:
            raise ValueError(f"labels: {given} labelled samples to train on, expected at least {enough}")
        state, losses, floor = self._state, [], float(1e-6 * self.output_scales.max())
        for _ in range(rounds):
            job = OwnJob(self._networks, self._trainer, self._seed, state, table, (floor,))
            state, of_round = train_networks(job)
            losses.append(of_round[:, :, 0])
        self._state = state
        self.version += 1
        trained = channel_features(state.network, self._networks.plan, 0)
        held_out = table.split == VALIDATION
        errors = phi(trained, table.signals[held_out]) @ trained.last_layer - y[held_out]
        errors = errors[~np.isnan(errors).any(axis=1)]
        size = np.sqrt(np.square(errors).mean(axis=0)) if errors.size else np.full(len(self.outputs), np.nan)
        rmse = dict(zip(self.outputs, size.tolist(), strict=True))
        fit = Fit(self.version, trained, np.concatenate(losses or [np.zeros((0, 3))]), rmse, given)
        return replace(fit, swap=self.swap(fit)) if use else fit

    def swap(self, fit: Fit) -> SwapPlan:
        """Use the features of a fit from now on: bumpless, with the estimate at the recent states kept.

        Returns
        -------
        The plan: `refusal` is "" if it was carried out, `jump` the largest change of the output over the recent
        states, in units of the outputs' usual size.
        """
        scale = self.output_scales
        if scale is None or self._features is None:
            raise ValueError("swap: nothing was fitted yet")
        channel = replace(fit.features, last_layer=fit.features.last_layer / scale)
        new = NetworkFeatures(channel)
        if self._ticks == 0:  # no estimate to continue
            self.law.start(channel.last_layer, self._dt, self._PB)
            self._features = new
            return SwapPlan(channel.last_layer, 0.0, "", channel.last_layer)
        plan = swap(self.law, self._swap_config, self._features, new, self._recent, self._now, self._dt, self._PB)
        if not plan.refusal:
            self._features = new
        return plan

    # --- on line --------------------------------------------------------------------------------------------------

    def update(self, signals: Any, residual: Any, error: Any = None) -> Array:
        """One tick of the law: the residual that was measured at these signals; returns the new estimate there, [q].

        Parameters
        ----------
        signals: name -> number, or [m]. residual: the same for the outputs, [q].
        error: tracking error e = x_rm - x [2 q], with `tracking`; the second half is the rate of the first.

        Raises
        ------
        ValueError
            If a name is missing, a shape does not fit, a value is not finite, or nothing was fitted yet.
        """
        features, scale = self._ready()
        x, measured = vector(signals, self.inputs, "signals"), vector(residual, self.outputs, "residual")
        e = np.zeros(2 * len(self.outputs)) if error is None else np.asarray(error, dtype=np.float64)
        if e.shape != (2 * len(self.outputs),):
            raise ValueError(f"error: shape {e.shape}, expected ({2 * len(self.outputs)},)")
        if error is not None and not self._PB.any():
            raise ValueError("error: only with `tracking`, the reference model that it is measured against")
        self._residual += self._share * (measured / scale - self._residual)
        Phi = features.evaluate(features.select(x[:, None]))
        self.law.update(Phi[:, 0], self._residual, e / np.tile(scale, 2))
        if self._ticks % self._swap_config.ring_period_ticks == 0:
            self._recent.push(x, self._residual.tolist())
        self._collected.append((x, measured))
        self._now, self._ticks = x, self._ticks + 1
        estimate: Array = self.law.estimate(Phi)[:, 0] * scale
        return estimate

    def restart(self) -> None:
        """Start a new series of samples: the last layer is again the one that came with the features in use.

        What `update` has collected for `fit` stays. Raises ValueError if nothing was fitted yet.
        """
        features, _ = self._ready()
        self._forget()
        self.law.start(features.channel.last_layer, self._dt, self._PB)

    def predict(self, signals: Any) -> Array:
        """The present estimate W'Phi + b at these signals: [n, q], or [q] for one row that is no array of rows.

        Raises ValueError as `update` does.
        """
        _, scale = self._ready()
        one = np.ndim(signals) == 1 or (isinstance(signals, Mapping) and np.ndim(signals[self.inputs[0]]) == 0)
        estimate: Array = (self.law.estimate(self.features(signals).T) * scale[:, None]).T
        return estimate[0] if one else estimate

    def features(self, signals: Any) -> Array:
        """Phi [n, k] at these signals; the last one is the constant 1."""
        features, _ = self._ready()
        x = matrix(signals, self.inputs, "signals")
        Phi: Array = features.evaluate(features.select(np.ascontiguousarray(x.T))).T
        return Phi

    # --- inside ---------------------------------------------------------------------------------------------------

    def _begin(self, offset: Array, scale: Array, sizes: Array) -> None:
        """Random features with these scales, and the law with W = 0."""
        self.output_scales = sizes
        hidden, count = self._shape
        self._networks = OwnNetworks(self.inputs, len(self.outputs), hidden, count, offset, scale)
        self._state = self._networks.start(self._seed)
        self._features = NetworkFeatures(channel_features(self._state.network, self._networks.plan, 0))
        self.law.start(np.zeros((count, len(self.outputs))), self._dt, self._PB)

    def _forget(self) -> None:
        """No samples yet in this series."""
        self._recent = RecentStates(RECENT_STATES, len(self.inputs), len(self.outputs))
        self._now, self._residual, self._ticks = np.zeros(len(self.inputs)), np.zeros(len(self.outputs)), 0

    def _ready(self) -> tuple[NetworkFeatures, Array]:
        if self._features is None or self.output_scales is None:
            raise ValueError("nothing was fitted yet: call fit, or give input_scales and output_scales")
        return self._features, self.output_scales

    def _samples(self, signals: Any, labels: Any) -> tuple[Array, Array]:
        if (signals is None) is not (labels is None):
            raise ValueError("fit: expected signals and labels, or neither for the samples of update")
        if signals is None:
            if not self._collected:
                raise ValueError("fit: update has collected no samples yet; expected signals and labels")
            return (
                np.array([seen for seen, _ in self._collected]),
                np.array([measured for _, measured in self._collected]),
            )
        x, y = matrix(signals, self.inputs, "signals"), matrix(labels, self.outputs, "labels")
        if x.shape[0] != y.shape[0]:
            raise ValueError(f"labels: {y.shape[0]} rows, but signals have {x.shape[0]}")
        if not np.isfinite(x).all() or np.isinf(y).any():
            raise ValueError("signals, labels: a value is not finite; only labels may be NaN, where there is none")
        return x, y


def _check_sizes(rate_hz: float, residual_filter_s: float, features: int, hidden: Sequence[int]) -> None:
    if not rate_hz > 0.0 or residual_filter_s < 0.0:
        raise ValueError(f"rate_hz {rate_hz}, residual_filter_s {residual_filter_s}: expected > 0 and >= 0")
    if features < 2 or not hidden or min(hidden) < 1:
        raise ValueError(f"features {features}, hidden {tuple(hidden)}: expected at least 2, and widths above 0")


def _names(names: Sequence[str], what: str) -> tuple[str, ...]:
    if isinstance(names, str) or not names or len(set(names)) != len(names):
        raise ValueError(f"{what}: {names!r}: expected a list of different names")
    return tuple(names)


def _of(given: Mapping[str, Any], name: str, what: str) -> Any:
    if name not in given:
        raise ValueError(f"{what}: no entry for {name!r}; given are {', '.join(given)}")
    return given[name]
