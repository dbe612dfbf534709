"""Builds the drone's library, `librsedu.so`, and the stand-in for the firmware that loads it.

Two targets: the drone's processor (armv5te, soft float, symbols not newer than GLIBC_2.4), and this machine, with the
same number type, for comparison. The build is kept in a cache folder named after a digest of sources and options.
"""

import contextlib
import hashlib
import importlib.util
import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

from configs.loader import ConfigError
from mambo.config import LibraryConfig
from mambo.image import settings_header, settings_record
from mambo.ranges import RangeTable, c_table
from mambo.vehicles import TargetName
from onboard.c import compile as core_build
from onboard.c.compile import FOLDER as CORE_FOLDER
from onboard.c.config_table import table
from onboard.c.generate import check, record_header, record_source
from onboard.c.library import cache_folder
from onboard.config import OnboardConfig

LIBRARY: Final = "librsedu.so"
FIRMWARE: Final = "firmware"
FOLDER: Final = Path(__file__).resolve().parent
PARAMETERS_MAX: Final = 8192
"""Numbers of the inner layers of a channel: 21-64-64-32 has 7648."""
SIZE_MAX_BYTES: Final = 1_000_000
"""Of the library's file."""
RAM_MAX_BYTES: Final = 8_000_000
GLIBC_MAX: Final = (2, 4)
"""Newest version of a symbol that the drone's C library has."""
SHARED: Final = ("-shared", "-s", "-Wl,-z,defs", "-Wl,--gc-sections", f"-Wl,-soname,{LIBRARY}")
"""To link the library. What nobody defines would be found when the firmware loads it: the linker finds it before."""
ARM_GCC: Final = "arm-linux-gnueabi-gcc"
ARM_ROOT: Final = "/usr/arm-linux-gnueabi"
"""Where Debian has the C library of the target, for qemu."""
INSTALL_HINT: Final = (
    "install one (Debian and Ubuntu: apt install gcc-arm-linux-gnueabi libc6-dev-armel-cross; "
    "any system: pip install ziglang)"
)


class Target(NamedTuple):
    """A processor, and the compiler for it."""

    name: TargetName
    compiler: tuple[str, ...]
    options: tuple[str, ...]


class Built(NamedTuple):
    """The files of a build."""

    target: Target
    library: Path
    firmware: Path


def arm_target() -> Target:
    """The drone. Raises BuildError without a cross compiler."""
    options = ("-march=armv5te", "-marm", "-mfloat-abi=soft")
    if shutil.which(ARM_GCC):
        return Target("arm", (ARM_GCC,), options)
    if importlib.util.find_spec("ziglang"):
        return zig_target()
    raise core_build.BuildError(f"no compiler for the drone's processor ({ARM_GCC}, ziglang): {INSTALL_HINT}")


def zig_target() -> Target:
    """The drone, with the compiler of the Python package ziglang."""
    command = (sys.executable, "-m", "ziglang", "cc", "-target", "arm-linux-gnueabi.2.4", "-mcpu=arm926ej_s")
    return Target("arm", command, ())


def native_target() -> Target:
    """The machine that runs this. Raises BuildError without a C compiler."""
    return Target("native", tuple(core_build.compiler()), ())


def target_named(name: TargetName) -> Target:
    """A target by its name. Raises BuildError."""
    return arm_target() if name == "arm" else native_target()


def sources() -> list[Path]:
    """The C files of the library, without those of the core."""
    return sorted((FOLDER / "library").glob("*.c"))


def generated() -> dict[str, str]:
    """The C files that follow from the Python records, by name: settings and ranges."""
    record = settings_record()
    ranges = '#include "ranges.h"\n\n' + c_table("settings", RangeTable(record, LibraryConfig))
    return {
        "settings.h": record_header(record, "settings"),
        "settings.c": record_source(record, "settings", settings_header()),
        "ranges.c": ranges + c_table("core", RangeTable(table(), OnboardConfig)),
    }


def flags(target: Target, generated_root: Path) -> list[str]:
    """Options of the compiler, but for the output. `generated_root` holds the folder `generated`."""
    includes = [f"-I{path}" for path in (FOLDER / "library", CORE_FOLDER, generated_root)]
    whole = ["-DDMRAC_Q15_FEATURES", "-DDMRAC_WHOLE_COVARIANCE"]
    numbers = ["-DDMRAC_FLOAT", *whole, f"-DPARAMETERS_MAX={PARAMETERS_MAX}"]
    hidden = ["-fPIC", "-fvisibility=hidden", "-ffunction-sections", "-fdata-sections"]
    return [*core_build.LANGUAGE, *numbers, "-O2", "-g0", *hidden, *target.options, *includes]


