"""The pages of the documentation and the commands that they show, as arguments of `dmrac`."""

import os
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = (*(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")), *sorted(ROOT.glob("docs/*.md")))
START = r"(?:\.venv/bin/dmrac|dmrac|scripts/[a-z_]+)"
NO_ARGUMENTS = {"scripts/test", "scripts/environment"}
"""Scripts that are no subcommand of `dmrac`; scripts/replay_dropouts is `dmrac dropouts`."""
PLACEHOLDERS = {"N": "3", "S": "20", "HOST:PORT": "127.0.0.1:14600", "GROUND:14550": "127.0.0.1:14550"}
OPEN_END = {"...", "…", "[...]"}


def text_of(page: Path) -> str:
    """The page, with continued lines joined."""
    return re.sub(r"\\\n\s*", " ", page.read_text(encoding="utf-8"))


def block_commands(page: Path) -> Iterator[str]:
    """Complete commands: lines of code blocks, without prompt and comment."""
    for line in text_of(page).splitlines():
        if line.startswith("|"):  # cells of a table are prose; commands in them are in backticks
            continue
        for part in re.split(r"(?:&&|\||\s&)(?:\s|$)", line):
            found = re.match(rf"^\s*(?:\$ )?({START}(?:\s.*)?)$", part)
            if found and "`" not in part:
                yield found.group(1)


def inline_code(page: Path) -> list[str]:
    """Everything in backticks in running text."""
    text = re.sub(r"^```.*?^```", "", text_of(page), flags=re.MULTILINE | re.DOTALL)
    return [" ".join(code.split()) for code in re.findall(r"(?<!`)`([^`]+)`(?!`)", text)]


def words_of(command: str) -> list[str]:
    """The arguments of `dmrac` that a command stands for; empty for scripts that are not `dmrac`."""
    program, *words = shlex.split(command, comments=True)
    if program in NO_ARGUMENTS:
        return []
    if program.startswith("scripts/"):
        assert (ROOT / program).is_file(), f"{command}: there is no {program}"
        assert os.access(ROOT / program, os.X_OK), f"{program} is not executable"
        name = program.removeprefix("scripts/")
        words = ["dropouts" if name == "replay_dropouts" else name, *words]
    return [PLACEHOLDERS.get(word.strip("[]"), word.strip("[]")) for word in words if word not in OPEN_END]


BLOCKS = [(page, command) for page in PAGES for command in dict.fromkeys(block_commands(page))]
INLINE = [
    (page, code) for page in PAGES for code in dict.fromkeys(inline_code(page)) if re.match(rf"{START}(\s|$)", code)
]
"""Commands in running text, which may omit arguments."""
