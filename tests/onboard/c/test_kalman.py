"""The last-layer law with a covariance: the C core against numpy's, and S over very many steps in float."""

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.compile import FOLDER, Variant, compiler, run
from onboard.c.library import Core
from onboard.control.laws.kalman_last_layer import KalmanConfig, KalmanLastLayer, fade, prior_variance, project
from onboard.control.laws.kalman_state import KalmanState
from tests.onboard.c.conftest import OPTIONS
from tests.onboard.c.parity import SANITIZED, SETTINGS, array, configured, same, view
from tests.onboard.c.test_laws import GAINS, weights_of
from tests.onboard.control.fixture import DT

SEEDS = st.integers(0, 2**31)
COUNTS = st.sampled_from([1, 2, 6, 20])
STEPS = 60 if SANITIZED else 300


def kalman_config(**over: Any) -> KalmanConfig:
    values = {
        "kind": "kalman", "tracking_gain": 50.0, "composite_gain": 20.0, "noise": 0.5, "prior": 0.8, "fast_bias": 0.5,
        "prior_rate": 0.03, "fast_bias_rate": 2.0, "weight_norm_max": 40.0,
    }  # fmt: skip
    return KalmanConfig(**{**values, **over})


# --- the filter ---


def states_of(core: Core, n: int, seed: int) -> tuple[Any, KalmanState, np.random.Generator]:
    """The same state in both cores, S well below S0 and full."""
    rng = np.random.default_rng(seed)
    variance, rates = rng.uniform(0.2, 3.0, n), rng.choice([0.0, 0.003, 0.3, 50.0], n)
    ours, theirs = core.KalmanState(), KalmanState(np.zeros((n, 3)), variance, rates)
    core.kalman_state_init(ours, variance, rates, n)
    same_state(ours, theirs, 0.0)
    root = rng.normal(size=(n, n)) / n
    half = np.diag(np.sqrt(variance))
    S = half @ np.linalg.inv(np.eye(n) + root @ root.T * 20.0) @ half
    theirs.S[:], theirs.X_rows[:] = 0.5 * (S + S.T), rng.normal(size=(3, n))
    view(ours.S)[: n * n], view(ours.X)[: 3 * n] = theirs.S.reshape(-1), theirs.X_rows.T.reshape(-1)
    return ours, theirs, rng


def covariance(state: Any) -> np.ndarray[Any, Any]:
    """S [n, n] of a KalmanState of C."""
    return view(state.S)[: state.size**2].reshape(state.size, state.size)


def same_state(ours: Any, theirs: KalmanState, rtol: float) -> None:
    n = theirs.S.shape[0]
    assert ours.size == n
    same(view(ours.X)[: 3 * n], theirs.X_rows.T, rtol, scale=1e-3)
    same(covariance(ours), theirs.S, rtol)
    np.testing.assert_array_equal(covariance(ours), covariance(ours).T)


@SETTINGS
@given(seed=SEEDS, n=st.integers(1, 24), dts=st.lists(st.sampled_from([0.0, DT, 4 * DT, 1.0]), min_size=1, max_size=4))
def test_the_filter(core: Core, seed: int, n: int, dts: list[float]) -> None:
    ours, theirs, rng = states_of(core, n, seed)
    for dt in dts:
        theirs.predict(dt)
        core.kalman_state_predict(ours, dt)
        same_state(ours, theirs, 1e-12)
        phi, innovation, R = rng.normal(size=n), rng.normal(size=3), rng.uniform(0.01, 10.0)
        along, g, x = theirs.along(phi[:, None])[:, 0], np.empty(n), np.empty(3)
        core.kalman_state_along(ours, phi, n, g, x)
        same(x, along[3:6], scale=1.0)
        same(g, along[6:])
        v = R + float(phi @ along[6:])
        theirs.correct(along[6:], innovation.tolist(), v)
        core.kalman_state_correct(ours, g, innovation, v)
        same_state(ours, theirs, 1e-12)


def test_a_column_with_zeros_at_its_end(core: Core) -> None:
    ours, theirs, rng = states_of(core, 5, 3)
    phi, g, x = np.append(rng.normal(size=3), [0.0, 0.0]), np.empty(5), np.empty(3)
    along = theirs.along(phi[:, None])[:, 0]
    core.kalman_state_along(ours, phi, 3, g, x)
    same(np.append(x, g), along[3:])


# --- the law ---


def layers(core: Core, config: KalmanConfig, k: int) -> tuple[Any, KalmanLastLayer]:
    ours, PB = core.KalmanLastLayer(), core.TrackingWeights()
    core.tracking_weights(configured(core, GAINS), array(core, (1.0, 0.1)), PB)
    core.kalman_layer_init(ours, configured(core, config), k, PB)
    return ours, KalmanLastLayer(config, k, weights_of(GAINS, (1.0, 0.1)), GAINS.pairs())