def build(name: TargetName) -> Built:
    """Library and stand-in for a target, compiled unless they are in the cache. Raises BuildError."""
    target = target_named(name)
    folder = cache_folder() / f"mambo-{target.name}-{_digest(target)}"
    built = Built(target, folder / LIBRARY, folder / FIRMWARE)
    if not (built.library.exists() and built.firmware.exists()):
        _compile(target, folder)
    return built


def _digest(target: Target) -> str:
    digest = hashlib.sha256(repr((target, flags(target, Path()), SHARED)).encode())
    for name, text in generated().items():
        digest.update(name.encode() + text.encode())
    own = [*sorted(FOLDER.glob("*/*.c")), *sorted(FOLDER.glob("*/*.h"))]
    for path in (*own, *core_build.sources(), *core_build.headers()):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _compile(target: Target, folder: Path) -> None:
    check()
    part = folder.with_name(f"{folder.name}.{os.getpid()}")
    part.mkdir(parents=True)
    with TemporaryDirectory() as root:  # not in the cache, which lies below the core's sources
        texts = Path(root) / "generated"
        texts.mkdir()
        for name, text in generated().items():
            (texts / name).write_text(text, encoding="utf-8")
        compile_command = [*target.compiler, *flags(target, Path(root)), *core_build.WARNINGS]
        own = map(str, (*sources(), *sorted(texts.glob("*.c"))))
        core = _core_objects(target)
        core_build.run([*compile_command, *SHARED, *own, *core, "-lm", "-o", str(part / LIBRARY)])
        stand_in = map(str, sorted((FOLDER / "fake").glob("*.c")))
        linked = ["-rdynamic", *stand_in, "-ldl", "-lpthread"]
        core_build.run([*compile_command, *linked, "-o", str(part / FIRMWARE)])
    with contextlib.suppress(OSError):  # another process was faster
        part.rename(folder)
    shutil.rmtree(part, ignore_errors=True)


def compile_stand_in(target: Target, firmware: Path, linker_map: Path) -> None:
    """The stand-in with the library inside, as one static program, and the linker's map. Raises BuildError."""
    compile_inside(target, firmware, ("-static", f"-Wl,-Map={linker_map}"))


def compile_inside(target: Target, firmware: Path, linked: tuple[str, ...]) -> None:
    """The stand-in with the library inside, as one program. linked: options of the linker. Raises BuildError."""
    with TemporaryDirectory() as root:
        texts = Path(root) / "generated"
        texts.mkdir()
        for name, text in generated().items():
            (texts / name).write_text(text, encoding="utf-8")
        compile_command = [*target.compiler, *flags(target, Path(root)), "-DLIBRARY_INSIDE"]
        named = [(path, f"{root}/library-{path.stem}.o") for path in sources() if path.stem != "clock"]
        named += [(path, f"{root}/{path.stem}.o") for path in texts.glob("*.c")]
        named.append((FOLDER / "fake" / "firmware.c", f"{root}/firmware.o"))
        for path, out in named:
            core_build.run([*compile_command, "-c", str(path), "-o", out])
        objects = [out for _, out in named]
        objects += [*_core_objects(target), "-lm", "-ldl", "-lpthread"]
        core_build.run([*target.compiler, *target.options, *linked, *objects, "-o", str(firmware)])


def _core_objects(target: Target) -> list[str]:
    """The compiled files of the core, in a cache of their own: the library's own files change more often."""
    options = flags(target, Path("nowhere"))  # the core needs nothing of what the library generates
    digest = hashlib.sha256(repr((target, options)).encode())
    for path in (*core_build.sources(), *core_build.headers()):
        digest.update(str(path.relative_to(CORE_FOLDER)).encode() + path.read_bytes())
    folder = cache_folder() / f"mambo-core-{target.name}-{digest.hexdigest()[:16]}"
    names = [f"{path.relative_to(CORE_FOLDER).with_suffix('')}".replace("/", "-") for path in core_build.sources()]
    if not folder.exists():
        part = folder.with_name(f"{folder.name}.{os.getpid()}")
        part.mkdir()
        for path, name in zip(core_build.sources(), names, strict=True):
            core_build.run(
                [*target.compiler, *options, *core_build.WARNINGS, "-c", str(path), "-o", f"{part}/{name}.o"]
            )
        with contextlib.suppress(OSError):
            part.rename(folder)
        shutil.rmtree(part, ignore_errors=True)
    return [f"{folder}/{name}.o" for name in names]


def run_command(built: Built, arguments: Sequence[str] = ()) -> list[str]:
    """The command that runs the stand-in: under qemu-arm if it is for the drone. Raises ConfigError without qemu."""
    command = [str(built.firmware), str(built.library), *arguments]
    if built.target.name == "native":
        return command
    qemu = shutil.which("qemu-arm")
    if qemu is None:
        raise ConfigError("no qemu-arm: install it (Debian and Ubuntu: apt install qemu-user)")
    root = os.environ.get("QEMU_LD_PREFIX", ARM_ROOT)
    return [qemu, "-L", root, *command]
