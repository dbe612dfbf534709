"""The build: no warning, no forgotten field, the same layout in C and Python, a clear error without a compiler."""

import ctypes
import re
import shutil
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from configs.loader import ConfigRecord
from experiments.flights.scenario import Choices, resolve
from onboard.c import config_table, generate
from onboard.c.compile import FOLDER, LANGUAGE, WARNINGS, BuildError, Variant, compiler, headers, run, sources
from onboard.c.config_table import Leaf, OneOf, Record, Several, TableError, image, record_of, table
from onboard.c.declarations import DeclarationError, Declarations
from onboard.c.library import Core, cached_library, compile_library


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("command", ["gcc", "clang"])
def test_no_warning(command: str, real: str, tmp_path: Path) -> None:
    if shutil.which(command) is None:
        pytest.skip(f"{command} is not installed")
    flags = [*Variant(real).flags, *WARNINGS, "-Werror", "-fsyntax-only"]
    run([command, *flags, *map(str, sources())])


def test_without_a_compiler_the_error_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no_such_compiler")
    with pytest.raises(BuildError, match=r"CC names no_such_compiler"):
        compiler()
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(BuildError, match=r"tried cc, gcc, clang.*apt install gcc.*pip install ziglang"):
        compiler()


def test_a_failed_build_shows_the_compilers_message(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="no_such_option"):
        compile_library(Variant("double", ("-no_such_option",)), tmp_path / "core.so")


def test_every_header_stands_alone_and_every_source_is_c99() -> None:
    for path in headers():
        run([*compiler(), *LANGUAGE, *WARNINGS, "-Werror", f"-I{FOLDER}", "-fsyntax-only", "-xc", str(path)])


def test_nothing_in_the_core_touches_the_world_or_the_heap() -> None:
    """No global variable, no heap, no file, clock or input and output: what the object files need and define."""
    allowed = {"sqrt", "sqrtf", "memcpy", "memcmp", "memmove", "memset"}
    ours = {name for path in headers() for name in re.findall(r"(\w+)\(", path.read_text(encoding="utf-8"))}
    for path in sources():
        text = path.read_text(encoding="utf-8")
        body = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
        used = set(re.findall(r"#include <(\w+)\.h>", text))
        assert used <= {"string", "math", "stdbool", "stdint", "stddef"}, path
        writable = re.findall(r"^(?:static )?(?!const|typedef|static const)\w+ \w+(?:\[.*\])? = ", body, flags=re.M)
        assert not writable, (path, writable)
    done = run(["nm", "-u", str(cached_library(Variant()))])
    needed = {line.split()[-1].split("@")[0] for line in done.splitlines()}
    foreign = {name for name in needed if not name.startswith("_")} - allowed - ours
    assert not foreign


def test_structures_have_the_same_layout_in_c(core: Core, core32: Core, tmp_path: Path) -> None:
    for one in (core, core32):
        kinds = {name: kind for name, kind in vars(one).items() if _is_structure(kind)}
        assert len(kinds) >= 8
        lines = [f'#include "{path.relative_to(FOLDER)}"' for path in headers()]
        lines += ["#include <stdio.h>", "#include <stddef.h>", "int main(void) {"]
        for name, kind in kinds.items():
            lines.append(f'printf("{name} %zu", sizeof({name}));')
            lines += [f'printf(" %zu", offsetof({name}, {field}));' for field, _ in kind._fields_]
            lines.append('printf("\\n");')
        program = tmp_path / f"layout_{one.real}"
        program.with_suffix(".c").write_text("\n".join([*lines, "return 0; }"]))
        run([*compiler(), *Variant(one.real).flags, str(program.with_suffix(".c")), "-o", str(program)])
        for line in run([str(program)]).splitlines():
            name, size, *offsets = line.split()
            assert int(size) == ctypes.sizeof(kinds[name]), name
            assert [int(at) for at in offsets] == [getattr(kinds[name], f).offset for f, _ in kinds[name]._fields_]


def _is_structure(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, ctypes.Structure)


# --- the table of the configuration ---


