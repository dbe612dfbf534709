"""A stand-in whose cycles are counted: a static program for the drone's processor, under qemu-arm with a plugin."""

import shutil
import subprocess
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from mambo.build import FOLDER, Built, build, compile_stand_in
from mambo.cycles.blocks import BLOCKS, address_ranges
from onboard.c import compile as core_build
from onboard.c.compile import BuildError
from protocol.conventions import Array

CLOCK_HZ: Final = 416e6
"""The drone's processor. 312 and 800 MHz are claimed, too; only hardware can tell."""
PERIOD_S: Final = 0.005
PERIOD_CYCLES: Final = CLOCK_HZ * PERIOD_S
SHARE_MAX: Final = 0.5
"""Of the period, at the 99th percentile: the firmware needs the rest."""


class Counter(NamedTuple):
    """Files of a stand-in that counts."""

    built: Built
    plugin: Path
    table: Path
    """Address ranges, for the plugin."""
    counts: Path
    """What the plugin writes."""

    def command(self, _: Built) -> list[str]:
        """The command that runs it. Raises BuildError without qemu-arm."""
        qemu = shutil.which("qemu-arm")
        if qemu is None:
            raise BuildError("no qemu-arm: install it (Debian and Ubuntu: apt install qemu-user)")
        plugin = f"{self.plugin},map={self.table},out={self.counts}"
        return [qemu, "-plugin", plugin, str(self.built.firmware), str(self.built.library)]

    def cycles(self) -> Array:
        """[calls, blocks + 1]: cycles of each block, and instructions, of each call so far."""
        numbers = np.fromfile(self.counts, dtype="<u8").reshape(-1, len(BLOCKS) + 1)
        return numbers.astype(np.float64)


def build_counter(folder: Path) -> Counter:
    """Build stand-in, plugin and table into a folder. Raises BuildError."""
    built = build("arm")
    firmware, linker_map = folder / "firmware", folder / "firmware.map"
    compile_stand_in(built.target, firmware, linker_map)
    plugin = folder / "count.so"
    source = FOLDER / "cycles" / "count.c"
    core_build.run([*core_build.compiler(), "-std=gnu99", "-O2", "-shared", "-fPIC", str(source), "-o", str(plugin)])
    table = folder / "table.txt"
    table.write_text(_table(firmware, linker_map.read_text(encoding="utf-8")), encoding="utf-8")
    return Counter(built._replace(firmware=firmware), plugin, table, folder / "counts.bin")


def _table(firmware: Path, linker_map: str) -> str:
    listed = subprocess.run(["nm", str(firmware)], capture_output=True, text=True, check=True).stdout
    address = {line.split()[2]: line.split()[0] for line in listed.splitlines() if len(line.split()) == 3}
    lines = [f"begin {address['RSEDU_control']}", f"end {address['firmware_call_ended']}"]
    lines += [f"{start:x} {end:x} {block}" for start, end, block in address_ranges(linker_map)]
    return "\n".join(lines) + "\n"
