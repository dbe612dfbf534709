"""Helpers that bring Python values to C and back, and compare."""

import ctypes
import os
from typing import Any

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from pydantic import BaseModel

from onboard.c.config_table import Leaf, OneOf, Record, Several, record_of
from onboard.c.feature_arrays import view

SANITIZED = os.environ.get("DMRAC_TEST_SANITIZED") == "1"
"""Set by test_sanitizers.py, which runs these tests again in a process that the sanitizers watch."""
SETTINGS = settings(max_examples=10 if SANITIZED else 20, deadline=None, derandomize=True)
RTOL = 1e-12
"""Largest difference of a step in double, relative to the largest number compared."""


def numbers(size: float, least: float | None = None) -> st.SearchStrategy[float]:
    """Numbers from -size (or `least`) to size, without tiny ones that only test underflow."""
    low = -size if least is None else least
    return st.floats(low, size, allow_nan=False).map(lambda x: 0.0 if abs(x) < 1e-9 else x)


def vectors(count: int, size: float) -> st.SearchStrategy[list[float]]:
    return st.lists(numbers(size), min_size=count, max_size=count)


def quaternions() -> st.SearchStrategy[list[float]]:
    """Unit quaternions, wxyz."""
    return vectors(4, 1.0).filter(lambda q: np.linalg.norm(q) > 0.1).map(lambda q: list(q / np.linalg.norm(q)))


def real(core: Any) -> np.dtype[Any]:
    """The number type of a core."""
    return np.dtype(np.float64 if core.real == "double" else np.float32)


def array(core: Any, values: Any) -> np.ndarray[Any, Any]:
    return np.ascontiguousarray(values, dtype=real(core)).reshape(-1)


def call(core: Any, name: str, *arguments: Any, out: int) -> np.ndarray[Any, Any]:
    """Call a function whose last parameter is an array for `out` results; sequences become arrays."""
    given = [array(core, one) if isinstance(one, list | tuple | np.ndarray) else one for one in arguments]
    result = np.full(out, np.nan, real(core))
    getattr(core, name)(*given, result)
    return result


def put(target: ctypes.Structure, source: Any) -> None:
    """Copy the attributes of a Python object to the members of the same name; a member without one is an error."""
    for name, kind in target._fields_:
        value, member = getattr(source, name), getattr(target, name)
        if isinstance(member, ctypes.Array):
            view(member)[...] = np.reshape(value, np.shape(member))
        elif isinstance(member, ctypes.Structure):
            put(member, value)
        else:
            setattr(target, name, kind(value).value)


def filled(kind: type[ctypes.Structure], source: Any) -> Any:
    """A new structure with the attributes of a Python object."""
    target = kind()
    put(target, source)
    return target


def octets(data: bytes) -> Any:
    """Bytes as the array of a C function; of an exact size, so that the sanitizers see what is read behind it."""
    return (ctypes.c_uint8 * len(data)).from_buffer_copy(data)


def octets_of(array: Any) -> bytes:
    """The bytes of an array of uint8."""
    return np.asarray(array, dtype=np.uint8).tobytes()


def same(ours: Any, theirs: Any, rtol: float = RTOL, scale: float = 0.0) -> None:
    """Ours (C) equals theirs (numpy) within rtol of the largest number, or of `scale` if that is larger."""
    theirs = np.asarray(theirs, dtype=float).reshape(-1)
    largest = max(scale, float(np.abs(theirs).max(initial=0.0)))
    np.testing.assert_allclose(np.asarray(ours, dtype=float).reshape(-1), theirs, rtol=0.0, atol=rtol * largest)


def configured(core: Any, record: BaseModel) -> Any:
    """A configuration record as the structure of the same name."""
    node = record_of(type(record))
    target = getattr(core, node.name)()
    _configure(node, target, record)
    return target


def _configure(node: Record, target: Any, record: Any) -> None:
    for field in node.fields:
        value, inner = field.get(record), field.node
        match inner:
            case Leaf():
                setattr(target, field.name, inner.choices.index(value) if inner.choices else value)
            case Record():
                _configure(inner, getattr(target, field.name), value)
            case Several():
                if inner.counted:
                    setattr(target, f"{field.name}_count", len(value))
                view(getattr(target, field.name))[: len(value)] = value
            case OneOf():
                union = getattr(target, field.name)
                union.kind = inner.kind.choices.index(value.kind)
                if (chosen := dict(inner.members)[value.kind]).fields:
                    _configure(chosen, getattr(union, value.kind), value)
