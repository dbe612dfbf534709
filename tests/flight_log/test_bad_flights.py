"""Input that is not a flight: every command names it in one line, with exit status 2."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.writer import Writer

from async_dmrac.command_line import main
from flight_log.mcap_file import METADATA_NAME, McapFile
from flight_log.reader import FlightError, open_flight
from flight_log.writer import FlightLogWriter


def missing(folder: Path) -> None:
    folder.rmdir()


def empty(folder: Path) -> None:
    pass


def without_records(folder: Path) -> None:
    FlightLogWriter(folder / "onboard.mcap", "onboard").close()


def nothing_written(folder: Path) -> None:
    (folder / "onboard.mcap").write_bytes(b"")


def cut_to_nothing(folder: Path) -> None:
    (folder / "onboard.mcap").write_bytes(b"\x89MCAP0\r\n\x01")


def no_log(folder: Path) -> None:
    (folder / "onboard.mcap").write_bytes(b"PK\x03\x04 something else")


def foreign(folder: Path) -> None:
    with (folder / "onboard.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(library="somebody else")
        writer.finish()


def newer(folder: Path) -> None:
    file = McapFile(folder / "onboard.mcap")
    file.start()
    file.add_metadata(METADATA_NAME, {"format_version": "99"})
    file.close()


FOLDERS = {
    missing: "no such flight",
    empty: "contains no flight log (*.mcap)",
    without_records: "the flight log contains no records",
    nothing_written: "the flight log contains no records",
    cut_to_nothing: "the flight log contains no records",
    no_log: "not an MCAP file",
    foreign: "an MCAP file, but not a flight log of this project",
    newer: "written in format 99, this version reads up to 2",
}
COMMANDS = (
    *("log info", "log check", "log merge", "log export --csv --npz --ulog", "report"),
    *("compare --out c.html FLIGHT", "view --web --no-open", "view --save f.rrd", "replay", "replay --check"),
)


each_folder = pytest.mark.parametrize(
    ("make", "message"), FOLDERS.items(), ids=lambda value: getattr(value, "__name__", "")
)


@each_folder
def test_a_folder_that_is_not_a_flight_raises_with_one_line(
    make: Callable[[Path], None], message: str, tmp_path: Path
) -> None:
    folder = tmp_path / "flight"
    folder.mkdir()
    make(folder)
    with pytest.raises(FlightError, match=re.escape(message)) as caught:
        open_flight(folder)
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("command", COMMANDS)
@each_folder
def test_input_that_is_not_a_flight_gives_one_line_and_status_2(
    command: str,
    make: Callable[[Path], None],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "flight"
    folder.mkdir()
    make(folder)
    before = sorted(tmp_path.rglob("*"))
    assert main([*command.replace("FLIGHT", str(folder)).split(), str(folder)]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith(f"dmrac {command.split()[0]}: {folder}")
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
    assert sorted(tmp_path.rglob("*")) == before, "nothing was written"


def test_check_reports_where_a_truncated_log_ends(full_flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = full_flight / "onboard.mcap"
    log.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    for command in ("log info", "log export --npz", "report"):
        assert main([*command.split(), str(full_flight)]) == 0
    capsys.readouterr()
    assert main(["log", "check", str(full_flight)]) == 1
    [line] = capsys.readouterr().out.splitlines()
    end_s = open_flight(full_flight)["onboard/tick"].time_ns[-1] * 1e-9
    assert 5.0 < end_s < 15.0
    assert line == f"onboard.mcap: not closed (killed, still flying, or disk full); read up to {end_s:.3f} s"
