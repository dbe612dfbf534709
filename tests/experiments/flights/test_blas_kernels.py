"""A flight of the C core without a trainer is the same to the bit with any BLAS: shown with two kernels of OpenBLAS."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from onboard.c.compile import BuildError, compiler

KERNELS = ("Haswell", "Nehalem")
"""With and without AVX2 and fused multiply-add."""
FLY = """
import hashlib, sys
import numpy as np
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import Choices, resolve
from threadpoolctl import threadpool_info
brief = ("onboard.guidance.trajectory.settle_s=0.0", "offboard.experience.mode=frozen")
outcome = fly_lockstep(resolve("figure8_wind", Choices(sys.argv[1], 3, 7.0, brief)), core="c")
names = {one["architecture"] for one in threadpool_info() if one["internal_api"] == "openblas"}
matrix = np.random.default_rng(1).normal(size=(200, 200))
print(*sorted(names), hashlib.sha256(matrix @ matrix.T @ matrix).hexdigest(), outcome.trace_sha256)
"""


def flown(kernels: str, controller: str) -> tuple[str, str]:
    """Hashes of a matrix product and of a flight, in a process whose BLAS must be the one that was asked for."""
    environment = {**os.environ, "OPENBLAS_CORETYPE": kernels}
    root = Path(__file__).resolve().parents[3]
    command = [sys.executable, "-c", FLY, controller]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    *names, product, trace = done.stdout.split()
    if names != [kernels]:
        pytest.skip(f"numpy's BLAS takes {names}, not {kernels}")
    return product, trace


@pytest.fixture(scope="module", autouse=True)
def _two_kernels_are_possible() -> None:
    try:
        compiler()
    except BuildError as error:
        pytest.skip(str(error))
    cpu = Path("/proc/cpuinfo")
    if not cpu.exists() or "avx2" not in cpu.read_text(encoding="utf-8"):
        pytest.skip("needs a processor with AVX2, to choose between two kernels")


@pytest.mark.parametrize("controller", ["mrac", pytest.param("dmrac", marks=pytest.mark.full)])
def test_the_kernels_of_blas_do_not_change_a_flight_of_the_c_core(controller: str) -> None:
    (product, one), (other_product, other) = (flown(kernels, controller) for kernels in KERNELS)
    assert product != other_product, "the two kernels round alike here, so that this test shows nothing"
    assert one == other
