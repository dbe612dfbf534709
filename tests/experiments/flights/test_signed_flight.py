"""Keys are read from files only: a signed flight flies, is checked bit for bit, and its record contains no key."""

import json
from pathlib import Path

import pytest

from async_dmrac.command_line import main
from configs.addresses import LINK_KEYS
from flight_log.reader import open_flight
from protocol.keys import read_key

KEYS = tuple(key.setting for key in LINK_KEYS.values())


@pytest.fixture
def keys(tmp_path: Path) -> dict[str, Path]:
    paths = {name: tmp_path / f"{name}.key" for name in KEYS}
    for path in paths.values():
        assert main(["keygen", str(path)]) == 0
    return paths


def test_a_flight_with_all_links_keyed_leaves_no_key_in_its_record(
    keys: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "flight"
    words = ["fly", "hover", "--controller", "pid", "--lockstep", "--duration", "8"]
    for name, path in keys.items():
        words += ["--set", f"network.{name}={path}"]
    assert main([*words, "--out", str(folder)]) == 0
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["link"]["down"]["sent"] > 700, "the signed poses are relayed"
    assert main(["replay", str(folder), "--check"]) == 0
    assert "equal bit for bit" in capsys.readouterr().out
    left = [path.read_bytes() for path in folder.iterdir() if path.is_file()]
    for attachments in open_flight(folder).attachments.values():
        left += attachments.values()
    for path in keys.values():
        key = read_key(path)
        for form in (key, key.hex().encode(), key.hex().upper().encode()):
            assert not any(form in content for content in left), path.name
        assert any(str(path).encode() in content for content in left), "the file's name may be known"


@pytest.mark.parametrize("name", KEYS)
def test_a_key_that_others_may_read_or_that_is_not_there_stops_the_flight_before_it_starts(
    keys: dict[str, Path], name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys[name].chmod(0o644)
    words = ["fly", "hover", "--lockstep", "--out", str(tmp_path / "flight"), "--set"]
    assert main([*words, f"network.{name}={keys[name]}"]) == 2
    assert "chmod 600" in capsys.readouterr().err
    assert main([*words, f"network.{name}={tmp_path / 'none.key'}"]) == 2
    assert "none.key: cannot be read" in capsys.readouterr().err
    assert not (tmp_path / "flight").exists()


def test_a_key_in_the_configuration_itself_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fly", "hover", "--set", f"onboard.vehicle_link.signing_key={'ab' * 32}"]) == 2
    output = capsys.readouterr().err
    assert "vehicle_link.signing_key: unknown key" in output
