"""Flies in real time: starts the three processes, supervises them, and ends all of them.

The kernel kills the processes if this one dies. Each has its own process group, so that Ctrl-C reaches only this one,
which then lets onboard land. An offboard process that dies is not replaced: the flight goes on without it, and the
command that starts another is printed.
"""

import json
import os
import selectors
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from configs.addresses import Addresses
from configs.flight_tree import Choices
from experiments.flights.scenario import resolve
from runtime.errors import StartError
from runtime.signals import StopRequest, die_with_parent
from runtime.sockets import AddressInUseError, require_free

MODULES: Final = {"sim": "sim_vehicle", "offboard": "offboard", "onboard": "onboard"}
"""In the order of their start; onboard's first motor command starts the flight."""
READY_LIMIT_S: Final = 120.0
"""The first start compiles the simulated vehicle, and a slow machine imports torch slowly."""
PATIENCE_S: Final = 2.0
"""Time after which the status says which process is not ready."""
END_LIMIT_S: Final = 5.0
FALL_LIMIT_S: Final = 3.0
OVERTIME_S: Final = 30.0
"""A flight that exceeds its duration by this time is ended."""
VEHICLES_TRIED: Final = 8
LINE_MAX_BYTES: Final = 65_536
BAD_USAGE: Final = 2
"""Exit status of a process that cannot use its configuration or an address."""

OnStatus = Callable[[dict[str, Any]], None]


class FlightStartError(StartError):
    """A process that the flight needs did not start. The message names it and its last line."""


@dataclass(slots=True)
class RealtimeResult:
    """The results of the three processes."""

    onboard: dict[str, Any] | None = None
    """onboard_summary.json; None if the process ended before it wrote it."""
    offboard: dict[str, Any] | None = None
    sim: dict[str, Any] | None = None
    exit_status: dict[str, int | None] = field(default_factory=dict)
    interrupted: bool = False
    notes: list[str] = field(default_factory=list)
    """Unexpected events, one line each."""
    faults: list[str] = field(default_factory=list)
    """Why the record is incomplete, one line each."""


def process_command(name: str, config_path: Path, out: Path) -> list[str]:
    """Return the command that starts a process of the flight."""
    return [sys.executable, "-m", MODULES[name], "--config", str(config_path.resolve()), "--out", str(out.resolve())]


class Child:
    """One process of the flight. Its status goes through a pipe, its standard error into a file in `out`."""

    def __init__(self, name: str, command: Sequence[str], out: Path) -> None:
        self.name = name
        self.ready = False
        self.command = list(command)
        self._errors = out / f"{name}_errors.txt"
        self._rest = b""
        with self._errors.open("ab") as errors:
            self.process = subprocess.Popen(
                [*self.command, "--json"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=errors,
                start_new_session=True,
                preexec_fn=die_with_parent(),
            )
        assert self.process.stdout is not None
        self.pipe = self.process.stdout
        os.set_blocking(self.pipe.fileno(), False)

    @property
    def running(self) -> bool:
        """Whether the process is running."""
        return self.process.poll() is None

    def lines(self) -> list[dict[str, Any]]:
        """Return the complete lines that have arrived; other output is ignored."""
        try:
            self._rest += os.read(self.pipe.fileno(), LINE_MAX_BYTES)
        except BlockingIOError:
            return []
        *whole, self._rest = self._rest.split(b"\n")
        entries = []
        for line in whole:
            try:
                entry = json.loads(line)
            except ValueError:
                continue
            if isinstance(entry, dict):
                entries.append(entry)
                self.ready = self.ready or entry.get("text") == "ready"
        return entries

    def ask(self, number: signal.Signals) -> None:
        """Send a signal, if the process is running."""
        if self.running:
            self.process.send_signal(number)

    def end(self, limit_s: float) -> None:
        """Ask the process to end, wait, and kill it if it does not."""
        self.ask(signal.SIGTERM)
        try:
            self.process.wait(limit_s)
        except subprocess.TimeoutExpired:
            self.kill()

    def kill(self) -> None:
        """Kill the process and all that it started."""
        if self.running:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def last_error(self) -> str:
        """Return the last line of its standard error."""
        lines = self._errors.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1] if lines else ""

    def ending(self) -> str:
        """Return how it ended, and its last line of standard error."""
        status = self.process.returncode
        how = f"status {status}" if status is None or status >= 0 else f"killed by {signal.Signals(-status).name}"
        return f"({how}): {error}" if (error := self.last_error()) else f"({how})"

    def tidy(self) -> None:
        """Close the pipe; delete an empty error file."""
        self.pipe.close()
        if self._errors.stat().st_size == 0:
            self._errors.unlink()


