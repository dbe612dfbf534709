"""The learner alone on a task that is no quadrotor: 7 signals, 2 outputs, 50 Hz."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from async_dmrac.learner import Learner, Tracking
from async_dmrac.learning.laws import GradientLaw, KalmanLaw
from onboard.control.laws.kalman_last_layer import KalmanConfig
from protocol.conventions import Array

INPUTS = ("speed", "angle", "flow", "load", "height", "tilt", "voltage")
OUTPUTS = ("lift", "moment")
RATE_HZ = 50.0
ROOT = Path(__file__).resolve().parents[2]
SIZES = np.array([12.0, 0.03])
"""Of the outputs: very different ones."""


def truth(x: Array) -> Array:
    """[n, 2]: a smooth map of 7 signals with very different ranges."""
    speed, angle, flow, load, *_ = x.T
    lift = np.sin(0.4 * speed) * angle + 0.3 * flow**2
    moment = np.tanh(speed - 4.0) + 0.5 * angle * load
    return np.column_stack([lift, moment]) * SIZES


def samples(seconds: float, seed: int) -> tuple[Array, Array]:
    """Signals [n, 7] and outputs [n, 2] along a random smooth path."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    waves = [np.sin(t[:, None] * rng.uniform(0.5, 3.0, 4) + rng.uniform(0.0, 6.0, 4)).sum(axis=1) / 2.0 for _ in INPUTS]
    x = np.column_stack(waves) * [3.0, 1.0, 1.0, 2.0, 100.0, 0.01, 0.5] + [4.0, 0.0, 0.0, 0.0, 1000.0, 0.0, 11.0]
    return x, truth(x)


@pytest.fixture(scope="module")
def fitted() -> tuple[Learner, Any]:
    learner = Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ)
    x, y = samples(60.0, 1)
    return learner, learner.fit(dict(zip(INPUTS, x.T, strict=True)), y + 0.05 * SIZES * noise(y.shape))


def noise(shape: tuple[int, ...]) -> Array:
    return np.random.default_rng(5).standard_normal(shape)


def error(found: Array, y: Array) -> Array:
    """[2], RMSE of each output, as a share of the output's RMS."""
    share: Array = np.sqrt(np.square(found - y).mean(axis=0) / np.square(y).mean(axis=0))
    return share


def test_a_map_of_seven_signals_to_two_outputs_is_learnt(fitted: tuple[Learner, Any]) -> None:
    learner, fit = fitted
    x, y = samples(40.0, 2)
    assert learner.predict(x).shape == (2000, 2)
    assert (error(learner.predict(x), y) < 0.4).all(), error(learner.predict(x), y)
    assert set(fit.rmse) == set(OUTPUTS)
    assert fit.rmse["lift"] < 0.25 * np.sqrt(np.square(y[:, 0]).mean())
    assert fit.losses.shape == (30 * 4, 3)
    assert fit.losses[-1, 1] < 0.1 * fit.losses[0, 1]
    assert fit.swap.refusal == ""


def test_one_row_and_named_columns_give_the_same(fitted: tuple[Learner, Any]) -> None:
    learner, _ = fitted
    x, _ = samples(1.0, 3)
    rows = learner.predict(x)
    assert learner.predict(dict(zip(INPUTS, x.T, strict=True))) == pytest.approx(rows)
    assert learner.predict(x[7]) == pytest.approx(rows[7])
    assert learner.predict(dict(zip(INPUTS, x[7].tolist(), strict=True))).shape == (2,)
    Phi = learner.features(x)
    assert Phi.shape == (50, 20)
    assert (Phi[:, -1] == 1.0).all()


class LeastSquares:
    """A law of a user's own: recursive least squares with forgetting."""

    def start(self, theta: Array, dt: float, PB: Array) -> None:
        del PB
        self.keep = float(np.exp(-dt / 20.0))
        self.W, self.P = theta.copy(), np.eye(theta.shape[0])

    def update(self, Phi: Array, residual: Array, error: Array) -> None:
        del error
        g = self.P @ Phi
        gain = g / (self.keep + Phi @ g)
        self.W += np.outer(gain, residual - self.W.T @ Phi)
        self.P = (self.P - np.outer(gain, g)) / self.keep

    def estimate(self, Phi: Array) -> Array:
        nu: Array = self.W.T @ Phi
        return nu


@pytest.mark.parametrize("law", [KalmanLaw, GradientLaw, LeastSquares])
def test_the_last_layer_follows_a_change_that_the_features_have_not_seen(law: Any) -> None:
    learner = Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ, law=law())
    learner.fit(*samples(40.0, 1), rounds=15)
    x, y = samples(20.0, 4)
    y = 1.4 * y + [3.0, -0.02]
    before = error(learner.predict(x[500:]), y[500:])
    ahead = np.array([_one_ahead(learner, *row) for row in zip(x, y, strict=True)])
    assert (error(ahead[500:], y[500:]) < 0.5 * before).all(), (error(ahead[500:], y[500:]), before)
    plan = learner.swap(learner.fit(rounds=3, use=False))
    assert plan.refusal == ""
    assert np.isfinite(learner.predict(x[-1])).all()


