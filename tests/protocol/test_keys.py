import os
from pathlib import Path

import pytest

from protocol.keys import KeyFileError, load_key, read_key, write_key


def test_a_new_key_is_readable_only_by_its_owner(tmp_path: Path) -> None:
    path, other = tmp_path / "link.key", tmp_path / "other.key"
    before = os.umask(0)
    try:
        write_key(path)
        write_key(other)
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o600
    assert len(read_key(path)) == 32
    assert read_key(path) != read_key(other)
    assert load_key(str(path)) == read_key(path)
    assert load_key(None) is None


def test_a_key_is_never_replaced(tmp_path: Path) -> None:
    path = tmp_path / "link.key"
    write_key(path)
    key = read_key(path)
    with pytest.raises(KeyFileError, match="exists already"):
        write_key(path)
    assert read_key(path) == key


@pytest.mark.parametrize("mode", [0o644, 0o604, 0o640, 0o620, 0o601])
def test_a_key_accessible_to_others_is_refused(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "link.key"
    write_key(path)
    path.chmod(mode)
    with pytest.raises(KeyFileError, match="chmod 600"):
        read_key(path)


@pytest.mark.parametrize("text", ["", "abcd", "secret" * 20, "0" * 63, "0" * 65, "g" * 64, "0" * 10_000])
def test_an_invalid_key_is_refused_and_not_printed(tmp_path: Path, text: str) -> None:
    path = tmp_path / "link.key"
    path.touch(mode=0o600)
    path.write_text(text)
    with pytest.raises(KeyFileError, match="64 hexadecimal") as caught:
        read_key(path)
    assert not text or text not in str(caught.value)


def test_files_that_cannot_be_read_or_written_raise(tmp_path: Path) -> None:
    with pytest.raises(KeyFileError, match=r"none\.key: cannot be read"):
        read_key(tmp_path / "none.key")
    with pytest.raises(KeyFileError, match="directory"):
        read_key(tmp_path)
    with pytest.raises(KeyFileError, match="cannot be written"):
        write_key(tmp_path / "no" / "such.key")
    fifo = tmp_path / "fifo.key"
    os.mkfifo(fifo, 0o600)
    with pytest.raises(KeyFileError, match="not a file"):
        read_key(fifo)