def columns(rng: np.random.Generator, k: int) -> np.ndarray[Any, Any]:
    """Features [k, 3] of three states near one another."""
    Phi = np.tanh(rng.normal(size=(k, 1)) + [0.0, 0.3, 0.3] * rng.normal(size=(k, 3)))
    Phi[-1] = 1.0
    return Phi


def of_tick(Phi: Any) -> np.ndarray[Any, Any]:
    """The same as C has it, [3, k]."""
    return np.ascontiguousarray(Phi.T)


def step_layers(
    core: Core, ours: Any, theirs: KalmanLastLayer, Phi: Any, e: Any, residual: Any, dt: float, rtol: float
) -> None:
    """One step in both; compares what they learnt and nu, as the step returns it and as it is evaluated afterwards."""
    with np.errstate(invalid="ignore"):
        expected = theirs.step(Phi, e, residual.tolist(), dt)
    nu, nu_cmd = np.empty(3), np.empty(3)
    core.kalman_layer_step(ours, of_tick(Phi), e, residual, dt, nu, nu_cmd)
    same_layers(core, ours, theirs, rtol)
    same(np.stack([nu, nu_cmd], axis=1), expected, rtol, scale=1.0)
    core.kalman_layer_estimate(ours, of_tick(Phi), nu, nu_cmd)
    same(np.stack([nu, nu_cmd], axis=1), theirs.estimate(Phi), 10.0 * rtol, scale=1.0)


def close_both(core: Core, ours: Any, theirs: KalmanLastLayer, Phi: Any) -> None:
    """The deviation from the path counts in full."""
    theirs.close_gap(Phi)
    core.kalman_layer_close_gap(ours, of_tick(Phi))
    same_gap(ours, theirs, 1e-12)


def same_gap(ours: Any, theirs: KalmanLastLayer, rtol: float) -> None:
    gap = theirs._gap
    for one, other in ((ours.gap.values, gap.values), (ours.gap.error, gap._error), (ours.gap.rate, gap._rate)):
        same(view(one), other, rtol, scale=1.0)


def same_layers(core: Core, ours: Any, theirs: KalmanLastLayer, rtol: float) -> None:
    k = theirs.theta.shape[0]
    same_state(ours.state, theirs.state, rtol)
    W = np.empty((k, 3))
    core.kalman_layer_W(ours, W)
    same(W, theirs.W, rtol, scale=1.0)
    same(core.kalman_layer_weight_norm(ours) ** 2, theirs.weight_norm**2, rtol, scale=1.0)
    same_gap(ours, theirs, rtol)
    same(view(ours.skill.shares), theirs._skill.shares, 1e3 * rtol, scale=1.0)  # quotients of two small sums


LAWS = st.fixed_dictionaries(
    {
        "composite_gain": st.sampled_from([0.0, 2.0, 30.0]),
        "tracking_gain": st.sampled_from([0.0, 80.0]),
        "noise": st.sampled_from([0.05, 0.5, 5.0]),
        "prior": st.sampled_from([0.1, 0.8]),
        "fast_bias": st.sampled_from([0.3, 5.0]),
        "prior_rate": st.sampled_from([0.003, 0.5]),
        "weight_norm_max": st.sampled_from([0.5, 40.0]),
        "confidence": st.booleans(),
        "skill": st.booleans(),
    }
)


@SETTINGS
@given(seed=SEEDS, k=COUNTS, law=LAWS)
def test_the_law(core: Core, seed: int, k: int, law: Any) -> None:
    """Single steps, from a state that both cores share before each."""
    ours, theirs = layers(core, kalman_config(**law), k)
    rng = np.random.default_rng(seed)
    theta = 0.3 * rng.normal(size=(k, 3))
    theirs.replace(theta + 0.1 * rng.normal(size=(k, 3)), theta)
    for _ in range(4):
        X, S = theirs.state.X_rows.T.copy(), theirs.state.S.copy()
        theirs.adopt(theta, X, S)
        core.kalman_layer_adopt(ours, theta, X, S, k)
        same_layers(core, ours, theirs, 1e-12)
        close_both(core, ours, theirs, columns(rng, k))
        Phi, e, residual = columns(rng, k), 0.1 * rng.normal(size=6), 3.0 * rng.normal(size=3)
        step_layers(core, ours, theirs, Phi, e, residual, DT * int(rng.choice([1, 4])), 1e-12)