def _one_ahead(learner: Learner, x: Array, y: Array) -> Array:
    found = learner.predict(x)
    learner.update(x, y)
    return found


def test_a_swap_keeps_the_estimate_at_the_present_state() -> None:
    learner = Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ)
    learner.fit(*samples(20.0, 1), rounds=3)
    x, y = samples(5.0, 2)
    for row in zip(x, 1.3 * y, strict=True):
        learner.update(*row)
    before = learner.predict(x[-1])
    better = learner.fit(*samples(40.0, 7), rounds=10, use=False)
    assert learner.predict(x[-1]) == pytest.approx(before)  # not in use yet
    assert learner.swap(better).refusal == ""
    assert learner.predict(x[-1]) == pytest.approx(before, abs=1e-6 * float(np.abs(before).max()))
    assert learner.predict(x[0]) != pytest.approx(before)


def test_a_jump_beyond_the_limit_is_refused_and_changes_nothing() -> None:
    learner = Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ, jump_max=1e-6, law=GradientLaw())
    learner.fit(*samples(20.0, 1), rounds=3)
    x, y = samples(4.0, 2)
    for row in zip(x, y, strict=True):
        learner.update(*row)
    before = learner.predict(x)
    fit = learner.fit(*samples(20.0, 7), rounds=3)
    assert fit.swap is not None
    assert fit.swap.refusal == "swap_jump"
    assert (learner.predict(x) == before).all()


def test_it_adapts_before_any_training_if_the_scales_are_given() -> None:
    x, y = samples(30.0, 1)
    scales = {name: (float(column.mean()), float(column.std())) for name, column in zip(INPUTS, x.T, strict=True)}
    sizes = dict(zip(OUTPUTS, SIZES.tolist(), strict=True))
    learner = Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ, input_scales=scales, output_scales=sizes)
    ahead = np.array([_one_ahead(learner, *row) for row in zip(x, y, strict=True)])
    assert (error(ahead[200:], y[200:]) < 0.4).all(), error(ahead[200:], y[200:])
    assert learner.fit(rounds=2).samples > 900  # the samples of update


@pytest.mark.parametrize("filter_s", [0.0, 0.2])
def test_the_residual_filter_may_be_off(filter_s: float) -> None:
    ones = dict.fromkeys(INPUTS, (0.0, 1.0))
    seen: list[Array] = []

    class Watched(LeastSquares):
        def update(self, Phi: Array, residual: Array, error: Array) -> None:
            seen.append(residual.copy())

    learner = Learner(
        INPUTS,
        OUTPUTS,
        rate_hz=RATE_HZ,
        law=Watched(),
        residual_filter_s=filter_s,
        input_scales=ones,
        output_scales={"lift": 1.0, "moment": 2.0},
    )
    learner.update(np.zeros(7), [4.0, 6.0])
    share = 1.0 if filter_s == 0.0 else 1.0 - np.exp(-0.02 / filter_s)
    assert seen[0] == pytest.approx(share * np.array([4.0, 3.0]))


def test_the_tracking_error_acts_with_a_damping_per_output() -> None:
    weights = Tracking((3.0, 5.0), (0.7, 2.0)).weights()
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag([9.0, 25.0]), -np.diag([2 * 0.7 * 3.0, 2 * 2.0 * 5.0])]])
    assert (np.linalg.eigvals(A).real < 0.0).all()
    assert weights.shape == (4, 2)
    assert weights[0, 0] == pytest.approx(1.0)
    assert weights[2, 0] / weights[0, 0] != pytest.approx(weights[3, 1] / weights[1, 1])
    options: Any = {
        "rate_hz": RATE_HZ,
        "input_scales": dict.fromkeys(INPUTS, (0.0, 1.0)),
        "output_scales": dict.fromkeys(OUTPUTS, 1.0),
    }
    learner = Learner(INPUTS, OUTPUTS, tracking=Tracking((3.0, 5.0), (0.7, 2.0)), **options)
    for _ in range(100):
        learner.update(np.zeros(7), learner.predict(np.zeros(7)), error=[0.5, 0.0, 0.0, 0.0])
    lift, moment = learner.predict(np.zeros(7))
    assert lift < -0.1  # the sign of the law: nu falls while x_rm - x is positive
    assert abs(moment) < 0.01 * abs(lift)
    with pytest.raises(ValueError, match="only with `tracking`"):
        Learner(INPUTS, OUTPUTS, **options).update(np.zeros(7), [0.0, 0.0], error=np.zeros(4))


