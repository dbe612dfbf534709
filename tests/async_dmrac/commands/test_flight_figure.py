"""The figure of a flight marks each lost datagram; a flight without a log of them is drawn without marks."""

from pathlib import Path

import pytest

from async_dmrac.command_line import main
from experiments.flights.logged_flight import lost_datagrams


def test_the_figure_marks_lost_datagrams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = "fly hover --lockstep --no-offboard --duration 5 --out flown --set radio.up.loss=0.2"
    assert main(words.split()) == 0
    lost = lost_datagrams(tmp_path / "flown")
    assert (tmp_path / "flown" / "flight.png").stat().st_size > 10_000
    assert set(lost) == {"up", "down"}
    assert all(((times_s >= 0.0) & (times_s <= 5.0)).all() for times_s in lost.values())
    assert lost_datagrams(tmp_path) == {}
