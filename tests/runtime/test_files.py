import os
import subprocess
import sys
from pathlib import Path

import pytest

from runtime.files import no_space, write_atomically, write_last


def synced(monkeypatch: pytest.MonkeyPatch, path: Path) -> list[tuple[str, bool]]:
    """What is brought to the disk: the name, and whether the new content has its name by then."""
    found: list[tuple[str, bool]] = []
    real = os.fsync

    def fsync(descriptor: int) -> None:
        name = os.readlink(f"/proc/self/fd/{descriptor}")
        found.append((name, path.exists() and path.read_bytes() == b"new"))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    return found


def test_content_then_name_reach_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    found = synced(monkeypatch, path)
    write_atomically(path, b"new")
    assert found == [(str(path) + ".part", False), (str(tmp_path), True)]
    assert [one.name for one in tmp_path.iterdir()] == ["file"]


FULL_DISK = """
import resource, sys
from pathlib import Path
from runtime.files import no_space, write_atomically
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
try:
    write_atomically(Path(sys.argv[1]), bytes(1000))
except OSError as error:
    print(no_space(error), error.filename)
"""


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    script = [sys.executable, "-c", FULL_DISK, str(path)]
    result = subprocess.run(script, capture_output=True, text=True, check=True)
    assert result.stdout == f"True {path}\n"
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [("file", b"old")]


def test_a_summary_that_cannot_be_written_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "no folder" / "summary.json"
    assert not write_last(path, {})
    assert capsys.readouterr().err == f"{path}: cannot be written: No such file or directory\n"
    assert write_last(tmp_path / "summary.json", {"a": 1})


def test_only_a_full_disk_is_one(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        (tmp_path / "nothing").read_bytes()
    assert not no_space(caught.value)
