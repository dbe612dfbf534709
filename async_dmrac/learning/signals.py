"""Reads a user's samples: named signals and labels, as a mapping or as an array, of any length."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from protocol.conventions import Array


def matrix(given: Any, names: Sequence[str], what: str) -> Array:
    """The named columns side by side, [n, len(names)].

    Parameters
    ----------
    given: name -> [n] or a number (a mapping, a DataFrame, a Table), or an array [n, len(names)] or [len(names)].
    what: the argument's name, for messages.

    Raises
    ------
    ValueError
        If a column is missing, or lengths or the number of columns do not fit.
    """
    if isinstance(given, Mapping) or hasattr(given, "columns"):
        missing = [name for name in names if name not in given]
        if missing:
            known = list(given.columns) if hasattr(given, "columns") else list(given)
            raise ValueError(f"{what}: no column {missing[0]!r}; given are {', '.join(map(str, known))}")
        columns = [np.atleast_1d(np.asarray(given[name], dtype=np.float64)) for name in names]
        lengths = {name: column.shape for name, column in zip(names, columns, strict=True)}
        if len(set(lengths.values())) != 1 or columns[0].ndim != 1:
            raise ValueError(f"{what}: columns of different shapes: {lengths}")
        return np.column_stack(columns)
    array = np.asarray(given, dtype=np.float64)
    rows = array[None] if array.ndim == 1 else array
    if rows.ndim != 2 or rows.shape[1] != len(names):
        raise ValueError(f"{what}: shape {array.shape}, expected (n, {len(names)}): {', '.join(names)}")
    return rows


def vector(given: Any, names: Sequence[str], what: str) -> Array:
    """One row of `matrix`, [len(names)]. Raises ValueError as it does, and for other than one row of finite values."""
    rows = matrix(given, names, what)
    if rows.shape[0] != 1:
        raise ValueError(f"{what}: {rows.shape[0]} rows, expected one")
    if not np.isfinite(rows).all():
        raise ValueError(f"{what}: a value is not finite: {dict(zip(names, rows[0].tolist(), strict=True))}")
    row: Array = rows[0]
    return row
