"""The stand-alone fuzz target of the link (fuzz/), built with the system's C compiler and run from a seed.

A longer run under the sanitizers: `python -m tests.onboard.c.test_link_target --datagrams 10000000 --seed 1`.
"""

import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from onboard.c.compile import FOLDER, WARNINGS, Variant, compiler, run
from protocol.statistics import REJECTIONS

HERE = Path(__file__).resolve().parent / "fuzz"
ROOMS = ("protocol", "links", "numerics")
SANITIZERS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def build(
    out: Path, *files: Path, options: tuple[str, ...] = SANITIZERS, command: tuple[str, ...] | None = None
) -> Path:
    """The target, and what of the core it needs, as a program."""
    sources = [path for room in ROOMS for path in sorted((FOLDER / room).glob("*.c"))]
    flags = [*Variant("double", options).flags, *WARNINGS, "-Werror", f"-I{HERE}"]
    run([*(command or compiler()), *flags, *map(str, (*sources, *files)), "-lm", "-o", str(out)])
    return out


def fuzz(program: Path, *arguments: object) -> dict[str, int]:
    """Run the program; its counts by name. Raises CalledProcessError with the report of a fault."""
    done = subprocess.run(
        [str(program), *map(str, arguments)], capture_output=True, text=True, check=False, cwd=program.parent
    )
    assert done.returncode == 0, f"{shlex.join(map(str, done.args))}\n{done.stderr[-4000:]}"
    counts = {name: int(count) for name, count in (line.split() for line in done.stdout.splitlines())}
    return {_named(name): count for name, count in counts.items()}


def _named(name: str) -> str:
    """rejected_5 to mac."""
    kind, _, number = name.rpartition("_")
    return REJECTIONS[int(number)] if kind == "rejected" and REJECTIONS[int(number)] != "duplicate" else name


@pytest.fixture(scope="module")
def plain_program() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        yield build(Path(folder) / "link_fuzz", *sorted(HERE.glob("*.c")), options=("-O2",))


def test_a_few_datagrams_reach_every_check(plain_program: Path) -> None:
    counts = fuzz(plain_program, "--datagrams", 60_000, "--seed", 1)
    assert counts["datagrams"] >= 60_000
    reached = {*REJECTIONS, "accepted", "poses", "chunks", "restarts", "sent"} - {""}
    assert min(counts[name] for name in reached) > 20, counts


def test_the_same_seed_gives_the_same_run(plain_program: Path) -> None:
    one, again = (fuzz(plain_program, "--datagrams", 3000, "--seed", 5) for _ in range(2))
    assert one == again
    assert one != fuzz(plain_program, "--datagrams", 3000, "--seed", 6)


def test_files_are_run(plain_program: Path, tmp_path: Path) -> None:
    for index, data in enumerate((b"", b"\x01", bytes(range(256)) * 20)):
        (tmp_path / str(index)).write_bytes(data)
    assert fuzz(plain_program, *sorted(tmp_path.iterdir()))["datagrams"] > 10


@pytest.mark.skipif(shutil.which("clang") is None, reason="clang is not installed")
def test_libfuzzer_takes_the_target(tmp_path: Path) -> None:
    options = ("-O1", "-g", "-fsanitize=fuzzer,address,undefined")
    program = build(tmp_path / "link_fuzz", HERE / "link_target.c", options=options, command=("clang",))
    done = subprocess.run([str(program), "-runs=2000", "-seed=1"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]


@pytest.mark.full
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", [1, 2])
def test_many_datagrams_under_the_sanitizers(tmp_path: Path, seed: int) -> None:
    if not Path(run([*compiler(), "-print-file-name=libasan.so"]).strip()).is_absolute():
        pytest.skip("the compiler has no sanitizers")
    program = build(tmp_path / "link_fuzz", *sorted(HERE.glob("*.c")))
    assert fuzz(program, "--datagrams", 100_000, "--seed", seed)["accepted"] > 10_000


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        print(fuzz(build(Path(place) / "link_fuzz", *sorted(HERE.glob("*.c"))), *sys.argv[1:]))
