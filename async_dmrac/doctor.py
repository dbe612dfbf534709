"""Checks of this machine and installation, for `dmrac doctor`: each finds out one thing and changes nothing."""

import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from multiprocessing import get_context
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np

import async_dmrac
from configs.addresses import Addresses
from configs.realtime import RealtimeConfig
from onboard.c.compile import BuildError, compiler
from runtime.extras import EXTRAS, missing_modules
from runtime.kernel import request_realtime
from runtime.sockets import RECEIVE_BUFFER_BYTES, AddressInUseError, require_free

State = Literal["ok", "absent", "warning", "missing"]
"""absent: only the commands that use it do not run. warning: a flight runs, with a limit. missing: `dmrac fly` does not
run."""
FOR_A_FLIGHT: Final = ("offboard", "experiments")
"""Extras that `dmrac fly` needs."""
PERIOD_S: Final = 0.005
"""Of the onboard loop."""
WAKE_UPS: Final = 100
LATE_S: Final = 0.001
"""A loop that wakes later than this at p99 has little time left for a step."""
FREE_GB_LEAST: Final = 1.0
CLOCK_SOURCE: Final = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
RECEIVE_LIMIT: Final = Path("/proc/sys/net/core/rmem_max")
PURPOSE: Final = {
    "sim": "compiles the simulated vehicle; without it a flight takes several times longer",
    "mujoco": "dmrac sim --physics mujoco",
    "rotorpy": "dmrac sim --physics rotorpy, and a yardstick for dmrac bench core",
    "offboard": "the trainer",
    "experiments": "figures, reports, campaigns, tuning",
    "cluster": "campaigns on several machines",
    "viz": "the 3-D viewer",
    "export": "dmrac log export to Parquet, Foxglove, ROS 2 and TensorBoard",
    "completion": "dmrac completion",
    "gym": "the Gymnasium environments",
    "core": "a C compiler, where there is no other",
}
"""What each extra is for."""


class Finding(NamedTuple):
    """The result of one check."""

    name: str
    state: State
    detail: str
    remedy: str = ""


def examine(folder: Path) -> Iterator[Finding]:
    """Run all checks; yields each result as soon as it is known.

    Parameters
    ----------
    folder: where flights would be recorded.
    """
    yield Finding("program", "ok", f"async-dmrac {async_dmrac.__version__} in {Path(async_dmrac.__file__).parent}")
    yield Finding("Python", "ok", f"{platform.python_version()}, {sys.executable}")
    yield from map(_extra, EXTRAS)
    yield _compiler()
    yield _clock()
    yield from _of_the_loop()
    yield _ports()
    yield _receive_buffer()
    yield _disk(folder)


def _extra(name: str) -> Finding:
    """Which modules of an extra are installed, with their versions."""
    missing = missing_modules(name)
    there = ", ".join(f"{module} {_version_of(module)}" for module in EXTRAS[name] if module not in missing)
    if not missing:
        return Finding(f"extra {name}", "ok", there)
    detail = "; ".join(filter(None, (f"not installed: {', '.join(missing)}", there)))
    state: State = "missing" if name in FOR_A_FLIGHT else "absent"
    return Finding(f"extra {name}", state, f"{detail} ({PURPOSE[name]})", f"pip install 'async-dmrac[{name}]'")


def _version_of(module: str) -> str:
    """The version of the distribution that a module belongs to; "?" if it has no metadata."""
    for distribution in _distributions().get(module, ()):
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return "?"


@cache
def _distributions() -> Mapping[str, list[str]]:
    return packages_distributions()


def _compiler() -> Finding:
    try:
        command = compiler()
    except BuildError as error:
        return Finding("C compiler", "absent", "none (needed for --core c)", str(error))
    answer = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False, timeout=30)
    line = (answer.stdout or answer.stderr).strip().partition("\n")[0]
    if answer.returncode:
        return Finding("C compiler", "absent", f"{' '.join(command)}: {line}", "name another one in CC")
    return Finding("C compiler", "ok", f"{' '.join(command)}: {line}")


def _clock() -> Finding:
    resolution_ns = time.get_clock_info("monotonic").resolution * 1e9
    source = CLOCK_SOURCE.read_text(encoding="ascii").strip() if CLOCK_SOURCE.exists() else "unknown source"
    return Finding("clock", "ok", f"monotonic, {source}, resolution {resolution_ns:.0f} ns")


def _of_the_loop() -> list[Finding]:
    """What the kernel grants onboard's loop, and how late such a loop wakes: tried in a process that ends then."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(_loop_like_onboard).result()


def _loop_like_onboard() -> list[Finding]:
    return [*_priorities(), _wake_up()]


def _priorities() -> Iterator[Finding]:
    for grant in request_realtime(RealtimeConfig().priority):
        state: State = "ok" if grant.granted else "warning"
        yield Finding(grant.name, state, grant.detail, "" if grant.granted else "docs/realtime.md")


def _wake_up() -> Finding:
    """Lateness of sleeps to absolute deadlines, one period apart."""
    late_s = []
    deadline = time.monotonic()
    for _ in range(WAKE_UPS):
        deadline += PERIOD_S
        time.sleep(max(0.0, deadline - time.monotonic()))
        late_s.append(time.monotonic() - deadline)
        deadline = max(deadline, time.monotonic() - PERIOD_S)
    middle, high = np.quantile(late_s, (0.5, 0.99)) * 1e6
    detail = f"{WAKE_UPS} sleeps of 5 ms end late by {middle:.0f} us (p50), {high:.0f} us (p99)"
    if high > LATE_S * 1e6:
        return Finding("wake-up", "warning", detail, "other programs use the processor; a flight may miss ticks")
    return Finding("wake-up", "ok", detail)


def _ports() -> Finding:
    network = Addresses()
    addresses = network.bound_by_sim() | network.bound_by_onboard() | network.bound_by_offboard()
    for name, address in addresses.items():
        try:
            require_free({name: address})
        except AddressInUseError:
            return Finding("ports", "warning", f"{address} ({name}) is in use", "fly with --vehicle 2")
    ports = sorted(int(address.rpartition(":")[2]) for address in addresses.values())
    return Finding("ports", "ok", f"{', '.join(map(str, ports))} are free")


def _receive_buffer() -> Finding:
    if not RECEIVE_LIMIT.exists():
        return Finding("receive buffer", "ok", "limit unknown")
    limit = int(RECEIVE_LIMIT.read_text(encoding="ascii"))
    detail = f"{limit} bytes allowed, {RECEIVE_BUFFER_BYTES} wanted"
    if limit < RECEIVE_BUFFER_BYTES:
        return Finding("receive buffer", "warning", detail, f"sysctl -w net.core.rmem_max={RECEIVE_BUFFER_BYTES}")
    return Finding("receive buffer", "ok", detail)


def _disk(folder: Path) -> Finding:
    free_gb = shutil.disk_usage(folder).free / 1e9
    detail = f"{folder.resolve()}: {free_gb:.1f} GB free"
    if not os.access(folder, os.W_OK):
        return Finding("record", "missing", f"{detail}, not writable", "call dmrac in another folder, or give --out")
    if free_gb < FREE_GB_LEAST:
        return Finding("record", "warning", detail, "a minute of flight takes some 20 MB")
    return Finding("record", "ok", detail)
