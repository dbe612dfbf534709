"""Readings are packed in one step as C has them, in both number types."""

import struct
from typing import Any

import numpy as np
import pytest

from onboard.c.compiled_core import BATTERY, FLOW, IMU, RANGE, _Packed
from onboard.c.library import BuildError, Variant, compiler, load

try:
    compiler()
except BuildError as error:
    pytest.skip(str(error), allow_module_level=True)


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize(
    ("name", "layout", "given"),
    [
        ("ImuReading", IMU, (2**40 + 1, 1.5, -2.5, 3.5, 4.25, -5.25, 6.25, True, 101325.0)),
        ("FlowReading", FLOW, (7, 0.5, 1.5, -2.5, 3.5, -4.5, 255)),
        ("RangeReading", RANGE, (-9, 0.75)),
        ("BatteryReading", BATTERY, (11, 3.75, -1.0)),
    ],
)
def test_every_member_gets_its_number(real: str, name: str, layout: str, given: tuple[Any, ...]) -> None:
    library = load(Variant(real=real))
    packed = _Packed(library, getattr(library, name), layout)
    packed.fill(*given)
    filled = packed.filled
    found: list[Any] = []
    for member, _ in filled._fields_:
        value = getattr(filled, member)
        found += np.ctypeslib.as_array(value).tolist() if hasattr(value, "_length_") else [value]
    assert tuple(found) == given


def test_a_number_too_many_is_an_error() -> None:
    library = load(Variant())
    with pytest.raises(struct.error):
        _Packed(library, library.RangeReading, RANGE).fill(1, 2.0, 3.0)
