"""Compiles the code of a step with numba where it is installed. Without numba, CPython runs the same source.

The compiled functions of this package use only scalars, tuples and numpy arrays, so that CPython can run them too.
`python_twin` gives the uncompiled form of a function and of all that it calls, as a reference for the compiled one.

Two settings make a step 2.4 times as fast, without a change of its arithmetic: a function becomes a part of its callers
(`forceinline`), and views of arrays are not counted, because the caller of a step owns all of its arrays (`_nrt`). So
compiled code of this package makes no arrays; that of a user's disturbance may.
"""

import contextlib
import hashlib
import os
import shutil
import types
from collections.abc import Callable
from inspect import getclosurevars
from pathlib import Path
from typing import Any, Final, TypeVar

try:
    import numba
except ImportError:  # the base install has no numba
    numba = None

COMPILED: Final[bool] = numba is not None
"""Whether this process runs compiled code."""

UNCOUNTED: Final[dict[str, Any]] = (
    {"_nrt": False} if COMPILED and hasattr(numba.core.options.DefaultOptions, "_nrt") else {}
)
"""Option without numba's counts of references, each of which costs a locked instruction; empty if numba has none."""

COMPILED_CODE: Final = b"sim_vehicle.physics.layout"
"""Text by which files with compiled code are recognised; those in disturbances/ all count."""

YOUNG_S: Final = 3600.0
"""s; younger caches of other sources are not removed."""

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


def _cache_directory() -> Path | None:
    """Where the machine code of this source is stored between runs; None if nothing can be written.

    Its name is a digest of the compiled source. Numba itself checks only the file of the function that it loads, so a
    change in the file of a called function would leave stale machine code in use. The cache contains pickles, so it is
    stored only where this user alone writes: beside the source, or in the home directory.
    """
    here = Path(__file__).resolve().parent
    files = [(path, path.read_bytes()) for path in sorted(here.parent.rglob("*.py"))]
    sources = [text for path, text in files if COMPILED_CODE in text or path.parent.name == "disturbances"]
    name = "numba-" + hashlib.sha256(b"".join(sources)).hexdigest()[:16]
    for base in (here / "__pycache__", Path("~/.cache/async-dmrac").expanduser()):
        try:
            (base / name).mkdir(parents=True, exist_ok=True)
        except (OSError, RuntimeError):
            continue
        if os.access(base / name, os.W_OK):
            _remove_old_caches(base, name)
            return base / name
    return None


def _remove_old_caches(base: Path, name: str) -> None:
    """Remove the caches of other sources, unless they are young: another process may still write to those."""
    newest = (base / name).stat().st_mtime
    for other in base.glob("numba-*"):
        with contextlib.suppress(OSError):
            if newest - other.stat().st_mtime > YOUNG_S:
                shutil.rmtree(other, ignore_errors=True)


_CACHE: Final = _cache_directory() if COMPILED else None


def compiled(function: FunctionT) -> FunctionT:
    """`function`, compiled at its first call where numba is installed, else as it is. It must not make arrays."""
    return _compile(function, cache=_CACHE is not None, forceinline=True, **UNCOUNTED)  # type: ignore[no-any-return]


def inlined(function: FunctionT) -> FunctionT:
    """`function`, compiled as a part of each of its callers, which saves the time of a call. May be a closure."""
    return _compile(function, inline="always")  # type: ignore[no-any-return]


def replaced(function: FunctionT, old: Any, new: Any) -> FunctionT:
    """A compiled copy of `function` in which it and all that it calls call `new` instead of `old`.

    It is `function` itself if nothing calls `old`. The machine code is not cached, because it depends on `new`, and
    an index out of range raises IndexError.
    """
    if function is old:
        return new  # type: ignore[no-any-return]
    called = {name: (value, replaced(value, old, new)) for name, value in _called(function).items()}
    changed = {name: after for name, (before, after) in called.items() if after is not before}
    if not changed:
        return function
    return _compile(_copy(function, changed), boundscheck=True)  # type: ignore[no-any-return]


def python_twin(function: FunctionT) -> FunctionT:
    """The pure Python form of a compiled function, whose calls go to pure Python forms as well."""
    names = {name: python_twin(value) for name, value in _called(function).items()}
    return _copy(function, names) if names or hasattr(function, "py_func") else function


def _compile(function: Any, **options: Any) -> Any:
    if not COMPILED or hasattr(function, "py_func"):
        return function
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = "" if _CACHE is None else str(_CACHE)
    try:
        return numba.njit(error_model="numpy", nogil=True, **options)(function)
    finally:
        numba.config.CACHE_DIR = before


def _called(function: Any) -> dict[str, Any]:
    """The functions that a function calls, by their names in it; none for one that is not written in Python."""
    source = getattr(function, "py_func", function)
    if not isinstance(source, types.FunctionType):
        return {}
    known = {**source.__globals__, **getclosurevars(source).nonlocals}
    values: dict[str, Any] = {
        name: known.get(name) for name in (*source.__code__.co_names, *source.__code__.co_freevars)
    }
    return {name: one for name, one in values.items() if isinstance(one, types.FunctionType) or hasattr(one, "py_func")}


def _copy(function: Any, names: dict[str, Any]) -> Any:
    """A Python function with other values for some of the names that it uses."""
    source = getattr(function, "py_func", function)
    cells = zip(source.__code__.co_freevars, source.__closure__ or (), strict=True)
    closure = tuple(types.CellType(names.get(name, cell.cell_contents)) for name, cell in cells)
    return types.FunctionType(
        source.__code__, source.__globals__ | names, source.__name__, source.__defaults__, closure
    )
