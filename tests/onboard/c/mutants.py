"""Plants bugs in a copy of the C core, one at a time, and reports which tests find them.

    python -m tests.onboard.c.mutants [NAME ...]

Each bug is a small change of one line: a sign, a gain, an index, or a state that is not brought up to date. The
tests of the room must fail with it, and pass without. It needs a C compiler.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[3]
COPIED: Final = (
    *("async_dmrac", "configs", "protocol", "onboard", "offboard", "sim_vehicle", "flight_log", "runtime"),
    *("experiments", "tests", "pyproject.toml"),
)
HERE: Final = "tests/onboard/c"
KINDS: Final = ("sign", "gain", "index", "stale")


class Mutant(NamedTuple):
    """A bug: in `file`, below onboard/c, the text `sound` becomes `wrong`."""

    kind: str
    file: str
    sound: str
    wrong: str
    test: str
    """File in this folder whose tests find it."""

    @property
    def name(self) -> str:
        """By which it is chosen on the command line."""
        return f"{self.file}:{self.kind}"


MUTANTS: Final = (
    Mutant(
        "sign",
        "numerics/elementary.c",
        "return real_sin(x) / real_cos(x);",
        "return -real_sin(x) / real_cos(x);",
        "test_elementary",
    ),
    Mutant(
        "index",
        "numerics/small_matrix.c",
        "left -= factor[j * n + i] * B[j * columns + c];",
        "left -= factor[i * n + j] * B[j * columns + c];",
        "test_control_blocks",
    ),
    Mutant("stale", "protocol/session.c", "        self->newest = sequence;\n", "", "test_authentication"),
    Mutant(
        "sign",
        "protocol/clock.c",
        "(now_ns - origin_ns) - (transmit_ns - receive_ns)",
        "(now_ns - origin_ns) + (transmit_ns - receive_ns)",
        "test_clocks",
    ),
    Mutant("stale", "protocol/transfer.c", "    self->received = 0;\n", "", "test_transfer"),
    Mutant("index", "protocol/blake2b.c", "m[s[14]], m[s[15]]", "m[s[15]], m[s[14]]", "test_authentication"),
    Mutant(
        "sign",
        "links/offboard.c",
        "whole_difference(message.pose.time_ns, clock->best.offset_ns)",
        "whole_sum(message.pose.time_ns, clock->best.offset_ns)",
        "test_link",
    ),
    Mutant("stale", "links/loss_rate.c", "    self->lost = statistics->lost;\n", "", "test_link"),
    Mutant(
        "sign",
        "estimation/error_state_filter.c",
        "f[2], -f[1], -f[2], zero, f[0]",
        "f[2], -f[1], -f[2], zero, -f[0]",
        "test_estimator_blocks",
    ),
    Mutant("stale", "estimation/state_history.c", "    stored->sums = self->sums;\n", "", "test_estimator_blocks"),
    Mutant(
        "gain",
        "estimation/imu_conditioning.c",
        "self->low[i] + VIBRATION_CORNER * high[i]",
        "self->low[i] + REAL(1.01) * VIBRATION_CORNER * high[i]",
        "test_estimator_blocks",
    ),
    Mutant(
        "stale",
        "estimation/pose_fusion.c",
        "        self->refused_in_a_row = 0;\n        self->used++;\n",
        "        self->used++;\n",
        "test_estimator",
    ),
    Mutant(
        "sign",
        "flight/guidance.c",
        "self->descent_m + self->descent_speed * lead_s",
        "self->descent_m - self->descent_speed * lead_s",
        "test_guidance",
    ),
    Mutant("gain", "flight/trajectory.c", "REAL(4.0) * s2 * th1 * th1", "REAL(2.0) * s2 * th1 * th1", "test_guidance"),
    Mutant(
        "stale",
        "flight/supervisor.c",
        "            self->since_ns[entry.event] = NEVER_NS;\n",
        "",
        "test_supervisor",
    ),
    Mutant("sign", "control/mixer.c", "base + second - turn", "base + second + turn", "test_control_blocks"),
    Mutant(
        "index",
        "control/actuators.c",
        "(command > now ? self->up : self->down)",
        "(command > now ? self->down : self->up)",
        "test_control_blocks",
    ),
    Mutant(
        "sign",
        "control/reference_model.c",
        "self->k2[i] * e_2[i] + gyration[i]",
        "self->k2[i] * e_2[i] - gyration[i]",
        "test_reference_model",
    ),
    Mutant("index", "control/feature_swap.c", "work->change, n, n - 1", "work->change, n, 0", "test_adaptive"),
    Mutant(
        "index",
        "control/cascade.c",
        "R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2]",
        "R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2]",
        "test_core",
    ),
    Mutant("stale", "control/laws/l1.c", "        self->rate[i] = v;\n", "", "test_laws"),
    Mutant("gain", "control/laws/kalman_last_layer.c", "REAL(2.0) * bh + bb", "bh + bb", "test_kalman"),
    Mutant(
        "index",
        "control/laws/last_layer.c",
        "i < 3 * (self->feature_count - 1)",
        "i < 3 * self->feature_count",
        "test_adaptive",
    ),
    Mutant("index", "control/laws/lap_table.c", "((first + 1) % bins)", "(first % bins)", "test_lap_laws"),
    Mutant("index", "sampling/sampler.c", "(place + 1) * self->period_ns", "place * self->period_ns", "test_sampling"),
    Mutant(
        "gain",
        "sampling/signal_vector.c",
        "self->share * (motor_thrusts[i] - *thrust)",
        "REAL(0.99) * self->share * (motor_thrusts[i] - *thrust)",
        "test_sampling",
    ),
    Mutant(
        "index",
        "record/tick.c",
        "put(at, target->feed_forward, 3)",
        "put(at, target->path.acceleration, 3)",
        "test_core",
    ),
    Mutant("stale", "core.c", "    self->mixer.scale = self->thrust_scale.value;\n", "", "test_core"),
    Mutant("stale", "core.c", "    self->missed_ticks = inputs->missed_ticks;\n", "", "test_core"),
    Mutant("index", "generated/modes.c", "table[mode][index]", "table[mode][0]", "test_supervisor"),
)


def copy_to(folder: Path) -> None:
    """What the tests of the C core need."""
    skipped = shutil.ignore_patterns("__pycache__")
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=skipped)
        else:
            shutil.copy(source, folder / name)


def run_tests(folder: Path, tests: Sequence[str]) -> str:
    """The first test that fails in the copy; "" if all pass."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    options = ["-q", "-x", "-p", "no:cacheprovider", "--timeout=3600", "-m", "not full and not realtime"]
    command = [sys.executable, "-m", "pytest", *options, *(f"{HERE}/{test}.py" for test in tests)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return ""
    found = re.search(rf"^(?:FAILED|ERROR) {HERE}/(\S+)", done.stdout, flags=re.MULTILINE)
    if found is None:
        raise RuntimeError(f"the tests did not run:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return found[1]


def try_mutant(folder: Path, mutant: Mutant) -> str:
    """The test that finds the bug, which is planted in the copy meanwhile; "" if none does."""
    path = folder / "onboard" / "c" / mutant.file
    sound = path.read_text(encoding="utf-8")
    path.write_text(sound.replace(mutant.sound, mutant.wrong), encoding="utf-8")
    try:
        return run_tests(folder, [mutant.test])
    finally:
        path.write_text(sound, encoding="utf-8")


def main(names: Sequence[str]) -> int:
    """Print a row for each bug; return 0, or 1 if one is not found."""
    chosen = [mutant for mutant in MUTANTS if not names or mutant.name in names]
    if not chosen or set(names) - {mutant.name for mutant in MUTANTS}:
        print(f"no such bug; allowed are {', '.join(mutant.name for mutant in MUTANTS)}", file=sys.stderr)
        return 2
    left = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        copy_to(folder)
        failed = run_tests(folder, sorted({mutant.test for mutant in chosen}))
        if failed:
            print(f"{failed} fails without a bug", file=sys.stderr)
            return 2
        print("| file | bug | sound | wrong | found by |\n|---|---|---|---|---|")
        for mutant in chosen:
            found = try_mutant(folder, mutant)
            left += not found
            texts = (" ".join(text.split()) for text in (mutant.sound, mutant.wrong))
            cells = (f"`{text}`" if text else "removed" for text in texts)
            print(f"| {mutant.file} | {mutant.kind} | {' | '.join(cells)} | {found or 'NOT FOUND'} |", flush=True)
    print(f"{len(chosen) - left} of {len(chosen)} bugs found")
    return int(left > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
