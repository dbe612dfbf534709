"""Compiles the core: which compiler, with which options, from which files. Standard library only.

The build of a wheel (hatch_build.py) uses it too, before anything is installed.
"""

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final, NamedTuple

FOLDER: Final = Path(__file__).resolve().parent
"""The root of the C sources."""
PREBUILT: Final = FOLDER / "prebuilt"
"""In an installed wheel: the libraries that were built with it, and what their headers declare."""
DECLARED: Final = ".declared"
"""Ending of the file beside a library that holds what its headers declare, for ctypes. (Not .h: it is no source.)"""
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


DEFAULT: Final = Variant()


def compiler() -> list[str]:
    """The command of the C compiler: that of the environment's CC, else the first one found, else that of ziglang.

    Raises
    ------
    BuildError
        If there is none.
    """
    given = shlex.split(os.environ.get("CC", ""))
    for command in [given] if given else [[name] for name in COMPILERS]:
        if shutil.which(command[0]):
            return command
    if given:
        raise BuildError(f"the environment variable CC names {given[0]}, which is not there: correct it or remove it")
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"]  # not of this processor alone
    raise BuildError(
        f"no C compiler (tried {', '.join(COMPILERS)} and the package ziglang): install one (on Debian and Ubuntu: "
        "apt install gcc libc6-dev; or pip install ziglang), or name it in the environment variable CC"
    )


def sources() -> list[Path]:
    """All C files."""
    return sorted(FOLDER.rglob("*.c"))


def headers() -> list[Path]:
    """All headers."""
    return sorted(FOLDER.rglob("*.h"))


def sources_digest() -> str:
    """Of all C files and headers: another one for any change."""
    digest = hashlib.sha256()
    for path in (*sources(), *headers()):
        digest.update(str(path.relative_to(FOLDER)).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def prebuilt_name(variant: Variant) -> str:
    """Name, without ending, of a library in a wheel; it differs with the sources and with the kind of machine."""
    return f"core-{variant.real}-{platform.system()}-{platform.machine()}-{sources_digest()}"


def compile_core(variant: Variant, out: Path) -> None:
    """Compile the core into the shared library `out`. Raises BuildError with the compiler's messages."""
    shared = ["-shared", "-fPIC", "-Wl,-Bsymbolic"]
    run([*compiler(), *variant.flags, *WARNINGS, *shared, *map(str, sources()), "-lm", "-o", str(out)])


def preprocessed_headers(variant: Variant) -> str:
    """What the core's own headers declare, constants put in, without inline functions. Raises BuildError."""
    includes = "".join(f'#include "{path.relative_to(FOLDER).as_posix()}"\n' for path in headers())
    return _own_lines(run([*compiler(), *variant.flags, "-DDMRAC_DECLARATIONS", "-E", "-xc", "-"], includes))


def run(command: list[str], given: str | None = None) -> str:
    """Run a command of the build, `given` as its input; returns what it printed. Raises BuildError."""
    done = subprocess.run(command, input=given, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BuildError(f"{shlex.join(command)} failed:\n{done.stderr.strip()}")
    return done.stdout


def _own_lines(preprocessed: str) -> str:
    """The lines that come from the core's own headers. A line `# 12 "file"` says where the next ones come from."""
    kept, own = [], False
    for line in preprocessed.splitlines():
        if line.startswith("# "):
            own = line.split('"')[1].startswith(str(FOLDER))
        elif own and line.strip():
            kept.append(line)
    return "\n".join(kept)
