"""Writes tuned values into a controller file; its comments, anchors and layout stay."""

from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from configs.loader import ConfigError
from runtime.files import write_atomically

HEADER_MARK = "# Tuned: "
"""Prefix of the comment lines that record the search; a new search replaces them."""
WIDTH = 10**6
"""Characters of a line that is not wrapped."""


def tuned_text(text: str, values: Mapping[str, float], record: Sequence[str], source: str) -> str:
    """Return the file's text with `values`, by path, and the record of the search in comment lines at its head.

    A missing key is added to its section, and a missing section (`guidance.look_ahead_s`) to the end of the file.

    Raises
    ------
    ConfigError
        If a path does not lead to a single value, or leads through a missing key below a section.
    """
    lines = [line for line in text.splitlines(keepends=True) if not line.startswith(HEADER_MARK)]
    comments = next((number for number, line in enumerate(lines) if not line.startswith("#")), len(lines))
    lines[comments:comments] = [f"{HEADER_MARK}{line}\n" for line in record]
    file, out = YAML(), StringIO()
    file.width, file.preserve_quotes = WIDTH, True
    file.indent(mapping=2, sequence=4, offset=2)
    tree = file.load("".join(lines))
    for path, value in values.items():
        _set(tree, path.split("."), float(f"{value:.4g}"), f"{source}: {path}")
    file.dump(tree, out)
    return out.getvalue()


def _set(tree: Any, keys: Sequence[str], value: float, where: str) -> None:
    """Set one value. Raises ConfigError."""
    *above, last = keys
    if len(above) == 1 and above[0] not in tree:
        tree[above[0]] = {}
    node = tree
    try:
        for key in above:
            node = node[int(key) if isinstance(node, list) else key]
        if isinstance(node, list):
            node[int(last)] = value
            return
        present = node.get(last)
    except (KeyError, IndexError, ValueError, TypeError, AttributeError):
        raise ConfigError(f"{where}: there is no such value to tune") from None
    if node is tree or isinstance(present, dict | list):
        raise ConfigError(f"{where}: not a single value")
    node[last] = value


def write_tuned(path: Path, values: Mapping[str, float], record: Sequence[str]) -> None:
    """Write tuned values and the record of the search into a controller file. Raises ConfigError as `tuned_text`."""
    write_atomically(path, tuned_text(path.read_text(encoding="utf-8"), values, record, str(path)).encode())
