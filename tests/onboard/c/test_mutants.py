"""The planted bugs: one that is named stands in the sources once, every room has one, and the command finds one."""

import pytest

from onboard.c.compile import FOLDER, sources
from tests.onboard.c.mutants import KINDS, MUTANTS, ROOT, main


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_each_bug_can_be_planted(mutant: object) -> None:
    text = (FOLDER / mutant.file).read_text(encoding="utf-8")
    assert text.count(mutant.sound) == 1
    assert mutant.sound != mutant.wrong
    assert (ROOT / "tests" / "onboard" / "c" / f"{mutant.test}.py").is_file()


def test_every_room_and_every_kind_has_one() -> None:
    rooms = {path.relative_to(FOLDER).parent.as_posix() for path in sources()}
    assert rooms == {mutant.file.rpartition("/")[0] or "." for mutant in MUTANTS}
    assert {mutant.kind for mutant in MUTANTS} == set(KINDS)
    assert len(MUTANTS) >= 20


def test_an_unknown_name_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["core.c:colour"]) == 2
    assert "allowed are numerics/elementary.c:sign" in capsys.readouterr().err


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_all_are_found(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0, capsys.readouterr().out
