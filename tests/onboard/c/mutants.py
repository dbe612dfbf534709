"""Plants bugs in a copy of the C core, one at a time, and reports which tests find them.

    python -m tests.onboard.c.mutants [NAME ...]

Each bug is a small change of one line: a sign, a gain, an index, or a state that is not brought up to date. The
tests of the room must fail with it, and pass without. It needs a C compiler.
"""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

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
        "test_features",
    ),
    Mutant("stale", "protocol/session.c", "        self->newest = sequence;\n", "", "test_link"),
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
    Mutant("stale", "links/loss_rate.c", "    self->lost = statistics->lost;\n", "", "test_clocks"),
    Mutant(
        "sign",
        "estimation/error_state_filter.c",
        "f[2], -f[1], -f[2], zero, f[0]",
        "f[2], -f[1], -f[2], zero, -f[0]",
        "test_estimator_blocks",
    ),
    Mutant("stale", "estimation/error_state_filter.c", "    make_symmetric(self->P);\n", "", "test_estimator_blocks"),
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
    Mutant("index", "control/feature_swap.c", "work->change, n, n - 1", "work->change, n, 0", "test_features"),
    Mutant(
        "index",
        "control/cascade.c",
        "R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2]",
        "R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2]",
        "test_core",
    ),
    Mutant("stale", "control/laws/l1.c", "        self->rate[i] = v;\n", "", "test_laws"),
    Mutant("gain", "control/laws/kalman_last_layer.c", "REAL(2.0) * bh + bb", "bh + bb", "test_kalman"),
    Mutant("sign", "control/laws/path_gap.c", "(m - kept - t * (", "(m - kept + t * (", "test_kalman"),
    Mutant(
        "stale",
        "control/laws/forecast_skill.c",
        "        self->slow_map[axis] += share * fast_map;\n",
        "",
        "test_kalman",
    ),
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
    Mutant("sign", "flight/path_turn.c", "- stretch * out->rate[i]", "+ stretch * out->rate[i]", "test_guidance"),
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


class Copy:
    """A copy of what the tests of the C core need, with a library of the core for each precision.

    A bug is planted in one file; that file alone is compiled anew. The libraries stand where those of a wheel do.
    """

    def __init__(self, folder: Path) -> None:
        """Raises BuildError if the core cannot be built."""
        self.folder = folder
        for name in COPIED:
            source, skipped = ROOT / name, shutil.ignore_patterns("__pycache__", "prebuilt")
            if source.is_dir():
                shutil.copytree(source, folder / name, ignore=skipped)
            else:
                shutil.copy(source, folder / name)
        spec = importlib.util.spec_from_file_location("compile_of_copy", folder / "onboard" / "c" / "compile.py")
        assert spec is not None
        assert spec.loader is not None
        self._compile = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(self._compile)
        self._compile.PREBUILT.mkdir()
        self._objects = {variant: self._compiled(variant, self._compile.sources()) for variant in self._variants}
        self._link(self._objects)

    @property
    def _variants(self) -> tuple[Any, ...]:
        return self._compile.DEFAULT, self._compile.DEFAULT._replace(real="float")

    def _compiled(self, variant: Any, paths: Sequence[Path]) -> dict[Path, Path]:
        """The object file of each source."""
        place = Path(tempfile.mkdtemp(dir=self.folder))
        objects = {path: place / f"{index}.o" for index, path in enumerate(paths)}
        for path, target in objects.items():
            command = [*self._compile.compiler(), *variant.flags, "-fPIC", "-c", str(path), "-o", str(target)]
            self._compile.run(command)
        return objects

    def _link(self, objects: dict[Any, dict[Path, Path]]) -> None:
        """A library of each precision, under the name of the present sources."""
        for variant, files in objects.items():
            out = self._compile.PREBUILT / f"{self._compile.prebuilt_name(variant)}.so"
            shared = ["-shared", "-Wl,-Bsymbolic", *map(str, files.values()), "-lm", "-o", str(out)]
            self._compile.run([*self._compile.compiler(), *shared])
            declared = self._compile.preprocessed_headers(variant)
            out.with_suffix(self._compile.DECLARED).write_text(declared, encoding="utf-8")

    def failing(self, tests: Sequence[str]) -> str:
        """The first test that fails, of files or tests in this folder; "" if all pass."""
        environment = {**os.environ, "PYTHONPATH": str(self.folder)}
        options = ["-q", "-x", "-p", "no:cacheprovider", "--timeout=3600", "-m", "not full and not realtime"]
        command = [sys.executable, "-m", "pytest", *options, *(f"{HERE}/{test}" for test in tests)]
        done = subprocess.run(command, cwd=self.folder, env=environment, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return ""
        found = re.search(rf"^(?:FAILED|ERROR) {HERE}/(\S+)", done.stdout, flags=re.MULTILINE)
        if found is None:
            raise RuntimeError(f"the tests did not run:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
        return found[1]

    def finds(self, mutant: Mutant) -> str:
        """The test that finds the bug, which is planted meanwhile; "" if none does."""
        path = self.folder / "onboard" / "c" / mutant.file
        sound = path.read_text(encoding="utf-8")
        path.write_text(sound.replace(mutant.sound, mutant.wrong), encoding="utf-8")
        try:
            changed = {one: files | self._compiled(one, [path]) for one, files in self._objects.items()}
            self._link(changed)
            return self.failing([f"{mutant.test}.py"])
        finally:
            path.write_text(sound, encoding="utf-8")


def main(names: Sequence[str]) -> int:
    """Print a row for each bug; return 0, or 1 if one is not found."""
    chosen = [mutant for mutant in MUTANTS if not names or mutant.name in names]
    if set(names) - {mutant.name for mutant in MUTANTS}:
        print(f"no such bug; allowed are {', '.join(mutant.name for mutant in MUTANTS)}", file=sys.stderr)
        return 2
    finders = set()
    with tempfile.TemporaryDirectory() as temporary:
        copy = Copy(Path(temporary))
        print("| file | bug | sound | wrong | found by |\n|---|---|---|---|---|", flush=True)
        for mutant in chosen:
            found = copy.finds(mutant)
            finders.add(found)
            texts = (" ".join(text.split()) for text in (mutant.sound, mutant.wrong))
            cells = (f"`{text}`" if text else "removed" for text in texts)
            print(f"| {mutant.file} | {mutant.kind} | {' | '.join(cells)} | {found or 'NOT FOUND'} |", flush=True)
        failing = copy.failing(sorted(finders - {""})) if finders - {""} else ""
    if failing:
        print(f"{failing} fails without a bug, so it shows nothing", file=sys.stderr)
        return 2
    print("none of these tests fails without a bug" if "" not in finders else "not all bugs are found")
    return int("" in finders)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