class Supervisor:
    """Starts, watches and ends the processes of one flight."""

    def __init__(self, config_path: Path, out: Path, duration_s: float, on_status: OnStatus) -> None:
        self._config_path = config_path
        self._out = out
        self._duration_s = duration_s
        self._on_status = on_status
        self.children: dict[str, Child] = {}
        self._selector = selectors.DefaultSelector()
        self._stop = StopRequest()
        self._stops_passed_on = 0
        self.result = RealtimeResult()

    def fly(self) -> None:
        """Fly, and end every process. Raises FlightStartError if a process does not start."""
        try:
            self._start("sim")
            self._start("offboard")
            if self._wait_until_ready():
                self._start("onboard")
                self._watch()
        finally:
            self._end_all()

    def _start(self, name: str) -> None:
        child = Child(name, process_command(name, self._config_path, self._out), self._out)
        self.children[name] = child
        self._selector.register(child.pipe, selectors.EVENT_READ, child)

    def _wait_until_ready(self) -> bool:
        """Wait for sim and offboard; return False if asked to end. The flight can start without offboard."""
        start = time.monotonic()
        told = False
        while late := [name for name, child in self.children.items() if not child.ready and self._may_come(child)]:
            self._relay()
            if not told and time.monotonic() > start + PATIENCE_S:
                told = True
                self._tell(f"waiting for {' and '.join(late)}; a first start compiles and takes longer")
            if self._stop.count:
                self.result.interrupted = True
                return False
            if time.monotonic() > start + READY_LIMIT_S:
                if "sim" in late:
                    raise FlightStartError(f"{' and '.join(late)} not ready within {READY_LIMIT_S:.0f} s")
                self._note(f"offboard is not ready after {READY_LIMIT_S:.0f} s; the flight starts without it")
                break
        return True

    def _may_come(self, child: Child) -> bool:
        """Return whether a process that is not ready may become ready.

        Raises FlightStartError if it has ended and the flight needs it, or if it could not use its configuration.
        """
        if child.running:
            return True
        if child.name != "offboard" or child.process.returncode == BAD_USAGE:
            raise FlightStartError(f"{child.name} ended at its start {child.ending()}")
        return False

    def _watch(self) -> None:
        """Watch the processes until the simulated vehicle or onboard ends."""
        limit = time.monotonic() + self._duration_s + OVERTIME_S
        sim, onboard, offboard = (self.children[name] for name in ("sim", "onboard", "offboard"))
        offboard_seen = True
        while sim.running and onboard.running:
            self._relay()
            self._pass_stop_on(onboard)
            if offboard_seen and not offboard.running:
                offboard_seen = False
                self._note(f"offboard ended {offboard.ending()}")
                self._note(f"the flight goes on without it; start another with: {self._restart(offboard)}")
            if time.monotonic() > limit or self._stop.count >= 2:
                self._note("ended at once" if self._stop.count >= 2 else "the flight took too long and was ended")
                return
        if sim.running and self._stop.count == 0:
            self._note(f"onboard ended in flight {onboard.ending()}")
            self._await_the_fall(sim)

    def _await_the_fall(self, sim: Child) -> None:
        """Wait for the simulation to decide whether the vehicle crashes: it gets no motor commands any more."""
        limit = time.monotonic() + FALL_LIMIT_S
        while sim.running and time.monotonic() < limit and self._stop.count == 0:
            self._relay()

    def _restart(self, offboard: Child) -> str:
        """Return the command that starts another offboard process with what this one had learnt."""
        checkpoint = self._out.resolve() / "checkpoint.npz"
        return shlex.join([*offboard.command, *(("--resume", str(checkpoint)) if checkpoint.exists() else ())])

    def _pass_stop_on(self, onboard: Child) -> None:
        if self._stop.count > self._stops_passed_on:
            self._stops_passed_on = self._stop.count
            self.result.interrupted = True
            if self._stop.count == 1:
                self._note("asked to end: landing (once more ends at once)")
            onboard.ask(signal.SIGINT)

    def _relay(self) -> None:
        """Pass on what the processes report; wait at most 0.1 s for it."""
        for key, _ in self._selector.select(0.1):
            child: Child = key.data
            for entry in child.lines():
                if entry.get("kind") == "fault":
                    self.result.faults.append(f"{child.name}: {entry.get('text', '')}")
                self._on_status(entry)
            if not child.running:
                self._selector.unregister(child.pipe)

    def _note(self, text: str) -> None:
        self.result.notes.append(text)
        self._tell(text)

    def _tell(self, text: str) -> None:
        self._on_status({"process": "fly", "kind": "event", "text": text})

    def _end_all(self) -> None:
        """End all processes, the vehicle first: without its sensors onboard does not wait for a landing."""
        for name in ("sim", "onboard", "offboard"):
            if name in self.children:
                self.children[name].end(END_LIMIT_S)
        self._relay()
        for name, child in self.children.items():
            child.kill()
            self.result.exit_status[name] = child.process.returncode
            child.tidy()
        self._selector.close()


def require_free_ports(network: Addresses) -> None:
    """Check that all addresses of the flight are free. Raises AddressInUseError for the first that is not."""
    require_free(network.bound_by_sim() | network.bound_by_onboard() | network.bound_by_offboard())


def free_vehicle_number(scenario: str, choices: Choices) -> int | None:
    """The lowest other number of a vehicle whose addresses are all free; None if there is none."""
    for number in range(1, VEHICLES_TRIED + 1):
        if number == choices.vehicle:
            continue
        try:
            require_free_ports(resolve(scenario, replace(choices, vehicle=number)).network)
        except AddressInUseError:
            continue
        return number
    return None


def run(
    network: Addresses, config_path: Path, duration_s: float, out: Path, on_status: OnStatus = lambda entry: None
) -> RealtimeResult:
    """Fly in real time over UDP.

    Parameters
    ----------
    network: the addresses; they must be free.
    config_path: the resolved configuration that all three processes read.
    out: the flight's folder, which exists.
    on_status: called with every status and event line of the processes, as a dict.

    Raises
    ------
    AddressInUseError
        If an address is in use; no process was started.
    FlightStartError
        If a process did not start; all were ended.
    """
    require_free_ports(network)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        supervisor = Supervisor(config_path, out, duration_s, on_status)
        supervisor.fly()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    result = supervisor.result
    result.onboard, result.offboard, result.sim = (_summary(out, name) for name in ("onboard", "offboard", "sim"))
    return result


def _summary(out: Path, name: str) -> dict[str, Any] | None:
    try:
        summary = json.loads((out / f"{name}_summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return summary if isinstance(summary, dict) else None
