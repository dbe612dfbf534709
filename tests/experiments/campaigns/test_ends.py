"""How a campaign ends that cannot go on: killed, interrupted, or without its cluster."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from async_dmrac.command_line import main
from experiments.campaigns.store import read_table
from tests.dask_cluster import running_cluster

LONG = """
description: Flights that take minutes.
controllers: [pid]
cases: [{name: long, scenario: hover, duration_s: 3600}]
seeds: {count: 6}
"""
ROOT = Path(__file__).resolve().parents[3]
WORKERS = 2
START_LIMIT_S = 240.0
END_LIMIT_S = 20.0


def campaign_file(folder: Path) -> Path:
    file = folder / "long.yaml"
    file.write_text(LONG, encoding="utf-8")
    return file


@pytest.fixture
def flying(tmp_path: Path) -> Iterator[tuple["subprocess.Popen[bytes]", list[int]]]:
    """A campaign in a process of its own, and its workers, which are in the air."""
    words = ["campaign", str(campaign_file(tmp_path)), "--out", str(tmp_path / "out"), "--jobs", str(WORKERS)]
    with (tmp_path / "output.txt").open("wb") as output:
        parent = subprocess.Popen(
            [sys.executable, "-m", "async_dmrac", *words],
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
    try:
        limit_s = time.monotonic() + START_LIMIT_S
        while len(workers := busy_workers(parent.pid)) < WORKERS:
            assert parent.poll() is None, (tmp_path / "output.txt").read_text()
            assert time.monotonic() < limit_s
            time.sleep(0.2)
        yield parent, workers
    finally:
        parent.kill()
        parent.wait()


def busy_workers(parent: int) -> list[int]:
    """Processes of the pool that have used a processor for seconds: they fly."""
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    found = []
    for child in children:
        words = Path(f"/proc/{child}/cmdline").read_bytes()
        used_s = sum(map(int, Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[11:13])) / 100
        if b"spawn_main" in words and used_s > 4.0:
            found.append(int(child))
    return found


def all_end(processes: list[int]) -> bool:
    limit_s = time.monotonic() + END_LIMIT_S
    while any(alive(one) for one in processes):
        if time.monotonic() > limit_s:
            return False
        time.sleep(0.1)
    return True


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.full
def test_workers_end_with_a_killed_campaign(flying: tuple["subprocess.Popen[bytes]", list[int]]) -> None:
    parent, workers = flying
    parent.kill()
    ended = all_end(workers)
    for worker in workers:
        if alive(worker):
            os.kill(worker, signal.SIGKILL)
    assert ended, "they fly on without anybody who stores their rows"


@pytest.mark.full
def test_ctrl_c_waits_for_no_flight_and_can_be_resumed(
    flying: tuple["subprocess.Popen[bytes]", list[int]], tmp_path: Path
) -> None:
    parent, workers = flying
    parent.send_signal(signal.SIGINT)
    assert parent.wait(END_LIMIT_S) == 130
    assert all_end(workers)
    output = (tmp_path / "output.txt").read_text()
    assert "interrupted, all rows are stored. Continue with:" in output
    assert "Traceback" not in output
    assert read_table(tmp_path / "out").num_rows == 0


def test_without_a_scheduler_no_folder_is_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("distributed")
    out = tmp_path / "out"
    words = ["campaign", str(campaign_file(tmp_path)), "--out", str(out), "--scheduler", "tcp://127.0.0.1:9"]
    assert main(words) == 2
    assert "no scheduler answers" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.full
def test_a_campaign_ends_when_its_scheduler_dies(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    out = tmp_path / "out"
    words = ["campaign", str(campaign_file(tmp_path)), "--out", str(out), "--scheduler"]
    with running_cluster(tmp_path) as cluster, (tmp_path / "output.txt").open("wb") as output:
        parent = subprocess.Popen(
            [sys.executable, "-m", "async_dmrac", *words, cluster],
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        limit_s = time.monotonic() + START_LIMIT_S
        while not (out / "campaign.yaml").exists():
            assert time.monotonic() < limit_s
            time.sleep(0.2)
        time.sleep(2.0)
        os.kill(scheduler_of(tmp_path), signal.SIGKILL)
        try:
            assert parent.wait(3 * END_LIMIT_S) == 2
        finally:
            parent.kill()
            parent.wait()
    text = (tmp_path / "output.txt").read_text()
    assert "the scheduler of the cluster is gone; all rows are stored" in text
    assert "Traceback" not in text
    assert read_table(out).num_rows == 0, "no flight is blamed"


def scheduler_of(folder: Path) -> int:
    """The process of the scheduler whose file is in a folder."""
    for place in Path("/proc").glob("[0-9]*"):
        try:
            words = (place / "cmdline").read_bytes()
        except OSError:
            continue
        if b"dask_scheduler" in words and str(folder).encode() in words:
            return int(place.name)
    raise AssertionError("no scheduler")
