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

    A missing path of two keys (`guidance.look_ahead_s`) is added to its top-level section.

    Raises
    ------
    ConfigError
        If a path does not lead to a single value, or is missing below a section in flow style.
    """
    body = "".join(line for line in text.splitlines(keepends=True) if not line.startswith(HEADER_MARK))
    missing: dict[str, dict[str, float]] = {}
    for path, value in values.items():
        changed = _replace(body, path, _number(value), source)
        if changed is not None:
            body = changed
            continue
        section, _, key = path.partition(".")
        if not key or "." in key:
            raise ConfigError(f"{source}: {path}: there is no such value to tune")
        missing.setdefault(section, {})[key] = value
    for section, entries in missing.items():
        body = _add(body, section, entries)
    head = "".join(f"{HEADER_MARK}{line}\n" for line in record)
    comments = 0
    lines = body.splitlines(keepends=True)
    while comments < len(lines) and lines[comments].startswith("#"):
        comments += 1
    return "".join(lines[:comments]) + head + "".join(lines[comments:])


def _number(value: float) -> str:
    text = f"{value:.4g}"
    return text if any(mark in text for mark in ".e") else f"{text}.0"


def _replace(text: str, path: str, value: str, source: str) -> str | None:
    """Return the text with the scalar at `path` replaced; None if the path is missing."""
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    for key in path.split("."):
        below = _child(node, key)
        if below is None:
            return None
        node = below
    if not isinstance(node, yaml.ScalarNode):
        raise ConfigError(f"{source}: {path}: not a single value")
    return text[: node.start_mark.index] + value + text[node.end_mark.index :]


def _child(node: yaml.Node | None, key: str) -> yaml.Node | None:
    if isinstance(node, yaml.SequenceNode):
        return node.value[int(key)] if key.isdigit() and int(key) < len(node.value) else None
    if isinstance(node, yaml.MappingNode):
        return next((value for name, value in node.value if name.value == key), None)
    return None


def _add(text: str, section: str, entries: Mapping[str, float]) -> str:
    node = _child(yaml.compose(text, Loader=yaml.SafeLoader), section)
    lines = "".join(f"  {key}: {_number(value)}\n" for key, value in entries.items())
    if node is None:
        return text.rstrip("\n") + f"\n{section}:\n{lines}"
    if not isinstance(node, yaml.MappingNode) or node.flow_style:
        raise ConfigError(f"{section}: write this section as a block to let values be added")
    at = node.start_mark.index - node.start_mark.column
    return text[:at] + lines + text[at:]


def write_controller(path: Path, text: str) -> None:
    """Write the file, complete or not at all."""
    write_atomically(path, text.encode())
