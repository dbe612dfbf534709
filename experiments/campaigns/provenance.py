"""Describes where flights were flown: commit, machine, versions.

The machine includes the kernels that OpenBLAS chooses for its processor: with other kernels the last digits differ.
"""

import platform
import re
import subprocess
import sys
from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

import numpy  # noqa: F401  loads its BLAS; scipy may have another one
import scipy.linalg  # noqa: F401
from threadpoolctl import threadpool_info

from runtime.kernel import cores

PACKAGES: Final = (
    *("async-dmrac", "numpy", "scipy", "numba", "mujoco-core", "rotorpy", "torch"),
    *("pyarrow", "scikit-learn", "matplotlib"),
)
_COMMIT: Final = "; commit "
_KERNELS: Final = "OpenBLAS kernels "


def openblas_kernels() -> str:
    """Return the processor type of the OpenBLAS kernels in use, such as "SkylakeX"; "" with another BLAS.

    OpenBLAS chooses them by the processor when it is loaded; a release may not know a newer processor. The variable
    OPENBLAS_CORETYPE overrules the choice. If those of numpy and scipy differ, both are named, with a slash.
    """
    found = (str(library["architecture"]) for library in threadpool_info() if library["internal_api"] == "openblas")
    return "/".join(sorted(set(found)))


def machine() -> str:
    """Return processor, cores, system and OpenBLAS kernels."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        found = re.search(r"model name\s*:\s*(.+)", info.read_text(encoding="utf-8", errors="replace"))
        model = found.group(1).strip() if found else model
    kernels = openblas_kernels()
    used = f", {_KERNELS}{kernels}" if kernels else ""
    return f"{model}, {cores()} cores in use, {platform.system()} {platform.release()}{used}"


def kernels_of(line: str) -> str:
    """Return the OpenBLAS kernels that a line of `here` names; "" for none."""
    found = re.search(rf", {re.escape(_KERNELS)}([\w/]+)", line)
    return found.group(1) if found else ""


def other_kernels(flown_on: Iterable[str], here: str) -> str:
    """Return advice for flights that differ; "" if no flight is known to be flown with other kernels than `here`.

    Parameters
    ----------
    flown_on: lines of `here` from the machines that flew.
    """
    others = sorted({kernels_of(line) for line in flown_on} - {here, ""})
    if not others:
        return ""
    now = f"those for {here}" if here else "none"
    return (
        f"flown with OpenBLAS's kernels for {' or '.join(others)}, here with {now}; "
        f"OPENBLAS_CORETYPE={others[0].partition('/')[0]} selects the former, if this processor has their instructions"
    )


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that flights depend on."""
    found = {"python": sys.version.split()[0]}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def commit() -> str:
    """Return the commit of the sources, with `-dirty` if they have changed since; "" outside a git checkout."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return answer.stdout.strip() if answer.returncode == 0 else ""


def _line(place: str, commits: Sequence[str]) -> str:
    return place + (_COMMIT + ", ".join(commits) if commits else "")


def by_place(lines: Iterable[str]) -> tuple[str, ...]:
    """Merge lines of `here` that differ only in the commit."""
    places: dict[str, list[str]] = {}
    for line in lines:
        place, _, sources = line.partition(_COMMIT)
        places.setdefault(place, []).extend([sources] if sources else [])
    return tuple(_line(place, commits) for place, commits in places.items())


def commits_of(lines: Iterable[str]) -> tuple[str, ...]:
    """Return the commits that lines of `here` or `by_place` name, each once."""
    found = (source for line in lines for source in line.partition(_COMMIT)[2].split(", "))
    return tuple(dict.fromkeys(filter(None, found)))


def here() -> str:
    """Return one line that describes this machine, its versions and the commit."""
    packages = ", ".join(f"{name} {number}" for name, number in versions().items())
    sources = commit()
    return _line(f"{machine()}; {packages}", [sources] if sources else [])
