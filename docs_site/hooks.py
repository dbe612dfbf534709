"""Hooks of mkdocs: pages that are not in docs/, and links that lead out of it.

README, CONTRIBUTING, CHANGELOG and the READMEs of the C core and of mambo/ become pages, the options of every
subcommand become one, and each example becomes a page and a notebook to download. Links to a source file lead to a copy
of it in the site; a link to a folder becomes plain text.
"""

import re
from pathlib import Path
from typing import Any, Final

import jupytext
from mkdocs.structure.files import File, Files

from async_dmrac.command_line import SUBCOMMANDS, build_whole_parser

ROOT: Final = Path(__file__).resolve().parents[1]
PAGES: Final = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changes.md",
    "onboard/c/README.md": "core_in_c.md",
    "mambo/README.md": "mambo_library.md",
}
"""File of the project -> page of the site."""
DOCS: Final = ROOT / "docs"
COMMANDS: Final = "reference/commands.md"
EXAMPLES: Final = ROOT / "examples"
NOTEBOOKS: Final = "notebooks"
"""Folder of the site with the examples."""
_LINK: Final = re.compile(r"\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]+)\)")
_HTML: Final = re.compile(r'(?P<name>href|src)="(?P<target>[^":]+)"')


def on_files(files: Files, config: Any) -> Files:
    """Add the pages, and the source files that a page links to."""
    for source, page in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    files.append(File.generated(config, COMMANDS, content=commands_page()))
    for example in sorted(EXAMPLES.glob("*.py")):
        for uri, content in notebook_files(example).items():
            files.append(File.generated(config, uri, content=content))
    linked = set()
    for file in files.documentation_pages():
        base = base_of(file.src_uri)
        for match in _LINK.finditer(file.content_string):
            path = in_project(match["target"], base)
            if path is not None and path.is_file() and path.suffix != ".md" and not path.is_relative_to(DOCS):
                linked.add(path)
    for path in sorted(linked):
        files.append(File.generated(config, source_uri(path), abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Change the links that lead out of docs/, or into it from the project's root."""
    base, depth = base_of(page.file.src_uri), page.file.src_uri.count("/")

    def link(match: re.Match[str]) -> str:
        target = relocated(match["target"], base, depth)
        return match["text"] if target is None else f"[{match['text']}]({target})"

    def html(match: re.Match[str]) -> str:
        return f'{match["name"]}="{relocated(match["target"], base, depth) or ""}"'

    return _HTML.sub(html, _LINK.sub(link, markdown))


def base_of(page: str) -> Path:
    """The folder, in the project, from which the links of a page start."""
    source = next((source for source, own in PAGES.items() if own == page), f"docs/{page}")
    return (ROOT / source).parent


def in_project(target: str, base: Path) -> Path | None:
    """The file or folder that a link leads to; None for another site or a place in the same page."""
    name = target.partition("#")[0]
    return (base / name).resolve() if name and "://" not in target else None


def relocated(target: str, base: Path, depth: int) -> str | None:
    """Where a link of a page leads in the site; None if there is nothing to link to."""
    path = in_project(target, base)
    if path is None:
        return target
    if path.is_dir():
        return None
    name = str(path.relative_to(ROOT))
    inside = PAGES.get(name) or (name.removeprefix("docs/") if name.startswith("docs/") else source_uri(path))
    _, mark, anchor = target.partition("#")
    return "../" * depth + inside + mark + anchor


def source_uri(path: Path) -> str:
    """Where the copy of a source file is in the site."""
    return f"source/{path.relative_to(ROOT)}.txt"


def notebook_files(example: Path) -> dict[str, str]:
    """The page of an example and its notebook, by their places in the site."""
    notebook = jupytext.read(example)
    cells = [
        cell.source if cell.cell_type == "markdown" else f"```python\n{cell.source}\n```" for cell in notebook.cells
    ]
    download = f"[Download as a notebook]({example.stem}.ipynb)"
    title, *rest = cells
    return {
        f"{NOTEBOOKS}/{example.stem}.md": "\n\n".join([title, download, *rest]) + "\n",
        f"{NOTEBOOKS}/{example.stem}.ipynb": jupytext.writes(notebook, fmt="ipynb"),
    }


def commands_page() -> str:
    """The help of every subcommand."""
    parser = build_whole_parser()
    [subparsers] = (action for action in parser._actions if isinstance(action.choices, dict))
    parts = ["# Commands\n", "What `dmrac SUBCOMMAND --help` prints.\n"]
    for name, own in subparsers.choices.items():  # type: ignore[union-attr]
        parts += [f"## dmrac {name}\n", f"{SUBCOMMANDS[name].help}.\n", f"```\n{own.format_help().rstrip()}\n```\n"]
    return "\n".join(parts)
