import json
from pathlib import Path

import pytest

from async_dmrac.command_line import main


def run(*words: object) -> int:
    return main([str(word) for word in words])


def test_log_info_check_merge_export(flight_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("log", "info", flight_folder) == 0
    assert "onboard/tick" in capsys.readouterr().out
    assert run("log", "info", flight_folder, "--columns") == 0
    assert "onboard/tick.position_n  m" in capsys.readouterr().out
    assert run("log", "info", flight_folder, "--json") == 0
    assert json.loads(capsys.readouterr().out)["duration_s"] == pytest.approx(4.995)
    assert run("log", "check", flight_folder) == 0
    assert "complete, 1512 records in 2 logs, no gaps" in capsys.readouterr().out
    assert run("log", "merge", flight_folder) == 0
    assert (flight_folder / "merged.mcap").exists()
    assert run("log", "export", flight_folder, "--csv", "--npz", "--ulog") == 0
    assert len(list((flight_folder / "export").iterdir())) == 5


def test_log_faults_have_one_line_and_a_status(flight_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("log", "info", "nothing/there") == 2
    assert capsys.readouterr().err == "dmrac log: nothing/there: no such flight\n"
    assert run("log", "export", flight_folder) == 2
    assert "give a format: --csv, --parquet, " in capsys.readouterr().err
    assert run("log", "merge", flight_folder) == 0
    assert run("log", "merge", flight_folder) == 2
    assert "exists already" in capsys.readouterr().err
    assert run("log", "export", flight_folder, "--npz", "-o", flight_folder / "onboard.mcap") == 2
    assert "onboard.mcap: File exists" in capsys.readouterr().err
    cut = flight_folder / "onboard.mcap"
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    assert run("log", "check", flight_folder) == 1
    assert "onboard.mcap: not closed" in capsys.readouterr().out


def test_report_and_compare(full_flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("report", full_flight) == 0
    assert capsys.readouterr().out == f"{full_flight / 'report.html'}\n"
    assert run("report", tmp_path / "nothing") == 2
    assert "no such flight" in capsys.readouterr().err
    assert run("report", full_flight, "-o", tmp_path / "no" / "x.html") == 2
    assert "x.html: No such file or directory" in capsys.readouterr().err
    assert run("compare", full_flight, full_flight, "-o", tmp_path / "c.html") == 0
    out = capsys.readouterr().out
    assert "position_rmse_m" in out
    assert out.count("0.12346") == 2
    assert run("compare", full_flight, "-o", tmp_path / "d.html") == 2
    assert "two flights or more" in capsys.readouterr().err
