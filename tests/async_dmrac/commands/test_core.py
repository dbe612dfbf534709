"""`dmrac core build`: what it builds with, and what it says where it cannot."""

import shutil
import sys
from pathlib import Path

import pytest

from async_dmrac.command_line import main
from onboard.c import compile as compiling
from onboard.c import library
from onboard.c.compile import DEFAULT, BuildError, Variant, compile_core, compiler, prebuilt_name, preprocessed_headers


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "cache_folder", lambda: tmp_path)


def needs_a_compiler() -> None:
    try:
        compiler()
    except BuildError as error:
        pytest.skip(str(error))


def test_it_builds_once_and_then_takes_what_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    needs_a_compiler()
    assert main(["core", "build", "--precision", "float"]) == 0
    assert "float  built now by " in capsys.readouterr().out
    assert main(["core", "build", "--precision", "float"]) == 0
    assert "float  was built before: " in capsys.readouterr().out


def test_the_library_of_a_wheel_needs_no_compiler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    needs_a_compiler()
    place = tmp_path / f"{prebuilt_name(DEFAULT)}.so"
    compile_core(DEFAULT, place)
    place.with_suffix(compiling.DECLARED).write_text(preprocessed_headers(DEFAULT), encoding="utf-8")
    monkeypatch.setattr(library, "PREBUILT", tmp_path)
    monkeypatch.setenv("CC", "no_such_compiler")
    assert main(["core", "build", "--precision", "double"]) == 0
    assert "double came with the installation: " in capsys.readouterr().out
    monkeypatch.setattr(library, "prebuilt_name", lambda variant: "of other sources")
    assert main(["core", "build", "--precision", "double"]) == 2
    assert "CC names no_such_compiler" in capsys.readouterr().err


def test_without_any_compiler_the_error_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["core", "build"]) == 2
    shown = capsys.readouterr().err
    assert "dmrac core: no C compiler (tried cc, gcc, clang and the package ziglang)" in shown
    assert "pip install ziglang" in shown


def test_a_compiler_that_does_not_work_is_quoted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken-cc"
    broken.write_text("#!/bin/sh\necho this compiler is broken >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    assert main(["core", "build"]) == 2
    assert "this compiler is broken" in capsys.readouterr().err


def test_ziglang_is_taken_where_there_is_no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    assert compiler()[:4] == [sys.executable, "-m", "ziglang", "cc"]


@pytest.mark.full
def test_ziglang_builds_the_core(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ziglang", reason="the extra `core` is not installed")
    monkeypatch.setenv("CC", f"{sys.executable} -m ziglang cc -mcpu=baseline")
    built = library.ready_library(Variant("float"))
    assert (built.origin, built.path.exists()) == ("built", True)
    assert library.load.__wrapped__(Variant("float")).real == "float"


def test_bad_words(capsys: pytest.CaptureFixture[str]) -> None:
    for words, expected in (
        (["core"], "action"),
        (["core", "clean"], "clean"),
        (["core", "build", "--precision", "half"], "half"),
    ):
        with pytest.raises(SystemExit):
            main(words)
        assert expected in capsys.readouterr().err
