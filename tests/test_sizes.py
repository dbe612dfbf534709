"""No file over 400 lines, no function over 60 without its docstring: what is longer wants to be two."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
OF_A_FILE, OF_A_FUNCTION = 400, 60
PACKAGES = (
    "async_dmrac",
    "configs",
    "experiments",
    "flight_log",
    "mambo",
    "offboard",
    "onboard",
    "protocol",
    "runtime",
)
FOLDERS = (*PACKAGES, "sim_vehicle", "docs_site", "examples", "tests")


def sources() -> Iterator[Path]:
    for folder in FOLDERS:
        for suffix in ("*.py", "*.c", "*.h"):
            yield from (path for path in (ROOT / folder).rglob(suffix) if "generated" not in path.parts)


def lines_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Without its docstring."""
    whole = (function.end_lineno or function.lineno) - function.lineno + 1
    first = function.body[0]
    is_text = (
        isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str)
    )
    return whole - ((first.end_lineno or first.lineno) - first.lineno + 1 if is_text else 0)


def long_functions(text: str) -> list[str]:
    functions = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    return [f"{one.name}: {lines_of(one)} lines" for one in functions if lines_of(one) > OF_A_FUNCTION]


def test_no_file_is_too_long() -> None:
    found = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in sources()}
    assert len(found) > 500
    assert {name: lines for name, lines in found.items() if lines > OF_A_FILE} == {}


def test_no_function_is_too_long() -> None:
    found = {str(path.relative_to(ROOT)): long_functions(path.read_text(encoding="utf-8"))
             for path in sources() if path.suffix == ".py" and path.relative_to(ROOT).parts[0] != "tests"}  # fmt: skip
    assert {name: functions for name, functions in found.items() if functions} == {}


@pytest.mark.parametrize(("lines", "found"), [(60, []), (61, ["f: 61 lines"])])
def test_a_function_over_the_limit_is_named(lines: int, found: list[str]) -> None:
    assert long_functions("def f():\n" + "    pass\n" * (lines - 1)) == found