@SETTINGS
@given(seed=SEEDS, k=COUNTS, law=LAWS)
def test_the_law_over_some_seconds(core: Core, seed: int, k: int, law: Any) -> None:
    """Each core goes on from its own state: missed ticks, steps that are left out, W that is replaced on the way."""
    ours, theirs = layers(core, kalman_config(**law), k)
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.5, 6.0, k)
    for index in range(STEPS):
        t = index * DT + np.array([0.0, 0.15, 0.03])
        Phi = np.tanh(2.0 * np.sin(turn[:, None] * t + turn[:, None]))
        Phi[-1] = 1.0
        if index % 90 == 70:
            W, theta = rng.normal(size=(k, 3)), rng.normal(size=(k, 3))
            theirs.replace(W, theta)
            core.kalman_layer_replace(ours, W, theta, k)
            same_layers(core, ours, theirs, 1e-11)
            close_both(core, ours, theirs, Phi)
        residual = 2.0 * Phi[0, 0] + 0.3 * rng.normal(size=3)
        if index % 40 == 39:
            residual[index % 3] = [np.nan, np.inf, 1e200][index % 7 % 3]
        dt = DT * (4 if index % 25 == 3 else 1)
        step_layers(core, ours, theirs, Phi, 0.1 * rng.normal(size=6), residual, dt, 1e-10)


def test_what_these_sequences_reach(core: Core) -> None:
    """The limit of the gain binds or not, X is projected or not, nu fades ahead or not, and there is a gap or none."""
    seen: set[str] = set()
    rng, ours = np.random.default_rng(1), layers(core, kalman_config(), 6)[0]
    for _ in range(50):
        Phi, nu, nu_cmd = columns(rng, 6), np.empty(3), np.empty(3)
        core.kalman_layer_step(ours, of_tick(Phi), np.zeros(6), 3.0 * rng.normal(size=3), DT, nu, nu_cmd)
        seen |= {"skill" if 0.0 < share < 1.0 else "none" if share == 0.0 else "all" for share in ours.skill.shares}
    for noise, radius in ((0.05, 40.0), (5.0, 40.0), (0.05, 0.5)):
        ours, _ = layers(core, kalman_config(noise=noise, weight_norm_max=radius, skill=False), 6)
        rng = np.random.default_rng(1)
        for _ in range(50):
            Phi, nu, nu_cmd = columns(rng, 6), np.empty(3), np.empty(3)
            if rng.uniform() < 0.2:  # on the path
                Phi[:, 2] = Phi[:, 0]
                core.kalman_layer_close_gap(ours, of_tick(Phi))
            core.kalman_layer_step(ours, of_tick(Phi), np.zeros(6), 3.0 * rng.normal(size=3), DT, nu, nu_cmd)
            phi = np.append(Phi[:, 0], 1.0)
            s = phi @ covariance(ours.state) @ phi
            seen.add("limited" if s / (20.0 * DT) > noise**2 else "free")
            seen.add("on the ball" if ours.X_norm2 > 0.999 * radius**2 else "inside")
            plain = view(ours.state.X)[:21].reshape(7, 3).T @ np.append(Phi[:, 1], 1.0)
            gap = view(ours.gap.values)
            seen.add("fades" if np.abs(nu_cmd - gap - plain).max() > 1e-6 else "does not fade")
            seen.add("gap" if np.abs(gap).max() > 0.01 else "no gap")
    assert seen >= {"limited", "free", "on the ball", "inside", "fades", "does not fade", "gap", "no gap"}
    assert seen >= {"skill", "none"}


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
def test_a_step_that_is_not_finite_only_predicts(core: Core, bad: float) -> None:
    ours, theirs = layers(core, kalman_config(), 4)
    rng = np.random.default_rng(2)
    step_layers(core, ours, theirs, columns(rng, 4), np.ones(6), np.ones(3), DT, 1e-12)
    for e, residual in (([bad, 0, 0, 0, 0, 0], [1, 1, 1]), ([0] * 6, [1, bad, 1])):
        step_layers(core, ours, theirs, columns(rng, 4), np.array(e, float), np.array(residual, float), DT, 1e-12)
    theirs.state.predict(DT)
    core.kalman_state_predict(ours.state, DT)
    same_state(ours.state, theirs.state, 1e-12)
    Phi = columns(rng, 4)
    Phi[1, 0] = bad
    before, gap = covariance(ours.state).copy(), view(ours.gap).copy()
    core.kalman_layer_step(ours, of_tick(Phi), np.zeros(6), np.zeros(3), DT, np.empty(3), np.empty(3))
    assert np.isfinite(view(ours.state.X)).all()
    np.testing.assert_array_equal(view(ours.gap), gap)
    same(covariance(ours.state), before, 1e-2)


