"""The offboard process: the core between its sockets, the log, its files and one worker thread that trains.

The relay of poses must not wait for training: sockets and core run in the main thread, a training job in a worker
with a low claim on the processor.
"""

import argparse
import gc
import os
import queue
import secrets
import select
import sys
import threading
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

from configs.loader import ConfigError, fill_section
from configs.network import NetworkConfig, seen_from_offboard
from flight_record.writer import FlightLogWriter
from offboard.config import OffboardConfig
from offboard.core import OffboardCore
from offboard.experience import ExperienceError
from offboard.records import OffboardOutput
from offboard.training_job import TrainingResult
from protocol.keys import load_key
from protocol.session import session_number
from shell.errors import StartError
from shell.files import make_folder, write_atomically, write_json
from shell.flight_options import add_flight_options, flight_of
from shell.kernel import THREAD_SWITCH_S, resident_mb
from shell.signals import StopRequest
from shell.sockets import AddressInUseError, DatagramSocket
from shell.status import StatusLines

STEP_PERIOD_NS: Final = 10_000_000
"""The core steps at least this often, and whenever something arrived."""
LINK_DATAGRAMS_PER_STEP: Final = 64
POSE_DATAGRAMS_PER_STEP: Final = 16
WORKER_NICENESS: Final = 10
ESCAPES_MAX: Final = 100
"""Steps that may fail before the process gives up; the vehicle flies on without it."""


class Worker:
    """One thread that runs training jobs and writes files, one after the other."""

    def __init__(self) -> None:
        self._work_left: queue.SimpleQueue[Callable[[], TrainingResult | None]] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[TrainingResult | str] = queue.SimpleQueue()
        threading.Thread(target=self._work, name="trainer", daemon=True).start()

    def give(self, work: Callable[[], TrainingResult | None]) -> None:
        """Queue something to be done."""
        self._work_left.put(work)

    def take(self) -> TrainingResult | str | None:
        """The next result, the report of a job that failed, or None."""
        try:
            return self._results.get_nowait()
        except queue.Empty:
            return None

    def _work(self) -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), WORKER_NICENESS)
        first = True
        while True:
            work = self._work_left.get()
            try:
                result = work()
                if result is not None:
                    self._results.put(result)
            except Exception:
                self._results.put(traceback.format_exc())
            if first:
                first = False
                gc.freeze()  # torch's own objects: later collections need not look at them


class OffboardProcess:
    """The loop around a core."""

    def __init__(
        self,
        core: OffboardCore,
        network: NetworkConfig,
        log: FlightLogWriter,
        out: Path,
        status: StatusLines,
        stop: StopRequest,
    ) -> None:
        self._core = core
        self._log = log
        self._out = out
        self._status = status
        self._stop = stop
        self._link = DatagramSocket("--bind-link", network.offboard_link, network.radio_offboard)
        try:
            self._poses = DatagramSocket("--bind-motion-capture", network.motion_capture, None)
        except AddressInUseError:
            self._link.close()
            raise
        self._worker = Worker()
        self._checkpoint_lock = threading.Lock()
        self._checkpoint_closed = False
        self.steps = 0
        self._latest_report = ""
        self.escapes = 0
        self.failed_jobs = 0

    def serve(self) -> int:
        """Run until asked to end; returns the exit status: 0, or 1 if too many steps failed."""
        while self._stop.count == 0 and self.escapes < ESCAPES_MAX:
            select.select((self._link, self._poses), (), (), STEP_PERIOD_NS * 1e-9)
            now = time.monotonic_ns()
            try:
                self._take_in(now)
                output = self._core.step(now)
                self._give_out(output, now)
            except Exception:
                self._note_escape(now)
            self.steps += 1
        self._link.close()
        self._poses.close()
        last = self._core.final_checkpoint()
        if last is not None:
            self._write_last_checkpoint(last)
        return int(self.escapes >= ESCAPES_MAX)

    def _take_in(self, now: int) -> None:
        for datagram in self._poses.receive(POSE_DATAGRAMS_PER_STEP):
            self._core.take_in_motion_capture(datagram, now)
        for datagram in self._link.receive(LINK_DATAGRAMS_PER_STEP):
            self._core.take_in(datagram, now)
        result = self._worker.take()
        if isinstance(result, str):
            self.failed_jobs += 1
            self._core.training_failed(now)
            self._report(now, result, f"training failed ({self.failed_jobs} times)")
        elif result is not None:
            self._core.take_in_training(result, now)

    def _give_out(self, output: OffboardOutput, now: int) -> None:
        for datagram in output.to_onboard:
            self._link.send(datagram)
        if output.job is not None:
            self._worker.give(output.job.run)
        for record_type, time_ns, vector in output.records:
            self._log.write(record_type, time_ns, vector)
        for time_ns, text in output.events:
            self._log.event(time_ns, text)
            self._status.say(text)
        if output.checkpoint is not None:
            self._worker.give(partial(self._write_checkpoint, output.checkpoint))
        if output.version_file is not None:
            version, content = output.version_file
            self._worker.give(partial(write_atomically, self._out / f"features_{version}.npz", content))
        if self._status.due(now):
            self._status.write({**self._core.status(now), "escapes": self.escapes})

    def _write_checkpoint(self, content: bytes, last: bool = False) -> None:
        """Two threads write it, the worker in flight and the loop at its end; nothing comes after the last one."""
        with self._checkpoint_lock:
            if not self._checkpoint_closed:
                self._checkpoint_closed = last
                write_atomically(self._out / "checkpoint.npz", content)

    def _write_last_checkpoint(self, content: bytes) -> None:
        """A full disk must not cost the summary."""
        try:
            self._write_checkpoint(content, last=True)
        except OSError as error:
            print(f"{self._out / 'checkpoint.npz'}: cannot be written: {error.strerror}", file=sys.stderr, flush=True)

    def _note_escape(self, now: int) -> None:
        self.escapes += 1
        self._report(now, traceback.format_exc(), f"a step failed ({self.escapes} of {ESCAPES_MAX})")

    def _report(self, now: int, report: str, what: str) -> None:
        """Tell of a failure: in full when it is not the same as the last one."""
        if report != self._latest_report:
            self._latest_report = report
            self._log.event(now, report)
            print(report, file=sys.stderr, flush=True)
        self._status.say(f"{what}: {report.strip().splitlines()[-1]}")

    def summary(self) -> dict[str, Any]:
        """What the flight record keeps of this process."""
        return {
            **self._core.summary(),
            "steps": self.steps,
            "escapes": self.escapes,
            "failed_jobs": self.failed_jobs,
            "rss_mb": round(resident_mb(), 1),
        }


