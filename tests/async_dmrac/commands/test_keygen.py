import hashlib
import io
from pathlib import Path

import pytest

from async_dmrac.command_line import main
from protocol.keys import read_key


def test_keygen_makes_a_key_once_and_never_prints_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "link.key"
    assert main(["keygen", str(path)]) == 0
    key = read_key(path)
    assert main(["keygen", str(path)]) == 2
    assert read_key(path) == key
    shown = "".join(capsys.readouterr())
    assert "exists already" in shown
    assert key.hex() not in shown


def test_a_passphrase_gives_the_same_key_as_in_ground_stations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ground.key"
    monkeypatch.setattr("sys.stdin", io.StringIO("correct horse\n"))
    assert main(["keygen", str(path), "--passphrase"]) == 0
    assert read_key(path) == hashlib.sha256(b"correct horse").digest()
    monkeypatch.setattr("sys.stdin", io.StringIO("short\n"))
    assert main(["keygen", str(tmp_path / "other.key"), "--passphrase"]) == 2
    shown = "".join(capsys.readouterr())
    assert "--passphrase: 5 characters, expected 8 or more" in shown
    assert "horse" not in shown
    assert not (tmp_path / "other.key").exists()
