from pathlib import Path

import pytest

from experiments.command_line import main
from protocol.keys import read_key


def test_keygen_makes_a_key_once_and_shows_it_never(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "link.key"
    assert main(["keygen", str(path)]) == 0
    key = read_key(path)
    assert main(["keygen", str(path)]) == 2
    assert read_key(path) == key
    shown = "".join(capsys.readouterr())
    assert "exists already" in shown
    assert key.hex() not in shown
