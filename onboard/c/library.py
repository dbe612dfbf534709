"""The core as a shared library: built at first use and kept, or taken from the wheel, and loaded.

A built library is kept in a cache folder, under a name that is a digest of sources, options and compiler, so a change
of any source builds anew. Before it compiles, the build checks that generated files and configuration records agree
(generate.py).
"""

import contextlib
import ctypes
import hashlib
import os
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

from onboard.c.compile import (
    DECLARED,
    DEFAULT,
    FOLDER,
    PREBUILT,
    BuildError,
    Variant,
    compile_core,
    compiler,
    prebuilt_name,
    preprocessed_headers,
    sources_digest,
)
from onboard.c.declarations import Declarations
from onboard.c.generate import check


class Built(NamedTuple):
    """A library that is there."""

    path: Path
    origin: str
    """wheel, cache, or built: now."""

    @property
    def declared(self) -> Path:
        """The file with the declarations."""
        return self.path.with_suffix(DECLARED)


def compile_library(variant: Variant, out: Path) -> None:
    """Check the generated files and compile the core into `out`. Raises BuildError or generate's TableError."""
    check()
    compile_core(variant, out)


def ready_library(variant: Variant) -> Built:
    """The library of a variant: of the wheel if its sources are these, else of the cache, else compiled now.

    Raises
    ------
    BuildError
        If it has to be compiled and cannot be.
    """
    prebuilt = Built(PREBUILT / f"{prebuilt_name(variant)}.so", "wheel")
    if variant.options == DEFAULT.options and prebuilt.path.exists() and prebuilt.declared.exists():
        return prebuilt
    digest = hashlib.sha256(repr((variant, compiler(), sources_digest())).encode()).hexdigest()[:16]
    built = Built(cache_folder() / f"core-{digest}.so", "cache")
    if built.path.exists() and built.declared.exists():
        return built
    _write_whole(built.declared, lambda part: part.write_text(preprocessed_headers(variant), encoding="utf-8"))
    _write_whole(built.path, lambda part: compile_library(variant, part))
    return built._replace(origin="built")


def _write_whole(path: Path, write: Any) -> None:
    """Write a file beside and rename it: another process may be reading it."""
    part = path.with_suffix(f"{path.suffix}.{os.getpid()}")
    write(part)
    part.replace(path)


def cached_library(variant: Variant) -> Path:
    """The library of a variant (`ready_library`). Raises BuildError."""
    return ready_library(variant).path


def cache_folder() -> Path:
    """A folder that this user alone writes to: beside the sources, or in the home directory. Raises BuildError."""
    for base in (FOLDER / "__pycache__", Path("~/.cache/async-dmrac").expanduser()):
        with contextlib.suppress(OSError):
            base.mkdir(parents=True, exist_ok=True)
            if os.access(base, os.W_OK):
                return base
    raise BuildError(f"no folder to keep the core in: neither {FOLDER} nor ~/.cache can be written")


class Core(SimpleNamespace):
    """The loaded library: its functions, structures and constants by their C names, and `real`, numpy's type."""

    real: Any

    def __repr__(self) -> str:
        return f"Core({self.real})"  # not all that it declares: a failed test shows it


@lru_cache(maxsize=8)
def load(variant: Variant = DEFAULT) -> Core:
    """The core, built if necessary. Raises BuildError."""
    built = ready_library(variant)
    declared = Declarations(built.declared.read_text(encoding="utf-8"))
    library = ctypes.CDLL(str(built.path))
    functions = {}
    for name, (result, arguments) in declared.functions.items():
        function = functions[name] = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return Core(real=variant.real, **declared.structures, **declared.constants, **functions)
