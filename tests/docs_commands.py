"""The commands that README and docs show, as words for `dmrac`."""

import os
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
START = r"(?:\.venv/bin/dmrac|dmrac|scripts/[a-z_]+)"
NO_ARGUMENTS = {"scripts/test", "scripts/environment"}
"""Scripts that are no subcommands of `dmrac`; scripts/replay_dropouts is `dmrac dropouts`."""
PLACEHOLDERS = {"N": "3", "S": "20", "HOST:PORT": "127.0.0.1:14600", "GROUND:14550": "127.0.0.1:14550"}
OPEN_END = {"...", "…", "[...]"}


def text_of(page: Path) -> str:
    """The page without its continued lines."""
    return re.sub(r"\\\n\s*", " ", page.read_text(encoding="utf-8"))


def block_commands(page: Path) -> Iterator[str]:
    """Whole commands: lines of fenced or indented code, without prompt and comment."""
    for line in text_of(page).splitlines():
        if line.startswith("|"):  # a table's cells are prose; their commands stand in backticks
            continue
        for part in re.split(r"(?:&&|\||\s&)(?:\s|$)", line):
            found = re.match(rf"^\s*(?:\$ )?({START}(?:\s.*)?)$", part)
            if found and "`" not in part:
                yield found.group(1)


def inline_commands(page: Path) -> Iterator[str]:
    """Commands in running text, which may leave arguments out."""
    text = re.sub(r"^```.*?^```", "", text_of(page), flags=re.MULTILINE | re.DOTALL)
    for quoted in re.findall(r"(?<!`)`([^`]+)`(?!`)", text):
        if re.fullmatch(rf"{START}(?:\s.*)?", quoted, flags=re.DOTALL):
            yield " ".join(quoted.split())


def words_of(command: str) -> list[str]:
    """The arguments of `dmrac` that a command stands for; empty for scripts that are not `dmrac`."""
    program, *words = shlex.split(command, comments=True)
    if program in NO_ARGUMENTS:
        return []
    if program.startswith("scripts/"):
        assert (ROOT / program).is_file(), f"{command}: there is no {program}"
        assert os.access(ROOT / program, os.X_OK), f"{program} cannot be run"
        name = program.removeprefix("scripts/")
        words = ["dropouts" if name == "replay_dropouts" else name, *words]
    return [PLACEHOLDERS.get(word.strip("[]"), word.strip("[]")) for word in words if word not in OPEN_END]


def pages_with(commands: dict[Path, list[str]]) -> list[tuple[Path, str]]:
    return [(page, command) for page, found in commands.items() for command in dict.fromkeys(found)]


BLOCKS = pages_with({page: list(block_commands(page)) for page in PAGES})
INLINE = pages_with({page: list(inline_commands(page)) for page in PAGES})