@SETTINGS
@given(seed=SEEDS, n=st.integers(1, 22), far=st.sampled_from([1.0001, 3.0, 100.0]), spread=st.sampled_from([0.0, 6.0]))
def test_projection(core: Core, seed: int, n: int, far: float, spread: float) -> None:
    rng = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(rng.normal(size=(n, n)))
    S = axes @ np.diag(np.exp(-rng.uniform(0.0, spread, n))) @ axes.T
    S, X, radius = 0.5 * (S + S.T), rng.normal(size=(n, 3)), 2.0
    X *= far * radius / np.linalg.norm(X)
    ours = X.copy()
    core.project(ours, S, n, radius, np.empty(n * n))
    same(ours, project(X.T.copy(), S, radius).T, 1e-11)
    inside = 0.999 * X / far
    ours = inside.copy()
    core.project(ours, S, n, radius, np.empty(n * n))
    np.testing.assert_array_equal(ours, inside)


@SETTINGS
@given(seed=SEEDS)
def test_in_float_the_law_stays_near_that_in_double(core32: Core, seed: int) -> None:
    config, rng = kalman_config(noise=0.3), np.random.default_rng(seed)
    ours, theirs = core32.KalmanLastLayer(), KalmanLastLayer(config, 20, weights_of(GAINS, (1.0, 0.1)), GAINS.pairs())
    PB, nu, nu_cmd = core32.TrackingWeights(), np.empty(3, np.float32), np.empty(3, np.float32)
    core32.tracking_weights(configured(core32, GAINS), array(core32, (1.0, 0.1)), PB)
    core32.kalman_layer_init(ours, configured(core32, config), 20, PB)
    for index in range(STEPS):
        Phi, e, residual = columns(rng, 20), 0.1 * rng.normal(size=6), 3.0 * rng.normal(size=3)
        expected = theirs.step(Phi, e, residual.tolist(), DT)
        given_ = [array(core32, one) for one in (of_tick(Phi), e, residual)]
        core32.kalman_layer_step(ours, *given_, DT, nu, nu_cmd)
        if index > 10:  # before, the confidence is the difference of two numbers that are nearly equal
            same(np.stack([nu, nu_cmd], axis=1), expected, 1e-4, scale=1.0)
    same(covariance(ours.state), theirs.state.S, 1e-4)


def test_fade_and_variances(core: Core) -> None:
    for here, ahead in ((0.5, 0.2), (0.5, -0.1), (0.2, 0.5), (-0.1, -0.2), (0.0, -1.0)):
        assert core.fade(here, ahead) == fade(here, ahead)
    config = kalman_config(residual_filter_s=0.013)
    ours, theirs = layers(core, config, 6)
    assert core.kalman_layer_residual_variance(ours, DT) == pytest.approx(theirs.residual_variance(DT), rel=1e-15)
    same(view(ours.state.prior_variance)[:7], prior_variance(config, 6))


# --- very many steps in float ---

LONG = Path(__file__).with_name("long_run.c")
LAW_FILES = ("kalman_state", "kalman_last_layer", "last_layer", "products", "forecast_skill", "path_gap")
EVERY = 9970


@pytest.mark.parametrize("steps", [1_000_000, pytest.param(10_000_000, marks=pytest.mark.full)])
def test_s_stays_symmetric_and_positive_definite_in_float(core32: Core, tmp_path: Path, steps: int) -> None:
    """The course and the limits of the numpy test of the same name; and the law itself on that course."""
    if SANITIZED:
        steps = 20_000
    library = tmp_path / "long_run.so"
    parts = [LONG, *(FOLDER / "numerics").glob("*.c"), FOLDER / "control/reference_model.c"]
    parts += [FOLDER / f"control/laws/{name}.c" for name in LAW_FILES]
    parts += [FOLDER / "protocol/geometry.c"]
    run(
        [*compiler(), *Variant("float", OPTIONS).flags, "-shared", "-fPIC", *map(str, parts), "-lm", "-o", str(library)]
    )
    config, n = kalman_config(noise=0.3, tracking_gain=0.0), 21
    variance, long_run = prior_variance(config, n - 1), ctypes.CDLL(str(library))
    for name in ("run_filter", "run_law"):
        layer = core32.KalmanLastLayer()
        core32.kalman_layer_init(layer, configured(core32, config), n - 1, core32.TrackingWeights())
        S = np.zeros((steps // EVERY + 1, n, n), np.float32)
        turn = np.random.default_rng(3).uniform(0.1, 6.0, n).astype(np.float32)
        taken = getattr(long_run, name)(ctypes.byref(layer), turn.ctypes, steps, EVERY, S.ctypes)
        assert taken == S.shape[0]
        assert np.isfinite(view(layer.state.X)).all()
        np.testing.assert_array_equal(S, S.transpose(0, 2, 1))
        values = np.linalg.eigvalsh(S.astype(np.float64))
        assert values[:, 0].min() > 1e-5
        assert values[:, -1].max() <= 1.001 * variance.max()
