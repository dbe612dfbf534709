"""Writing status lines never waits."""

import json
import os
from pathlib import Path

import pytest

from runtime.files import write_json
from runtime.status import StatusLines


def test_a_reader_that_does_not_read_loses_lines_and_costs_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    with os.fdopen(writer, "w") as pipe, monkeypatch.context() as patch:
        patch.setattr("sys.stdout", pipe)
        status = StatusLines("onboard", as_json=True)
        for number in range(5000):
            status.write({"number": number, "text": "x" * 100})
    assert status.dropped > 0
    lines = os.read(reader, 1 << 20).splitlines()
    os.close(reader)
    assert [json.loads(line)["number"] for line in lines] == list(range(len(lines)))


def test_an_insecure_link_is_on_every_status_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "out"
    for as_json in (True, False):
        with path.open("w") as out, monkeypatch.context() as patch:
            patch.setattr("sys.stdout", out)
            status = StatusLines("onboard", as_json, insecure="vehicle, ground")
            for number in range(13):
                status.write({"number": number})
        lines = path.read_text(encoding="utf-8").splitlines()
        assert len(lines) == (13 if as_json else 3)
        assert all("vehicle, ground" in line for line in lines)


def test_due_at_most_three_times_a_second(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "out").open("w") as out, monkeypatch.context() as patch:
        patch.setattr("sys.stdout", out)
        status = StatusLines("onboard", as_json=True)
    times = [now for now in range(0, 10**9, 5_000_000) if status.due(now + 1)]
    assert len(times) == 3


def test_summaries_accept_numpy_values_and_replace_the_file_atomically(tmp_path: Path) -> None:
    numpy = pytest.importorskip("numpy")
    path = tmp_path / "summary.json"
    write_json(path, {"a": 1})
    write_json(path, {"a": numpy.float64(0.5), "b": numpy.arange(2)})
    assert json.loads(path.read_text(encoding="utf-8")) == {"a": 0.5, "b": [0, 1]}
    assert list(tmp_path.iterdir()) == [path]
