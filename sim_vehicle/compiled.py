"""Compilation of the per-step code: numba where it is installed, the very same Python source where it is not.

The compiled functions of this package use only scalars, tuples and flat numpy arrays, so that CPython can run them
too. `python_twin` gives that uncompiled twin, all the way down, as the reference which the compiled code must equal.
"""

import hashlib
import os
import shutil
import tempfile
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

try:
    import numba
except ImportError:  # the base install has no numba
    numba = None

COMPILED: Final[bool] = numba is not None
"""Whether this process runs compiled code."""

COMPILED_CODE: Final = b"sim_vehicle.layout"
"""Mark of the files that hold compiled code, and of what they share."""

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


def _use_cache_of_this_source() -> None:
    """Keep numba's cache under a digest of this package's compiled source.

    Numba looks only at the file of the function that it loads, so that a change in a called file would otherwise
    leave stale machine code in use.
    """
    here = Path(__file__).resolve().parent
    sources = [path.read_bytes() for path in sorted(here.glob("*.py"))]
    digest = hashlib.sha256(b"".join(text for text in sources if COMPILED_CODE in text)).hexdigest()[:16]
    base = here / "__pycache__"
    if not os.access(base if base.exists() else here, os.W_OK):
        base = Path(tempfile.gettempdir()) / f"async-dmrac-{os.getuid()}"
    directory = base / f"numba-{digest}"
    if not directory.exists():
        for stale in base.glob("numba-*"):
            shutil.rmtree(stale, ignore_errors=True)
        directory.mkdir(parents=True, exist_ok=True)
    numba.config.CACHE_DIR = str(directory)


if COMPILED:
    _use_cache_of_this_source()


def compiled(function: FunctionT) -> FunctionT:
    """`function`, compiled at its first call when numba is installed, else as it is."""
    if not COMPILED:
        return function
    return numba.njit(cache=True, error_model="numpy")(function)  # type: ignore[no-any-return]


def python_twin(function: FunctionT) -> FunctionT:
    """The pure Python form of a compiled function, whose calls go to pure Python forms as well."""
    return _twin(function, {})  # type: ignore[no-any-return]


def _twin(function: Any, known: dict[int, Any]) -> Any:
    source = getattr(function, "py_func", None)
    if source is None:
        return function
    if id(source) not in known:
        names: dict[str, Any] = {}
        twin = types.FunctionType(source.__code__, names, source.__name__, source.__defaults__)
        known[id(source)] = twin
        names.update({name: _twin(value, known) for name, value in source.__globals__.items()})
    return known[id(source)]
