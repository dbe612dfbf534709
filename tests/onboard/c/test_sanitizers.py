"""The tests of this folder again, with the core under the address and undefined behaviour sanitizers."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from onboard.c.compile import compiler, run

HERE = Path(__file__).resolve().parent
LEFT_OUT = ("test_sanitizers.py", "test_build.py", "test_link_target.py")


@pytest.mark.full
@pytest.mark.timeout(1200)
@pytest.mark.skipif(os.environ.get("DMRAC_TEST_SANITIZED") == "1", reason="is running")
def test_the_core_under_sanitizers() -> None:
    preload = [run([*compiler(), f"-print-file-name={name}"]).strip() for name in ("libasan.so", "libubsan.so")]
    if not all(Path(path).is_absolute() for path in preload):
        pytest.skip("the compiler has no sanitizers")
    environment = {
        **os.environ,
        "DMRAC_TEST_SANITIZED": "1",
        "LD_PRELOAD": " ".join(preload),
        "ASAN_OPTIONS": "detect_leaks=0",  # of the interpreter, not of the core
    }
    ignored = [f"--ignore={HERE / name}" for name in LEFT_OUT]
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-x",
        "-p",
        "no:xdist",
        "-p",
        "no:cacheprovider",
        "-m",
        "not full",
        str(HERE),
        *ignored,
    ]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
