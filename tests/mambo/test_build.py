"""The library for the drone: its symbols, its size, its memory, and that it is soft float for armv5te."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from mambo.build import GLIBC_MAX, RAM_MAX_BYTES, SIZE_MAX_BYTES, Built

ENTRY_POINTS = {"RSEDU_control", "RSEDU_optical_flow", "RSEDU_image_processing"}
OWN = {"dmrac_clock_ns", "dmrac_wall_clock_ns", "dmrac_view", "dmrac_take_event", "dmrac_fault"}


def binutil(name: str, *arguments: str) -> str:
    tool = f"arm-linux-gnueabi-{name}"
    if shutil.which(tool) is None:
        pytest.skip(f"no {tool}: install it (Debian and Ubuntu: apt install binutils-arm-linux-gnueabi)")
    return subprocess.run([tool, *arguments], capture_output=True, text=True, check=True).stdout


def needed_versions(library: Path) -> dict[str, tuple[int, ...]]:
    """The version of glibc that each symbol needs."""
    found = re.findall(r"\s(\w+)@GLIBC_([\d.]+)", binutil("nm", "-D", str(library)))
    return {symbol: tuple(map(int, version.split("."))) for symbol, version in found}


def test_no_symbol_is_newer_than_the_drones_c_library(arm: Built) -> None:
    versions = needed_versions(arm.library)
    assert "memcpy" in versions  # the reader understands the listing
    assert {symbol: version for symbol, version in versions.items() if version > GLIBC_MAX} == {}


def test_every_symbol_that_it_needs_is_the_c_librarys(arm: Built) -> None:
    needed = binutil("nm", "-D", "--undefined-only", str(arm.library)).splitlines()
    assert [line for line in needed if " U " in line and "@GLIBC_" not in line] == []


def test_a_newer_symbol_would_be_found(arm: Built, tmp_path: Path) -> None:
    source = tmp_path / "newer.c"
    source.write_text("#include <pthread.h>\nint f(void) { pthread_t t; return pthread_create(&t, 0, 0, 0); }\n")
    if len(arm.target.compiler) > 1:
        pytest.skip("ziglang is told which symbols to use")
    library = tmp_path / "newer.so"
    subprocess.run([*arm.target.compiler, "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    assert needed_versions(library)["pthread_create"] > GLIBC_MAX


def test_it_exports_the_entry_points_and_nothing_of_the_core(arm: Built) -> None:
    exported = set(re.findall(r" T (\w+)$", binutil("nm", "-D", str(arm.library)), re.MULTILINE))
    assert exported == ENTRY_POINTS | OWN


def test_size_and_memory(arm: Built) -> None:
    assert arm.library.stat().st_size <= SIZE_MAX_BYTES
    text, data, bss = map(int, binutil("size", str(arm.library)).splitlines()[1].split()[:3])
    assert text + data + bss <= RAM_MAX_BYTES


def test_it_is_for_armv5te_without_floating_point_unit(arm: Built) -> None:
    attributes = binutil("readelf", "-A", str(arm.library))
    assert "Tag_CPU_arch: v5TE" in attributes
    assert "Tag_FP_arch" not in attributes
    assert "Tag_ABI_VFP_args" not in attributes
    assert "soft-float ABI" in binutil("readelf", "-h", str(arm.library))