EXAMPLES: Final = """examples:
  dmrac offboard --onboard 10.0.0.2:14571 --key-file flight.key --out flight
  dmrac offboard --config flight.yaml --out flight
  dmrac offboard --config flight.yaml --out flight --resume flight/checkpoint.npz
  dmrac offboard --config flight.yaml --onboard 10.0.0.2:14571 --bind-link 10.0.0.7:14573 \\
      --bind-motion-capture 10.0.0.7:14574 --key-file flight.key
"""
OPTIONS: Final = {
    "radio_offboard": "--onboard",
    "offboard_link": "--bind-link",
    "motion_capture": "--bind-motion-capture",
    "key_file": "--key-file",
}
"""What overrules which key of the configuration's network."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `python -m offboard` and `dmrac offboard`."""
    add_flight_options(parser)
    parser.add_argument("--out", type=Path, default=Path(), help="folder for log, checkpoints and summary")
    parser.add_argument("--onboard", metavar="HOST:PORT", help="the onboard process, or the radio towards it")
    parser.add_argument("--bind-link", metavar="HOST:PORT", help="own address towards onboard")
    parser.add_argument("--bind-motion-capture", metavar="HOST:PORT", help="own address for the motion capture")
    parser.add_argument("--key-file", metavar="FILE", help="key shared with onboard")
    parser.add_argument("--resume", type=Path, metavar="FILE", help="go on from a checkpoint, as after a restart")
    parser.add_argument("--warm-start", type=Path, metavar="FILE", help="start from the features of a version file")
    parser.add_argument("--json", action="store_true", help="status as JSON lines, for a supervising program")


def run(arguments: argparse.Namespace) -> int:
    """Run the process; returns the exit status (0 served, 1 ended by failures, 2 bad configuration or address)."""
    stop = StopRequest()
    status = StatusLines("offboard", arguments.json)
    try:
        flight = flight_of(arguments, OPTIONS, {"--onboard": "HOST:PORT"}, seen_from_offboard)
        network = flight.network
        config = fill_section(OffboardConfig, flight.tree, flight.source, "offboard")
        key = load_key(network.key_file)
        core = OffboardCore(config, session_number(time.time_ns(), secrets.randbits(20)), key)
        _load_experience(core, arguments)
        if config.experience.mode == "learn":
            import offboard.trainer  # noqa: F401  torch takes seconds to load: before poses wait, not between them
        make_folder(arguments.out)
    except (ConfigError, StartError) as error:
        print(error, file=sys.stderr)
        return 2
    attachments = {"config.yaml": flight.text}
    log = FlightLogWriter(arguments.out / "offboard.mcap", "offboard", {"seed": str(config.seed)}, attachments)
    try:
        process = OffboardProcess(core, network, log, arguments.out, status, stop)
        sys.setswitchinterval(THREAD_SWITCH_S)
        status.say(f"onboard {network.radio_offboard}, motion capture is heard on {network.motion_capture}")
        status.say("ready")
        result = process.serve()
    except AddressInUseError as error:
        print(error, file=sys.stderr)
        return 2
    finally:
        log.close()
    write_json(arguments.out / "offboard_summary.json", process.summary())
    # A round of training may still run; nobody waits for it, and torch must not be torn down under it.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(result)


def _load_experience(core: OffboardCore, arguments: argparse.Namespace) -> None:
    """Whatever the process is to start from. Raises ConfigError naming the file."""
    for path, load in ((arguments.resume, core.resume), (arguments.warm_start, core.warm_start)):
        if path is None:
            continue
        try:
            load(path.read_bytes())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
        except (ExperienceError, ValueError) as error:
            raise ConfigError(f"{path}: {error}") from None
