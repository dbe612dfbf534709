"""The processes of a soak: starts, stops, kills and starts them again, and keeps what they report."""

import os
import selectors
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from experiments.flights.realtime_flight import END_LIMIT_S, Child, FlightStartError, process_command
from experiments.flights.scenario import FlightConfig
from experiments.link.flood import flood_command
from experiments.soak.schedule import Action, Disruption
from experiments.soak.watch import Life

READY_LIMIT_S: Final = 180.0
NICENESS: Final = {"offboard": -10, "capture": -10, "ground": -5}
"""These have machines of their own in a laboratory: other programs of this one must not starve them."""
SHORT_STOP_S: Final = 0.06
"""A stop up to this long is waited for, so that it does not get longer."""


@dataclass(slots=True)
class Done:
    """A disruption that was carried out."""

    disruption: Disruption
    begin_ns: int
    """Monotonic clock."""
    end_ns: int = 0
    """When the process ran again, or the flood ended; 0 if that did not happen before the end."""
    note: str = ""
    """Why it was left out; "" if it was not."""


class Crew:
    """Starts the processes of a soak by name: sim, offboard, capture, ground, onboard.

    Parameters
    ----------
    config: of all processes but the vehicle, whose poses go to `listen`, where the capture signs them.
    configs: by process, the file of its configuration.
    """

    def __init__(self, config: FlightConfig, configs: dict[str, Path], listen: str, out: Path) -> None:
        network = config.network
        self._config, self._out = config, out
        capture = ("--listen", listen, "--offboard", network.motion_capture)
        self._commands = {name: process_command(name, path, out) for name, path in configs.items()}
        self._commands["capture"] = [sys.executable, "-m", "async_dmrac", "mocap", *capture]
        self._commands["capture"] += ["--capture-key-file", str(network.capture_key_file)]
        self._commands["ground"] = [sys.executable, "-m", "experiments.soak.ground_station"]
        self._commands["ground"] += [network.ground, str(network.ground_key_file)]
        self._selector = selectors.DefaultSelector()
        self.children: dict[str, Child] = {}
        self.lives: list[Life] = []
        self.status: dict[str, dict[str, Any]] = {}
        """The newest status of each process."""
        self.events: Counter[str] = Counter()
        """Events by process and first words."""
        self.faults: list[str] = []
        self.done: list[Done] = []
        self._pending: list[tuple[float, Done]] = []
        self._floods: list[tuple[subprocess.Popen[bytes], Done]] = []

    def start(self, name: str) -> None:
        """Start a process; an offboard process continues from the checkpoint, if there is one."""
        command = list(self._commands[name])
        checkpoint = self._out / "checkpoint.npz"
        if name == "offboard" and checkpoint.exists():
            command += ["--resume", str(checkpoint)]
        child = Child(name, command, self._out)
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, child.process.pid, NICENESS.get(name, 0))
        self.children[name] = child
        self.lives.append(Life(name, child.process.pid))
        self._selector.register(child.pipe, selectors.EVENT_READ, child)

    def wait_until_ready(self, *names: str) -> None:
        """Wait for processes. Raises FlightStartError if one ends, or takes longer than READY_LIMIT_S."""
        limit_s = time.monotonic() + READY_LIMIT_S
        while not all(self.children[name].ready for name in names):
            self.read(0.1)
            for name in names:
                if not self.children[name].running:
                    raise FlightStartError(f"{name} ended at its start {self.children[name].ending()}")
            if time.monotonic() > limit_s:
                raise FlightStartError(f"{', '.join(names)}: not ready within {READY_LIMIT_S:.0f} s")

    def read(self, wait_s: float) -> None:
        """Read what the processes report, for at most `wait_s`."""
        for key, _ in self._selector.select(wait_s):
            child: Child = key.data
            for entry in child.lines():
                self._keep(child.name, entry)
            if not child.running:
                self._selector.unregister(child.pipe)

    def _keep(self, name: str, entry: dict[str, Any]) -> None:
        if entry.get("kind") == "status":
            self.status[name] = entry
        elif entry.get("kind") == "fault":
            self.faults.append(f"{name}: {entry.get('text', '')}")
        elif entry.get("kind") == "event":
            words = str(entry.get("text", "")).split(";")[0]
            self.events[f"{name}: {''.join('N' if one.isdigit() else one for one in words)}"] += 1

    def disrupt(self, disruption: Disruption) -> None:
        """Carry out a disruption; what ends later is ended by `attend`."""
        done = Done(disruption, time.monotonic_ns())
        self.done.append(done)
        child = self.children.get(disruption.target)
        if disruption.action is Action.FLOOD:
            command = flood_command(self._config, disruption.target, disruption.rate_hz, disruption.seconds)
            self._floods.append((subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL), done))
        elif child is None or not child.running or any(one.disruption.target == child.name for _, one in self._pending):
            done.note = "left out: the process was not running"
        elif not child.ready:
            done.note = "left out: the process was still starting"
        elif disruption.action is Action.STOP:
            self._stop(child, done)
        else:
            child.ask(signal.SIGTERM if disruption.action is Action.RESTART else signal.SIGKILL)
            self._later(done)

    def _stop(self, child: Child, done: Done) -> None:
        os.kill(child.process.pid, signal.SIGSTOP)
        if done.disruption.seconds > SHORT_STOP_S:
            self._later(done)
            return
        time.sleep(done.disruption.seconds)
        child.ask(signal.SIGCONT)
        done.end_ns = time.monotonic_ns()

    def _later(self, done: Done) -> None:
        self._pending.append((time.monotonic() + done.disruption.seconds, done))

    def attend(self) -> None:
        """End the stops, and start the processes again, whose time has come; note the floods that have ended."""
        now_s = time.monotonic()
        for entry in [one for one in self._pending if one[0] <= now_s]:
            due_s, done = entry
            name = done.disruption.target
            child = self.children[name]
            if done.disruption.action is Action.STOP:
                child.ask(signal.SIGCONT)
            elif child.running and now_s < due_s + END_LIMIT_S:
                continue  # asked to end, and has not yet
            else:
                child.kill()
                self._forget(child)
                self.start(name)
            self._pending.remove(entry)
            done.end_ns = time.monotonic_ns()
        for flood in [one for one in self._floods if one[0].poll() is not None]:
            self._floods.remove(flood)
            flood[1].end_ns = time.monotonic_ns()
            flood[1].note = f"failed with status {flood[0].returncode}" if flood[0].returncode else ""

    def _forget(self, child: Child) -> None:
        if child.pipe in [key.fileobj for key in self._selector.get_map().values()]:
            self._selector.unregister(child.pipe)
        child.tidy()

    def end(self) -> dict[str, int | None]:
        """End all processes, the vehicle first; return their exit status."""
        for process, _ in self._floods:
            process.kill()
        for _, done in self._pending:
            if done.disruption.action is Action.STOP:
                self.children[done.disruption.target].ask(signal.SIGCONT)
        for name in ("sim", "onboard", "offboard", "capture", "ground"):
            if name in self.children:
                self.children[name].end(END_LIMIT_S)
        self.read(0.1)
        for child in self.children.values():
            child.kill()
            self._forget(child)
        self._selector.close()
        return {name: child.process.returncode for name, child in self.children.items()}
