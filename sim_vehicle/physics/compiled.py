"""Compilation of the per-step code: numba where it is installed, the very same Python source where it is not.

The compiled functions of this package use only scalars, tuples and flat numpy arrays, so that CPython can run them
too. `python_twin` gives that uncompiled twin, all the way down, as the reference which the compiled code must equal.
"""

import contextlib
import hashlib
import os
import shutil
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

COMPILED_CODE: Final = b"sim_vehicle.physics.layout"
"""Mark of the files that hold compiled code, and of what they share."""

YOUNG_S: Final = 3600.0
"""s; younger caches of other sources are left alone."""

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


def _cache_directory() -> Path | None:
    """Where this source's machine code is kept between runs; None where nothing can be written.

    It is named by a digest of the compiled source. Numba itself looks only at the file of the function that it loads,
    so that a change in a called file would leave stale machine code in use. The cache holds pickles, so it lies only
    where this user alone writes: beside the source, or in the home directory.
    """
    here = Path(__file__).resolve().parent
    sources = [path.read_bytes() for path in sorted(here.parent.rglob("*.py"))]
    name = "numba-" + hashlib.sha256(b"".join(text for text in sources if COMPILED_CODE in text)).hexdigest()[:16]
    for base in (here / "__pycache__", Path("~/.cache/async-dmrac").expanduser()):
        try:
            (base / name).mkdir(parents=True, exist_ok=True)
        except (OSError, RuntimeError):
            continue
        if os.access(base / name, os.W_OK):
            _forget_old_caches(base, name)
            return base / name
    return None


def _forget_old_caches(base: Path, name: str) -> None:
    """Remove other sources' caches unless they are young, when another process may still be writing there."""
    newest = (base / name).stat().st_mtime
    for other in base.glob("numba-*"):
        with contextlib.suppress(OSError):
            if newest - other.stat().st_mtime > YOUNG_S:
                shutil.rmtree(other, ignore_errors=True)


_CACHE: Final = _cache_directory() if COMPILED else None


def compiled(function: FunctionT) -> FunctionT:
    """`function`, compiled at its first call when numba is installed, else as it is."""
    if not COMPILED:
        return function
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = "" if _CACHE is None else str(_CACHE)
    try:
        return numba.njit(cache=_CACHE is not None, error_model="numpy")(function)  # type: ignore[no-any-return]
    finally:
        numba.config.CACHE_DIR = before


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
