"""Metadata of a log: versions, start time, and the clock of its times."""

import platform
import time
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("async-dmrac", "numpy", "mcap", "torch", "numba", "mujoco-core", "rotorpy")


def describe_process() -> dict[str, str]:
    """Versions of Python, system and packages, the time at which logging started, and the name of the clock."""
    found = {
        "clock": monotonic_clock_name(),
        "started_utc": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "started_monotonic_ns": str(time.monotonic_ns()),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
    }
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def monotonic_clock_name() -> str:
    """Name of this machine's monotonic clock since boot: logs with the same name share a time base."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        boot = platform.node()
    return f"monotonic/{boot}"