def test_torch_is_left_as_it_is() -> None:
    torch.set_default_dtype(torch.float64)
    try:
        learner = Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ, trainer=trainer(slope_weight=0.1))
        assert np.isfinite(list(learner.fit(*samples(20.0, 1), rounds=2).rmse.values())).all()
        assert torch.get_default_dtype() == torch.float64
    finally:
        torch.set_default_dtype(torch.float32)
    lines = (
        "import torch; torch.set_num_threads(3)",
        "import numpy as np; from async_dmrac import Learner",
        "x = np.random.default_rng(1).normal(size=(500, 2))",
        "Learner(['a', 'b'], ['c'], rate_hz=10.0).fit(x, x[:, :1] * x[:, 1:], rounds=1)",
        "assert torch.get_num_threads() == 3",
    )
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True, cwd=ROOT, timeout=250)


def trainer(**values: Any) -> Any:
    from offboard.config import TrainerConfig

    return TrainerConfig(**values)


def test_samples_without_a_label_are_left_out() -> None:
    x, y = samples(30.0, 1)
    spoilt = y.copy()
    spoilt[::3] = np.nan
    learner = Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ)
    some, all_ = learner.fit(x, spoilt, rounds=1), Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ).fit(x, y, rounds=1)
    assert 0.6 * all_.samples < some.samples < 0.72 * all_.samples
    assert np.isfinite(some.losses).all()


@pytest.mark.parametrize(
    ("signals", "labels", "message"),
    [
        ({"speed": [1.0]}, [[1.0, 2.0]], "signals: no column 'angle'; given are speed"),
        (np.zeros((5, 6)), np.zeros((5, 2)), r"signals: shape \(5, 6\), expected \(n, 7\): speed"),
        (np.zeros((5, 7)), np.zeros((4, 2)), "labels: 4 rows, but signals have 5"),
        (np.zeros((50, 7)), np.zeros((50, 2)), "labelled samples to train on, expected at least 60"),
        (np.full((5, 7), np.nan), np.zeros((5, 2)), "not finite"),
        (None, np.zeros((5, 2)), "expected signals and labels, or neither"),
        (None, None, "update has collected no samples"),
    ],
)
def test_wrong_samples_are_named(signals: Any, labels: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ).fit(signals, labels)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inputs": "speed"}, "inputs: 'speed': expected a list of different names"),
        ({"outputs": ["a", "a"]}, "outputs: .*expected a list of different names"),
        ({"rate_hz": 0.0}, "rate_hz 0.0"),
        ({"features": 1}, "features 1"),
        ({"tracking": Tracking((1.0,), (0.7,))}, "tracking: for 1 outputs, expected 2"),
        ({"input_scales": {}, "output_scales": {}}, "input_scales: no entry for 'speed'"),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Learner(**{"inputs": INPUTS, "outputs": OUTPUTS, "rate_hz": RATE_HZ} | options)


def test_an_untrained_learner_says_so() -> None:
    with pytest.raises(ValueError, match="nothing was fitted yet"):
        Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ).predict(np.zeros(7))


def test_the_law_takes_its_own_settings() -> None:
    slow = KalmanConfig(
        kind="kalman",
        tracking_gain=0.0,
        composite_gain=0.1,
        noise=0.3,
        prior=0.5,
        fast_bias=0.5,
        prior_rate=0.03,
        fast_bias_rate=2.0,
        weight_norm_max=10.0,
    )
    scales: Any = {
        "input_scales": dict.fromkeys(INPUTS, (0.0, 1.0)),
        "output_scales": dict.fromkeys(OUTPUTS, 1.0),
        "rate_hz": RATE_HZ,
    }
    usual, slower = (Learner(INPUTS, OUTPUTS, law=law, **scales) for law in (KalmanLaw(), KalmanLaw(slow)))
    found = [one.update(np.ones(7), [1.0, 1.0]) for one in (usual, slower)]
    assert found[0][0] > 20.0 * found[1][0] > 0.0


@pytest.mark.parametrize("law", [KalmanLaw, GradientLaw])
def test_a_restarted_learner_behaves_like_a_new_one(law: type) -> None:
    def new() -> Learner:
        scales, sizes = dict.fromkeys(INPUTS, (0.0, 1.0)), dict(zip(OUTPUTS, SIZES.tolist(), strict=True))
        return Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ, law=law(), input_scales=scales, output_scales=sizes)

    def fly(learner: Learner) -> Array:
        return np.array([learner.update(a, b) for a, b in zip(x, y, strict=True)])

    (x, y), learner = samples(2.0, 3), new()
    first = fly(learner)
    going_on = fly(learner)
    learner.restart()
    assert (fly(learner) == first).all()
    assert not np.allclose(going_on, first)


def test_a_learner_without_scales_cannot_restart() -> None:
    with pytest.raises(ValueError, match="nothing was fitted yet"):
        Learner(INPUTS, OUTPUTS, rate_hz=RATE_HZ).restart()
