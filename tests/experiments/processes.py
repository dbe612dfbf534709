"""Starts the three processes of a flight one by one."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from configs.addresses import ADDRESSES
from experiments.flights.scenario import FlightConfig

ROOT = Path(__file__).resolve().parents[2]
MODULES = {"sim": "sim_vehicle", "offboard": "offboard", "onboard": "onboard"}
READY_LIMIT_S = 40.0


def on_ports(config: FlightConfig, first: int) -> FlightConfig:
    """Return the flight with addresses that other flights do not use: ports of this machine from `first` on."""
    addresses = {name: f"127.0.0.1:{first + index}" for index, name in enumerate(ADDRESSES)}
    network = config.network.model_validate(config.network.model_dump() | addresses)
    return config.model_copy(update={"network": network})


class Processes:
    """Starts processes that log into a folder; ends all of them on exit."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, config: Path | None, *options: str, prefix: tuple[str, ...] = ()) -> None:
        """Start a process and wait until it is ready; without `config`: with its options alone."""
        output = self.out / f"{name}_output.txt"
        command = [*prefix, sys.executable, "-m", MODULES[name], "--out", str(self.out)]
        command += ["--config", str(config)] if config else []
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        with output.open("wb") as file:
            self.running[name] = subprocess.Popen(
                [*command, *options], stdout=file, stderr=subprocess.STDOUT, env=environment, stdin=subprocess.DEVNULL
            )
        limit = time.monotonic() + READY_LIMIT_S
        while ": ready" not in output.read_text(encoding="utf-8", errors="replace"):
            assert self.running[name].poll() is None, output.read_text(encoding="utf-8")
            assert time.monotonic() < limit, f"{name} is not ready"
            time.sleep(0.05)

    def wait(self, name: str, limit_s: float) -> int:
        """Wait for a process to end by itself."""
        return self.running[name].wait(limit_s)

    def end(self, *names: str) -> None:
        """Ask processes to end, twice if necessary, and wait."""
        for name in names:
            process = self.running[name]
            for number in (signal.SIGTERM, signal.SIGTERM, signal.SIGKILL):
                if process.poll() is None:
                    process.send_signal(number)
                    try:
                        process.wait(5.0)
                    except subprocess.TimeoutExpired:
                        continue

    def summary(self, name: str) -> dict[str, Any]:
        """Return the summary of a process."""
        found: dict[str, Any] = json.loads((self.out / f"{name}_summary.json").read_text(encoding="utf-8"))
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self.running.values():
            if process.poll() is None:
                process.kill()
            process.wait()
