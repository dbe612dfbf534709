"""The elementary functions: errors in ulp against extended precision, special values, the same bits everywhere."""

import math
from hashlib import sha256

import numpy as np
import pytest

from onboard.c.compile import Variant
from onboard.c.library import Core, load
from tests.onboard.c.parity import SANITIZED, real

RANGES = {
    "exp": (-700.0, 700.0),
    "expm1": (-700.0, 700.0),
    "tanh": (-25.0, 25.0),
    "sin": (-8000.0, 8000.0),
    "cos": (-8000.0, 8000.0),
    "tan": (-1.5, 1.5),
    "asin": (-1.0, 1.0),
    "acos": (-1.0, 1.0),
}
RANGES_32 = {**RANGES, "exp": (-87.0, 87.0), "expm1": (-87.0, 87.0), "sin": (-100.0, 100.0), "cos": (-100.0, 100.0)}
ULPS = {"exp": 1.0, "sin": 1.0, "cos": 1.0, "atan2": 1.5}
"""What elementary.h promises; all others 2.5."""
FLOAT_DIGEST = "72690f378de21bdf"
"""Of the results of all functions in float, on fixed arguments: the same on every machine."""

COUNT = 200 if SANITIZED else 1500

needs_extended = pytest.mark.skipif(np.finfo(np.longdouble).nmant <= 52, reason="no extended precision here")


def arguments(low: float, high: float, kind: np.dtype) -> np.ndarray:
    rng = np.random.default_rng(5)
    wide, near = rng.uniform(low, high, COUNT), rng.uniform(max(low, -4.0), min(high, 4.0), COUNT)
    tiny = np.exp(rng.uniform(-30.0, 0.0, COUNT)) * rng.choice([-1.0, 1.0], COUNT)
    return np.clip(np.concatenate([wide, near, tiny]), low, high).astype(kind)


def ulps(ours: np.ndarray, exact: np.ndarray) -> float:
    return float(np.max(np.abs(ours.astype(np.longdouble) - exact) / np.spacing(np.abs(exact).astype(ours.dtype))))


@needs_extended
@pytest.mark.parametrize("which", ["core", "core32"])
@pytest.mark.parametrize("name", RANGES)
def test_functions_of_one_number(request: pytest.FixtureRequest, which: str, name: str) -> None:
    core = request.getfixturevalue(which)
    x = arguments(*(RANGES if core.real == "double" else RANGES_32)[name], real(core))
    ours = np.array([getattr(core, f"real_{name}")(one) for one in x], real(core))
    exact = getattr(np, {"asin": "arcsin", "acos": "arccos"}.get(name, name))(x.astype(np.longdouble))
    assert ulps(ours, exact) <= ULPS.get(name, 2.5)


@needs_extended
@pytest.mark.parametrize("which", ["core", "core32"])
def test_atan2(request: pytest.FixtureRequest, which: str) -> None:
    core = request.getfixturevalue(which)
    rng = np.random.default_rng(6)
    y, x = (np.exp(rng.uniform(-20, 20, 3000)) * rng.choice([-1.0, 1.0], 3000) for _ in "yx")
    y, x = y.astype(real(core)), x.astype(real(core))
    ours = np.array([core.real_atan2(b, a) for b, a in zip(y, x, strict=True)], real(core))
    assert ulps(ours, np.arctan2(y.astype(np.longdouble), x.astype(np.longdouble))) <= ULPS["atan2"]


@pytest.mark.parametrize("which", ["core", "core32"])
def test_special_values(request: pytest.FixtureRequest, which: str) -> None:
    core = request.getfixturevalue(which)
    assert core.real_exp(0.0) == 1.0
    assert core.real_exp(-1e4) == 0.0
    assert core.real_exp(1e4) == math.inf
    assert core.real_tanh(50.0) == 1.0
    assert core.real_tanh(-math.inf) == -1.0
    assert math.copysign(1.0, core.real_tanh(-0.0)) == -1.0
    for y in (0.0, -0.0, 1.0, -1.0):
        for x in (0.0, -0.0, 1.0, -1.0):
            ours, libm = core.real_atan2(y, x), math.atan2(y, x)
            assert ours == pytest.approx(libm, rel=1e-7)
            assert math.copysign(1.0, ours) == math.copysign(1.0, libm)
    for name in (*RANGES, "atan2"):
        given = (math.nan, 1.0) if name == "atan2" else (math.nan,)
        assert math.isnan(getattr(core, f"real_{name}")(*given))
    assert math.isnan(core.real_sin(1e7))
    assert math.isnan(core.real_asin(1.001))


def test_subnormal_results_of_exp(core: Core) -> None:
    for x in (-709.5, -720.0, -744.0):
        assert core.real_exp(x) == pytest.approx(math.exp(x), rel=1e-15, abs=5e-324)


@pytest.mark.parametrize("which", ["core", "core32"])
def test_whole_numbers_and_choices(request: pytest.FixtureRequest, which: str) -> None:
    core = request.getfixturevalue(which)
    for x in (-2.5, -2.0, -0.25, 0.0, 0.25, 2.0, 1e6 + 0.5):
        assert core.real_floor(x) == math.floor(x)
        assert core.real_abs(x) == abs(x)
    assert core.real_min(1.0, 2.0) == core.real_clip(-5.0, 1.0, 2.0) == 1.0
    assert core.real_max(1.0, 2.0) == core.real_clip(5.0, 1.0, 2.0) == 2.0
    assert core.real_largest(1.0, 2.0) == core.real_largest(2.0, 1.0) == 2.0
    assert math.isnan(core.real_largest(math.nan, 1.0))
    assert math.isnan(core.real_largest(1.0, math.nan))
    assert math.isnan(core.real_min(math.nan, 1.0)) == math.isnan(min(math.nan, 1.0))
    assert [core.real_is_finite(x) for x in (1.0, math.inf, -math.inf, math.nan)] == [True, False, False, False]


def float_results(core: Core) -> bytes:
    results = []
    for name, (low, high) in RANGES_32.items():
        for x in np.linspace(low, high, 801).astype(np.float32):
            results.append(getattr(core, f"real_{name}")(x))
    for angle in np.linspace(-3.0, 3.0, 401).astype(np.float32):
        results += [core.real_atan2(angle, 0.5), core.real_sqrt(abs(angle)), core.angle_within_turn(1000.0 * angle)]
    return np.array(results, np.float32).tobytes()


def test_float_results_are_the_same_bits_on_every_machine(core32: Core) -> None:
    assert sha256(float_results(core32)).hexdigest()[:16] == FLOAT_DIGEST


def test_float_results_do_not_depend_on_the_optimisation(core32: Core) -> None:
    expected = float_results(core32)
    for options in (("-O0",), ("-O3", "-march=native")):
        assert float_results(load(Variant("float", options))) == expected


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_large_angles_in_float(core32: Core, name: str) -> None:
    x = np.linspace(-8000.0, 8000.0, 5001).astype(np.float32)
    ours = np.array([getattr(core32, f"real_{name}")(one) for one in x])
    assert np.abs(ours - getattr(np, name)(x.astype(np.float64))).max() < 1e-7


def test_angles_that_grow_stay_exact_in_float(core32: Core) -> None:
    angle = 2.0 * math.pi * 1000.0 + 1.0
    assert core32.real_sin(core32.angle_within_turn(angle)) == pytest.approx(math.sin(angle), abs=1e-6)
    assert abs(core32.real_sin(angle) - math.sin(angle)) > 1e-4  # what it is for
