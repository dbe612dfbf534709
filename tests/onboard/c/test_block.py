"""Vectors of floats in whole numbers: exact to 2^-27 of their largest number."""

import ctypes

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from protocol.conventions import Array
from tests.onboard.c.parity import SETTINGS

NUMBERS = st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=40)
BITS = 27


def block_of(core: Core, x: Array, stride: int = 1) -> tuple[Array, float]:
    """Whole numbers and their unit."""
    numbers = np.zeros(len(x) // stride, np.int32)
    return numbers, core.block_of(x.astype(np.float32), len(numbers), stride, numbers)


@SETTINGS
@given(x=NUMBERS, exponent=st.integers(-60, 60))
def test_numbers_and_unit(core32: Core, x: list[float], exponent: int) -> None:
    given_x = (np.array(x) * 2.0**exponent).astype(np.float32)
    numbers, unit = block_of(core32, given_x)
    assert np.abs(numbers).max() < 2**BITS
    largest = np.abs(given_x.astype(np.float64)).max()
    off = np.abs(numbers.astype(np.float64) * unit - given_x)
    assert off.max() <= max(largest * 2.0 ** (1 - BITS), 1e-30)


def test_every_third_number(core32: Core) -> None:
    numbers, unit = block_of(core32, np.arange(12, dtype=np.float32), 3)
    assert (numbers * unit).tolist() == [0.0, 3.0, 6.0, 9.0]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_has_no_unit(core32: Core, bad: float) -> None:
    _, unit = block_of(core32, np.array([1.0, bad, 2.0]))
    assert np.isnan(unit)


@SETTINGS
@given(x=NUMBERS, y=NUMBERS)
def test_products(core32: Core, x: list[float], y: list[float]) -> None:
    n = min(len(x), len(y))
    a, b = (np.array(one[:n], np.float32) for one in (x, y))
    (of_a, unit_a), (of_b, unit_b) = block_of(core32, a), block_of(core32, b)
    found = core32.block_dot(of_a, of_b, n) * unit_a * unit_b
    sizes = [np.abs(one.astype(np.float64)).max() for one in (a, b)]
    allowed = n * sizes[0] * sizes[1] * 2.0 ** (3 - BITS) + 1e-25
    assert abs(found - float(a.astype(np.float64) @ b.astype(np.float64))) <= allowed


@SETTINGS
@given(x=st.lists(st.floats(-1e3, 1e3, width=32), min_size=6, max_size=6), exponent=st.integers(-40, 20))
def test_a_product_of_three(core32: Core, x: list[float], exponent: int) -> None:
    a = (np.array(x[:3]) * 2.0**exponent).astype(np.float32)
    b = np.array(x[3:], np.float32)
    (of_a, unit_a), (of_b, unit_b) = block_of(core32, a), block_of(core32, b)
    found = core32.block_product(of_a, unit_a, of_b, unit_b)
    sizes = [np.abs(one.astype(np.float64)).max() for one in (a, b)]
    exact = float(a.astype(np.float64) @ b.astype(np.float64))
    assert abs(found - exact) <= 3.0 * sizes[0] * sizes[1] * 2.0**-22 + 1e-25
    assert np.isnan(core32.block_product(of_a, float("nan"), of_b, unit_b))


@SETTINGS
@given(x=st.floats(-4e4, 4e4, width=32), bits=st.integers(0, 15))
def test_the_nearest_whole_number(core32: Core, x: float, bits: int) -> None:
    exact = np.floor(abs(x) * 2.0**bits + 0.5) * np.sign(x)
    found = core32.nearest_whole(x, bits)
    assert found == int(exact)


@pytest.mark.parametrize("x", [1e30, -1e30, float("inf"), float("-inf"), float("nan")])
def test_what_does_not_fit_is_the_largest_whole_number(core32: Core, x: float) -> None:
    assert abs(core32.nearest_whole(x, 15)) == ctypes.c_uint32(-1).value // 2
