"""The cache of the machine code, and the uncompiled twins."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import sim_vehicle
from sim_vehicle.physics.compiled import COMPILED, python_twin
from sim_vehicle.physics.dynamics import cross, rotation, to_body

CHECK = "from sim_vehicle.physics.motors import lag_motors as f; print(f._cache._cache_path, f.stats.cache_path)"


def cache_path(root: Path, home: Path) -> str:
    """Where a copy of the package stores its cache."""
    result = subprocess.run(
        [sys.executable, "-c", CHECK],
        capture_output=True,
        text=True,
        check=True,
        cwd=root,
        env={"PYTHONPATH": str(root), "HOME": str(home), "PYTHONDONTWRITEBYTECODE": "1", "PATH": os.environ["PATH"]},
        timeout=60,
    )
    return result.stdout.split()[0]


@pytest.mark.full
def test_the_cache_follows_the_source(tmp_path):
    """A change in a compiled file leads to another cache; a change in another file does not."""
    assert COMPILED
    package = Path(sim_vehicle.__file__).parent
    for name in ("sim_vehicle", "configs", "flight_log", "protocol"):
        shutil.copytree(package.parent / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    first = cache_path(tmp_path, tmp_path)
    assert Path(first).is_relative_to(tmp_path / "sim_vehicle")
    with (tmp_path / "sim_vehicle" / "link" / "radio.py").open("a") as file:
        file.write("\n# a comment\n")
    assert cache_path(tmp_path, tmp_path) == first
    with (tmp_path / "sim_vehicle" / "physics" / "dynamics.py").open("a") as file:
        file.write("\n# a comment\n")
    assert cache_path(tmp_path, tmp_path) != first


def test_twins_call_only_python():
    twin = python_twin(to_body)
    assert not hasattr(twin, "py_func")
    R = rotation(0.9, 0.1, -0.2, 0.3)
    assert twin(R, 1.0, 2.0, 3.0) == pytest.approx(to_body(R, 1.0, 2.0, 3.0), rel=1e-14)
    assert python_twin(cross)((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)) == (0.0, 0.0, 1.0)
    assert python_twin(len) is len
