"""The core compiles for a Cortex-M4F; docs/another_vehicle.md states its size."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from onboard.c.compile import sources
from onboard.c.generate import FOLDER

COMPILER = "arm-none-eabi-gcc"
OPTIONS = [
    *("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-std=c99", "-ffp-contract=off"),
    *("-fno-math-errno", "-Os", "-DDMRAC_FLOAT", "-DDMRAC_Q15_FEATURES", "-DPARAMETERS_MAX=4096", f"-I{FOLDER}"),
]
PAGE = Path(__file__).resolve().parents[2] / "docs" / "another_vehicle.md"
DRIFT = 0.2
"""By which another version of the compiler, or a new law, may change the sizes before the page must be corrected."""


def stated(row: str) -> int:
    found = re.search(rf"^\| {re.escape(row)} \| ([\d ]+) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None
    return int(found[1].replace(" ", ""))


def total(objects: list[Path]) -> tuple[int, int]:
    """Bytes of code and constants, and of variables."""
    printed = subprocess.run(["arm-none-eabi-size", *map(str, objects)], capture_output=True, text=True, check=True)
    rows = [list(map(int, line.split()[:3])) for line in printed.stdout.splitlines()[1:]]
    return sum(text + data for text, data, _ in rows), sum(bss for *_, bss in rows)


def test_it_compiles_and_has_the_stated_size(tmp_path: Path) -> None:
    if shutil.which(COMPILER) is None:
        pytest.skip(
            f"no {COMPILER}: install it (Debian and Ubuntu: apt install gcc-arm-none-eabi libnewlib-arm-none-eabi)"
        )
    variables = tmp_path / "variables.c"
    variables.write_text('#include "core.h"\nCore core;\nCoreOutput output;\n', encoding="utf-8")
    subprocess.run([COMPILER, *OPTIONS, "-c", *map(str, (*sources(), variables))], cwd=tmp_path, check=True)
    code, memory = total(sorted(tmp_path.glob("*.o")))
    assert abs(code / stated("code and constants") - 1.0) <= DRIFT
    assert abs(memory / stated("one `Core` and `CoreOutput`") - 1.0) <= DRIFT
