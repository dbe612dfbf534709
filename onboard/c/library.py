"""Builds the core as a shared library with the system's C compiler, at first use, and loads it.

The library is kept in a cache folder whose name is a digest of sources and options, so a change of any source builds
anew. Before it compiles, the build checks that generated files and configuration records agree (generate.py).
"""

import contextlib
import ctypes
import hashlib
import os
import shlex
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

from onboard.c.declarations import Declarations
from onboard.c.generate import FOLDER, check

COMPILERS: Final = ("cc", "gcc", "clang")
LANGUAGE: Final = ("-std=c99", "-pedantic", "-ffp-contract=off", "-fno-math-errno")
"""-ffp-contract=off: no fused multiply-add, so every machine rounds the same."""
WARNINGS: Final = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wvla")


class BuildError(Exception):
    """The core cannot be built. The message says what to do."""


class Variant(NamedTuple):
    """What is built."""

    real: str = "double"
    """double or float."""
    options: tuple[str, ...] = ("-O2",)

    @property
    def flags(self) -> list[str]:
        """Options of the compiler, but for warnings and output."""
        number = ["-DDMRAC_FLOAT"] if self.real == "float" else []
        return [*LANGUAGE, *number, *self.options, f"-I{FOLDER}"]


def compiler() -> list[str]:
    """The command of the C compiler: that of the environment's CC, else the first one found.

    Raises
    ------
    BuildError
        If there is none.
    """
    given = shlex.split(os.environ.get("CC", ""))
    for command in [given] if given else [[name] for name in COMPILERS]:
        if shutil.which(command[0]):
            return command
    tried = given[0] if given else ", ".join(COMPILERS)
    raise BuildError(
        f"no C compiler (tried {tried}): install one (on Debian and Ubuntu: apt install gcc libc6-dev) "
        "or name it in the environment variable CC"
    )


def sources() -> list[Path]:
    """All C files."""
    return sorted(FOLDER.rglob("*.c"))


def headers() -> list[Path]:
    """All headers."""
    return sorted(FOLDER.rglob("*.h"))


def compile_library(variant: Variant, out: Path) -> None:
    """Compile the core into the shared library `out`. Raises BuildError with the compiler's messages."""
    check()
    shared = ["-shared", "-fPIC", "-Wl,-Bsymbolic"]
    run([*compiler(), *variant.flags, *WARNINGS, *shared, *map(str, sources()), "-lm", "-o", str(out)])


def run(command: list[str]) -> str:
    """Run a command of the build; returns what it printed. Raises BuildError."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BuildError(f"{shlex.join(command)} failed:\n{done.stderr.strip()}")
    return done.stdout


def cached_library(variant: Variant) -> Path:
    """The library of a variant, compiled unless it is in the cache. Raises BuildError."""
    digest = hashlib.sha256(repr((variant, compiler())).encode())
    for path in (*sources(), *headers()):
        digest.update(str(path.relative_to(FOLDER)).encode() + path.read_bytes())
    library = cache_folder() / f"core-{digest.hexdigest()[:16]}.so"
    if not library.exists():
        part = library.with_suffix(f".{os.getpid()}")
        compile_library(variant, part)
        part.replace(library)  # at once: another process may be loading it
    return library


def cache_folder() -> Path:
    """A folder that this user alone writes to: beside the sources, or in the home directory. Raises BuildError."""
    for base in (FOLDER / "__pycache__", Path("~/.cache/async-dmrac").expanduser()):
        with contextlib.suppress(OSError):
            base.mkdir(parents=True, exist_ok=True)
            if os.access(base, os.W_OK):
                return base
    raise BuildError(f"no folder to keep the core in: neither {FOLDER} nor ~/.cache can be written")


def read_declarations(variant: Variant) -> Declarations:
    """What the headers declare, constants put in by the preprocessor."""
    includes = "".join(f'#include "{path.relative_to(FOLDER)}"\n' for path in headers())
    command = [*compiler(), *variant.flags, "-E", "-xc", "-"]
    done = subprocess.run(command, input=includes, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BuildError(f"{shlex.join(command)} failed:\n{done.stderr.strip()}")
    return Declarations(_own_lines(done.stdout))


def _own_lines(preprocessed: str) -> str:
    """The lines that come from the core's own headers. A line `# 12 "file"` says where the next ones come from."""
    kept, own = [], False
    for line in preprocessed.splitlines():
        if line.startswith("# "):
            own = line.split('"')[1].startswith(str(FOLDER))
        elif own:
            kept.append(line)
    return "\n".join(kept)


class Core(SimpleNamespace):
    """The loaded library: its functions, structures and constants by their C names, and `real`, numpy's type."""

    real: Any

    def __repr__(self) -> str:
        return f"Core({self.real})"  # not all that it declares: a failed test shows it


DEFAULT: Final = Variant()


@lru_cache(maxsize=8)
def load(variant: Variant = DEFAULT) -> Core:
    """The core, built if necessary. Raises BuildError."""
    return open_library(cached_library(variant), variant)


def open_library(path: Path, variant: Variant) -> Core:
    """A library that is built, with its declarations."""
    declared, library = read_declarations(variant), ctypes.CDLL(str(path))
    functions = {}
    for name, (result, arguments) in declared.functions.items():
        function = functions[name] = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return Core(real=variant.real, **declared.structures, **declared.constants, **functions)
