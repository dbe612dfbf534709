"""What the process does for one vehicle: at the end one last checkpoint, whatever the worker is writing."""

import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from offboard import vehicle_service
from offboard.vehicle_service import VehicleService


@pytest.fixture
def service(tmp_path: Path):
    network: Any = SimpleNamespace(
        offboard_link="127.0.0.1:0", radio_offboard="127.0.0.1:9", motion_capture="127.0.0.1:0"
    )
    core: Any = SimpleNamespace(final_checkpoint=lambda: b"last")
    nothing: Any = SimpleNamespace()
    made = VehicleService(core, network, nothing, tmp_path, nothing, nothing)
    yield made
    made.close()


def test_the_last_checkpoint_waits_for_the_worker_and_stays(
    service: VehicleService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    under_way, go_on = threading.Event(), threading.Event()
    write = vehicle_service.write_atomically

    def slow(path: Path, content: bytes) -> None:
        if content == b"worker's":
            under_way.set()
            assert go_on.wait(10.0)
        write(path, content)

    monkeypatch.setattr(vehicle_service, "write_atomically", slow)
    worker = threading.Thread(target=service._write_checkpoint, args=(b"worker's",))
    worker.start()
    assert under_way.wait(10.0)
    threading.Timer(0.1, go_on.set).start()
    service.end()
    worker.join()
    service._write_checkpoint(b"too late")
    assert (tmp_path / "checkpoint.npz").read_bytes() == b"last"


def test_a_full_disk_at_the_end_is_one_line(
    service: VehicleService, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(path: Path, content: bytes) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(vehicle_service, "write_atomically", full)
    service.end()
    assert capsys.readouterr().err.strip().endswith("checkpoint.npz: cannot be written: No space left on device")
