"""Writes tuned values into a controller file without changing its comments, anchors and layout."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from configs.loader import ConfigError
from runtime.files import write_atomically

HEADER_MARK = "# Tuned: "
"""Prefix of the comment lines that record the search; a new search replaces them."""


def tuned_text(text: str, values: Mapping[str, float], record: Sequence[str], source: str) -> str:
    """Return the file's text with `values`, by path, and the record of the search in comment lines at its head.

    A missing key is added to its section, and a missing section (`guidance.look_ahead_s`) to the end of the file.

    Raises
    ------
    ConfigError
        If a path does not lead to a single value, or leads through a missing key below a section.
    """
    body = "".join(line for line in text.splitlines(keepends=True) if not line.startswith(HEADER_MARK))
    for path, value in values.items():
        body = _with_value(body, path, _number(value), source)
    head = "".join(f"{HEADER_MARK}{line}\n" for line in record)
    comments = 0
    lines = body.splitlines(keepends=True)
    while comments < len(lines) and lines[comments].startswith("#"):
        comments += 1
    return "".join(lines[:comments]) + head + "".join(lines[comments:])


def _number(value: float) -> str:
    text = f"{value:.4g}"
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def _with_value(text: str, path: str, value: str, source: str) -> str:
    root = node = yaml.compose(text, Loader=yaml.SafeLoader)
    keys = path.split(".")
    while keys and (below := _child(node, keys[0])) is not None:
        node, keys = below, keys[1:]
    if not keys:
        if not isinstance(node, yaml.ScalarNode):
            raise ConfigError(f"{source}: {path}: not a single value")
        return text[: node.start_mark.index] + value + text[node.end_mark.index :]
    if node is root and len(keys) == 2:
        return text.rstrip("\n") + f"\n{keys[0]}:\n  {keys[1]}: {value}\n"
    if node is root or len(keys) > 1 or not isinstance(node, yaml.MappingNode):
        raise ConfigError(f"{source}: {path}: there is no such value to tune")
    if node.flow_style:
        at = node.value[-1][1].end_mark.index if node.value else node.start_mark.index + 1
        added = f"{', ' if node.value else ''}{keys[0]}: {value}"
    else:
        at = node.start_mark.index - node.start_mark.column
        added = f"{' ' * node.start_mark.column}{keys[0]}: {value}\n"
    return text[:at] + added + text[at:]


def _child(node: yaml.Node | None, key: str) -> yaml.Node | None:
    if isinstance(node, yaml.SequenceNode):
        return node.value[int(key)] if key.isdigit() and int(key) < len(node.value) else None
    if isinstance(node, yaml.MappingNode):
        return next((value for name, value in node.value if name.value == key), None)
    return None


def write_tuned(path: Path, values: Mapping[str, float], record: Sequence[str]) -> None:
    """Write tuned values and the record of the search into a controller file. Raises ConfigError as `tuned_text`."""
    write_atomically(path, tuned_text(path.read_text(encoding="utf-8"), values, record, str(path)).encode())
