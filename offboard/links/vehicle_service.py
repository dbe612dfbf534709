"""One vehicle's part of the offboard process: joins its core to sockets, log, files and background thread."""

import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

from configs.addresses import Addresses
from flight_log.writer import FlightLogWriter
from offboard.background import BackgroundThread, Results
from offboard.core import OffboardCore, OffboardOutput
from offboard.links.version_files import VersionFiles
from offboard.training.job import TrainingResult
from protocol.endpoint import DATAGRAMS_PER_STEP_MAX
from runtime.files import write_atomically
from runtime.intake import Intake
from runtime.kernel import resident_mb
from runtime.sockets import AddressInUseError, DatagramSocket, Stamped
from runtime.status import StatusLines

STEP_PERIOD_NS: Final = 10_000_000
"""The core steps this often, and whenever a datagram has arrived."""
POSES_FEW: Final = 16
"""Datagrams of a step that are not screened (runtime/intake.py); of onboard DATAGRAMS_PER_STEP_MAX."""
KIND_MAX: Final = 16
"""Messages of one kind that a flooded step uses."""
ESCAPES_MAX: Final = 100
"""Steps that may raise before the service of a vehicle stops; the vehicle flies on without it."""


class VehicleService:
    """Serves one vehicle.

    Parameters
    ----------
    out: folder for checkpoints and versions.
    background: trains and writes files; other vehicles share it.
    named: the names of the two bound addresses (link, motion capture) in error messages.

    Raises
    ------
    AddressInUseError
        If an address is taken. The message names the option or key that sets it.
    """

    def __init__(
        self,
        core: OffboardCore,
        network: Addresses,
        log: FlightLogWriter,
        out: Path,
        status: StatusLines,
        background: BackgroundThread,
        named: tuple[str, str] = ("--bind-link", "--bind-motion-capture"),
    ) -> None:
        self._core = core
        self._log = log
        self._out = out
        self._status = status
        self._link = DatagramSocket(named[0], network.offboard_link, network.radio_offboard)
        try:
            self._poses = DatagramSocket(named[1], network.motion_capture, None)
        except AddressInUseError:
            self._link.close()
            raise
        self.sockets: Final = (self._link, self._poses)
        captured, messages = core.screens
        self._intakes = (
            Intake("motion capture", self._poses, POSES_FEW, KIND_MAX, captured),
            Intake("onboard", self._link, DATAGRAMS_PER_STEP_MAX, KIND_MAX, messages),
        )
        self._background = background
        self._trained: Results = queue.SimpleQueue()
        self._unwritten: Results = queue.SimpleQueue()
        """Results of writing files. Not those of training: a failed write does not end the training job."""
        self._versions = VersionFiles(out, core.versions_kept)
        self._checkpoint_lock = threading.Lock()
        self._checkpoint_closed = False
        self._latest_report = ""
        self._due_ns = 0
        self.steps = 0
        self.escapes = 0
        self.failed_jobs = 0
        self.failed_writes = 0

    @property
    def given_up(self) -> bool:
        """Whether ESCAPES_MAX steps have raised."""
        return self.escapes >= ESCAPES_MAX

    def due(self, now_ns: int) -> bool:
        """Whether a step is due even if no datagram has arrived."""
        return now_ns >= self._due_ns

    def step(self) -> None:
        """Receive what has arrived, step the core and carry out its output. An exception is logged and counted."""
        now = time.monotonic_ns()
        self._due_ns = now + STEP_PERIOD_NS
        try:
            poses, messages = (intake.receive() for intake in self._intakes)
            now = time.monotonic_ns()  # after the reads: no arrival is later
            self._receive(poses, messages, now)
            self._send(self._core.step(now), now)
        except Exception:
            self._note_escape(now)
        self.steps += 1

    def end(self) -> bool:
        """Close the sockets and write the last checkpoint. Returns False if the core raised instead of giving one."""
        self.close()
        try:
            last = self._core.final_checkpoint()
        except Exception:
            self._report(time.monotonic_ns(), traceback.format_exc(), "there is no last checkpoint")
            return False
        if last is not None:
            self._write_last(partial(self._write_checkpoint, last, last=True))
        self._write_last(self._versions.write_waiting)
        return True

    def close(self) -> None:
        """Close the sockets."""
        for socket in self.sockets:
            socket.close()

    def _receive(self, poses: list[Stamped], messages: list[Stamped], now: int) -> None:
        for datagram, arrival_ns in poses:
            self._core.receive_motion_capture(datagram, now, now - arrival_ns)
        for datagram, arrival_ns in messages:
            self._core.receive_onboard(datagram, now, now - arrival_ns)
        while isinstance(report := _taken(self._unwritten), str):
            self.failed_writes += 1
            if report != self._latest_report:  # a full disk fails again and again
                self._report(now, report, "a file could not be written")
        result = _taken(self._trained)
        if isinstance(result, str):
            self.failed_jobs += 1
            self._core.training_failed(now)
            self._report(now, result, f"training failed ({self.failed_jobs} times)")
        elif result is not None:
            self._core.receive_training(result, now)

    def _send(self, output: OffboardOutput, now: int) -> None:
        for datagram in output.to_onboard:
            self._link.send(datagram)
        if output.job is not None:
            self._background.submit(output.job.run, self._trained)
        for record_type, time_ns, vector in output.records:
            self._log.write(record_type, time_ns, vector)
        for time_ns, text in output.events:
            self._log.event(time_ns, text)
            self._status.report(text)
        if output.checkpoint is not None:
            self._background.submit(partial(self._write_checkpoint, output.checkpoint), self._unwritten)
        if output.version_file is not None:
            self._versions.put(*output.version_file)
            self._background.submit(self._versions.write_waiting, self._unwritten)
        if self._status.due(now):
            self._status.write({**self._core.status(now), "escapes": self.escapes})
            for text in filter(None, (intake.report(now) for intake in self._intakes)):
                self._log.event(now, text)
                self._status.report(text)

    def _write_checkpoint(self, content: bytes, last: bool = False) -> None:
        """Write the checkpoint file: in flight from the background thread, the last one from the main thread."""
        with self._checkpoint_lock:
            if not self._checkpoint_closed:
                self._checkpoint_closed = last
                write_atomically(self._out / "checkpoint.npz", content)

    def _write_last(self, write: Callable[[], None]) -> None:
        """Write what the background thread has not; a full disk is reported and does not prevent the summary."""
        try:
            write()
        except OSError as error:
            self.failed_writes += 1
            print(f"{error.filename}: cannot be written: {error.strerror}", file=sys.stderr, flush=True)

    def _note_escape(self, now: int) -> None:
        self.escapes += 1
        self._report(now, traceback.format_exc(), f"a step failed ({self.escapes} of {ESCAPES_MAX})")
        if self.given_up:
            text = "given up: no features and no poses until this process is restarted"
            self._log.event(now, text)
            self._status.report(text)

    def _report(self, now: int, report: str, what: str) -> None:
        """Report a failure: on stderr and in the log in full, unless it is the same as the one before."""
        if report != self._latest_report:
            self._latest_report = report
            self._log.event(now, report)
            print(report, file=sys.stderr, flush=True)
        self._status.report(f"{what}: {report.strip().splitlines()[-1]}")

    @property
    def unwritten(self) -> bool:
        """Whether the disk did not take all of the log or a file."""
        return bool(self._log.failure or self.failed_writes)

    def summary(self) -> dict[str, Any]:
        """What the flight summary stores of this vehicle's service."""
        return {
            **self._core.summary(),
            "steps": self.steps,
            "escapes": self.escapes,
            "failed_jobs": self.failed_jobs,
            "failed_writes": self.failed_writes,
            "log_failure": self._log.failure,
            "dropped": {intake.name: intake.summary() for intake in self._intakes},
            "rss_mb": round(resident_mb(), 1),
        }


def _taken(results: Results) -> TrainingResult | str | None:
    try:
        return results.get_nowait()
    except queue.Empty:
        return None