def test_the_generated_files_are_up_to_date_and_all_fields_are_read() -> None:
    generate.check()


def test_a_record_that_changes_fails_the_build(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    extended = Record("CoreConfig", (*table().fields, config_table.Field("new_gain", Leaf("real"), "1/s", float)))
    monkeypatch.setattr(generate, "table", lambda: extended)
    with pytest.raises(TableError, match=r"config\.h does not fit.*python -m onboard\.c\.generate"):
        compile_library(Variant(), tmp_path / "core.so")
    monkeypatch.setattr(generate, "files", dict)  # as if the files had been written again
    with pytest.raises(TableError, match=r"no C file reads CoreConfig\.new_gain"):
        compile_library(Variant(), tmp_path / "core.so")


class _Text(ConfigRecord):
    name: str


class _Long(ConfigRecord):
    values: tuple[float, ...]


class _Choice(ConfigRecord):
    kind: Literal["a"]
    on_loss: Literal["hold", "continue"]


def test_a_field_that_c_cannot_have_is_named() -> None:
    with pytest.raises(TableError, match=r"_Text\.name.*allowed are numbers"):
        record_of(_Text)
    with pytest.raises(TableError, match=r"_Long\.values.*max_length"):
        record_of(_Long)
    leaf = record_of(_Choice).fields[0].node
    assert leaf.pack("continue") == (1).to_bytes(8, "little")


def onboard_config(scenario: str = "figure8_wind", controller: str = "dmrac") -> Any:
    return resolve(scenario, Choices(controller=controller)).onboard


def test_the_image_arrives_as_it_was_packed(core: Core, core32: Core) -> None:
    config = onboard_config()
    for one in (core, core32):
        decoded = one.CoreConfig()
        packed = image(config)
        assert one.config_decode(_bytes(packed), len(packed), decoded)
        rounded = (lambda x: x) if one.real == "double" else (lambda x: ctypes.c_float(x).value)
        _compare(table(), decoded, config, rounded)


def _bytes(packed: bytes) -> Any:
    return (ctypes.c_uint8 * len(packed)).from_buffer_copy(packed)


def _compare(node: Any, ours: Any, theirs: Any, rounded: Any) -> None:
    match node:
        case Record():
            for field in node.fields:
                value, member = field.get(theirs), getattr(ours, field.name)
                if isinstance(field.node, Several):
                    if field.node.counted:
                        assert getattr(ours, f"{field.name}_count") == len(value)
                    for index, one in enumerate(value):
                        _compare(field.node.of, member[index], one, rounded)
                else:
                    _compare(field.node, member, value, rounded)
        case OneOf():
            kind, record = node.members[ours.kind]
            assert kind == theirs.kind
            if record.fields:
                _compare(record, getattr(ours, kind), theirs, rounded)
        case Several():
            for index, one in enumerate(theirs):
                _compare(node.of, ours[index], one, rounded)
        case Leaf():
            expected = node.choices.index(theirs) if node.choices else theirs
            assert ours == (rounded(expected) if node.c_type == "real" else expected)


def test_an_image_of_another_layout_or_size_is_refused(core: Core) -> None:
    packed = image(onboard_config())
    for bad in (packed[:-8], packed + bytes(8), b"X" + packed[1:], packed[:5] + bytes(1) + packed[6:]):
        if bad != packed:
            assert not core.config_decode(_bytes(bad), len(bad), core.CoreConfig())


# --- the headers as ctypes sees them ---


def test_what_a_header_may_not_say_is_an_error() -> None:
    for text in (
        "int x;",
        "typedef struct { int a, b; } B;",
        "typedef struct { unknown a; } B;",
        "void f(int (*g)(int));",
    ):
        with pytest.raises(DeclarationError):
            Declarations(text)


def test_arrays_of_another_type_are_refused(core: Core) -> None:
    with pytest.raises(ctypes.ArgumentError):
        core.vector_zero(np.zeros(3, np.float32))
    with pytest.raises(ctypes.ArgumentError):
        core.vector_zero(np.zeros((3, 2))[:, 0])
