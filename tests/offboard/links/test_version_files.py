from pathlib import Path

import pytest

from offboard.links import version_files
from offboard.links.version_files import VersionFiles


def test_the_newest_files_are_kept(tmp_path: Path) -> None:
    (tmp_path / "features_1.npz").write_bytes(b"of an earlier run")
    files = VersionFiles(tmp_path, 3)
    for version in range(5, 12):
        files.put(version, bytes([version]))
        files.write_waiting()
    assert {one.name for one in tmp_path.iterdir()} == {f"features_{number}.npz" for number in (1, 9, 10, 11)}
    assert (tmp_path / "features_11.npz").read_bytes() == bytes([11])


def test_what_the_background_did_not_write_is_written_at_the_end(tmp_path: Path) -> None:
    files = VersionFiles(tmp_path, 20)
    for version in (1, 2):
        files.put(version, b"content")
    files.write_waiting()
    files.write_waiting()
    assert sorted(one.name for one in tmp_path.iterdir()) == ["features_1.npz", "features_2.npz"]


def test_a_full_disk_raises_and_the_next_version_is_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = VersionFiles(tmp_path, 20)

    def full(path: Path, content: bytes) -> None:
        raise OSError(28, "No space left on device", str(path))

    files.put(1, b"content")
    with monkeypatch.context() as patch:
        patch.setattr(version_files, "write_atomically", full)
        with pytest.raises(OSError, match="No space left"):
            files.write_waiting()
    files.put(2, b"content")
    files.write_waiting()
    assert [one.name for one in tmp_path.iterdir()] == ["features_2.npz"]
