"""The first import and the version: `dmrac`, `python -m async_dmrac`, and packages of others with our names."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from async_dmrac.command_line import main
from async_dmrac.shadowing import PACKAGES

ROOT = Path(__file__).resolve().parents[2]
VERSION = f"dmrac {version('async-dmrac')}\n"


def python(*words: str, path: Path = ROOT) -> "subprocess.CompletedProcess[str]":
    """Run Python with `path` before our own sources."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(path), str(ROOT)))}
    return subprocess.run(
        [sys.executable, *words], env=environment, cwd=path, capture_output=True, text=True, timeout=60, check=False
    )


def test_the_command_prints_its_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == VERSION


def test_the_module_prints_its_version(tmp_path: Path) -> None:
    result = python("-m", "async_dmrac", "--version", path=tmp_path)
    assert (result.returncode, result.stdout, result.stderr) == (0, VERSION, "")


def install(folder: Path, package: str, distribution: str) -> None:
    """Put a package into a folder, with the metadata of its distribution if it has a name."""
    (folder / package).mkdir()
    (folder / package / "__init__.py").write_text("")
    if distribution:
        about = folder / f"{distribution}-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
        (about / "RECORD").write_text(f"{package}/__init__.py,,\n{about.name}/METADATA,,\n")


@pytest.mark.parametrize("package", ["configs", "protocol", "experiments"])
def test_a_foreign_package_with_our_name_is_refused_at_the_first_import(package: str, tmp_path: Path) -> None:
    install(tmp_path, package, "somebodys_tool")
    result = python("-c", "import async_dmrac", path=tmp_path)
    assert result.returncode == 1
    last = result.stderr.strip().splitlines()[-1]
    assert last.startswith(f"ImportError: async-dmrac needs its own package {package!r}, but ")
    assert str(tmp_path / package) in last
    assert "distribution somebodys_tool" in last


def test_a_foreign_package_without_a_distribution_is_refused_too(tmp_path: Path) -> None:
    install(tmp_path, "runtime", "")
    result = python("-m", "async_dmrac", "--version", path=tmp_path)
    assert result.returncode == 1
    assert "of no installed distribution" in result.stderr


def test_every_package_has_the_mark_that_the_check_looks_for() -> None:
    assert all((ROOT / package / mark).exists() for package, mark in PACKAGES.items())
    installed = {path.parent.name for path in ROOT.glob("*/__init__.py")} - {"async_dmrac", "tests"}
    assert set(PACKAGES) == installed
