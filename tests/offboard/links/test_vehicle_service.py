"""The service of one vehicle: failures are reported and affect neither training nor another vehicle."""

import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from offboard.background import BackgroundThread
from offboard.core import OffboardOutput
from offboard.links import vehicle_service
from offboard.links.vehicle_service import ESCAPES_MAX, VehicleService

SCREENS = (lambda datagram: 0,) * 2


@pytest.fixture
def service(tmp_path: Path):
    network: Any = SimpleNamespace(
        offboard_link="127.0.0.1:0", radio_offboard="127.0.0.1:9", motion_capture="127.0.0.1:0"
    )
    core: Any = SimpleNamespace(final_checkpoint=lambda: b"last", screens=SCREENS, versions_kept=3)
    nothing: Any = SimpleNamespace()
    made = VehicleService(core, network, nothing, tmp_path, nothing, nothing)
    yield made
    made.close()


def test_the_last_checkpoint_waits_for_the_background_thread_and_is_final(
    service: VehicleService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    under_way, go_on = threading.Event(), threading.Event()
    write = vehicle_service.write_atomically

    def slow(path: Path, content: bytes) -> None:
        if content == b"background's":
            under_way.set()
            assert go_on.wait(10.0)
        write(path, content)

    monkeypatch.setattr(vehicle_service, "write_atomically", slow)
    background = threading.Thread(target=service._write_checkpoint, args=(b"background's",))
    background.start()
    assert under_way.wait(10.0)
    threading.Timer(0.1, go_on.set).start()
    service.end()
    background.join()
    service._write_checkpoint(b"too late")
    assert (tmp_path / "checkpoint.npz").read_bytes() == b"last"


def test_a_full_disk_at_the_end_is_one_line(
    service: VehicleService, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(path: Path, content: bytes) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(vehicle_service, "write_atomically", full)
    service.end()
    assert capsys.readouterr().err.strip().endswith("checkpoint.npz: cannot be written: No space left on device")


class Core:
    """Requests a round of training whenever none is outstanding, and a checkpoint with each."""

    versions_kept = 3

    def __init__(self, name: str) -> None:
        self.name, self.outstanding = name, 0
        self.screens = SCREENS
        self.trained: list[object] = []
        self.failed = 0

    def step(self, now_ns: int) -> OffboardOutput:
        out = OffboardOutput()
        if self.outstanding == 0 and len(self.trained) < 5:
            self.outstanding += 1
            out.job = SimpleNamespace(run=lambda: f"{self.name} {len(self.trained)}".encode())  # type: ignore[assignment]
            out.checkpoint = self.name.encode()
        return out

    def receive_training(self, result: object, now_ns: int) -> None:
        self.outstanding -= 1
        self.trained.append(result)

    def training_failed(self, now_ns: int) -> None:
        self.failed += 1

    def final_checkpoint(self) -> bytes | None:
        raise RuntimeError("broken")


class Reports:
    """Replaces status lines and log."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def report(self, text: str) -> None:
        self.lines.append(text)

    def event(self, time_ns: int, text: str) -> None:
        pass

    def due(self, now_ns: int) -> bool:
        return False


def served(core: Any, reports: Any, out: Path, background: Any) -> VehicleService:
    network: Any = SimpleNamespace(
        offboard_link="127.0.0.1:0", radio_offboard="127.0.0.1:9", motion_capture="127.0.0.1:0"
    )
    return VehicleService(core, network, reports, out, reports, background)


def test_failed_writes_are_reported_and_do_not_affect_training(tmp_path: Path) -> None:
    """One of two vehicles has no folder to write to. Each still receives its own results, one job at a time."""
    background, cores, reports = BackgroundThread(), [Core("first"), Core("second")], [Reports(), Reports()]
    (tmp_path / "first").mkdir()
    services = [served(core, one, tmp_path / core.name, background) for core, one in zip(cores, reports, strict=True)]
    end = time.monotonic() + 20.0
    while time.monotonic() < end and not all(len(core.trained) == 5 for core in cores):
        for service in services:
            service.step()
        time.sleep(0.001)
    for service in services:
        service.close()
    assert [core.trained for core in cores] == [
        [f"{core.name} {number}".encode() for number in range(5)] for core in cores
    ]
    assert [core.failed for core in cores] == [0, 0]
    assert [service.escapes for service in services] == [0, 0]
    assert services[0].failed_writes == 0
    assert services[1].failed_writes > 0
    assert any(line.startswith("a file could not be written: FileNotFoundError") for line in reports[1].lines)


def test_a_core_that_keeps_failing_is_given_up_with_a_message(tmp_path: Path) -> None:
    reports, broken = Reports(), Core("broken")
    service = served(
        SimpleNamespace(final_checkpoint=broken.final_checkpoint, screens=SCREENS, versions_kept=3),
        reports,
        tmp_path,
        None,
    )
    for _ in range(ESCAPES_MAX):
        assert not service.given_up
        service.step()
    assert service.given_up
    assert reports.lines[-1].startswith("given up: ")
    assert service.end() is False
    assert reports.lines[-1] == "there is no last checkpoint: RuntimeError: broken"
