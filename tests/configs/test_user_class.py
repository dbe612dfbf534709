"""A class of a user's own is found by module, by file and in the session, and everything that can be wrong is named."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from configs.user_class import find_class, name_of, with_absolute_file

SOURCE = """
from helper import SIZE

class Mine:
    size = SIZE
"""


@pytest.fixture
def file(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "helper.py").write_text("SIZE = 1\n")
    path = tmp_path / "my_file.py"
    path.write_text(SOURCE)
    yield path
    sys.modules.pop("helper", None)


def test_a_class_in_a_file_is_found_without_a_python_path_and_its_neighbours_too(file: Path) -> None:
    path = list(sys.path)
    found = find_class(f"{file}:Mine")
    assert found.size == 1
    assert find_class(f"{file}:Mine") is found
    assert name_of(found) == f"{file}:Mine"
    assert sys.path == path


def test_a_changed_file_is_read_again(file: Path) -> None:
    before = find_class(f"{file}:Mine")
    file.write_text(SOURCE.replace("size = SIZE", "size = 7"))
    os.utime(file, ns=(1, 1))
    after = find_class(f"{file}:Mine")
    assert (before.size, after.size) == (1, 7)


def test_a_class_of_this_session_is_found_in_it_and_the_newest_counts() -> None:
    def define(size: int) -> type:
        class Local:
            value = size

        return Local

    first = define(1)
    assert name_of(first) == "this_session:Local"
    assert find_class("this_session:Local") is first
    second = define(2)
    assert find_class(name_of(second)) is second


def test_a_module_class_keeps_its_name() -> None:
    assert name_of(Path) == "pathlib:Path" or name_of(Path).endswith("pathlib.py:Path")
    assert find_class("pathlib:Path") is Path
    assert find_class(name_of(Path)) is Path


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere.py:Mine", "there is no file .*nowhere.py"),
        ("no_such_module:Mine", "No module named 'no_such_module'"),
        ("pathlib:Mine", "no attribute 'Mine'"),
        ("this_session:Elsewhere", "defined in another Python session; write it into a file"),
    ],
)
def test_a_class_that_is_not_there_is_named(name: str, message: str) -> None:
    with pytest.raises(ImportError, match=message):
        find_class(name)


@pytest.mark.parametrize("text", ["1 / 0", "class Mine", "import no_such_thing"])
def test_a_file_that_cannot_be_imported_says_why_and_leaves_nothing(tmp_path: Path, text: str) -> None:
    path = tmp_path / "broken.py"
    path.write_text(text)
    known = set(sys.modules)
    with pytest.raises(ImportError, match=r"division by zero|SyntaxError|no_such_thing"):
        find_class(f"{path}:Mine")
    assert not {name for name in set(sys.modules) - known if "broken" in name}


def test_a_relative_file_counts_from_the_folder_of_its_yaml_file(tmp_path: Path) -> None:
    tree = with_absolute_file({"class": "mine.py:Mine", "settings": {}}, "class", tmp_path)
    assert tree == {"class": f"{tmp_path}/mine.py:Mine", "settings": {}}
    assert with_absolute_file({"class": "a.b:C"}, "class", tmp_path) == {"class": "a.b:C"}
    assert with_absolute_file({}, "class", tmp_path) == {}
