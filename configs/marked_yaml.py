"""Writes a configuration as YAML with a comment behind every value that is the default."""

from collections.abc import Iterator, Mapping, Set
from typing import Any, Final

import yaml
from pydantic import BaseModel

MARK: Final = "  # default"
ONE_LINE_MAX: Final = 80
"""Characters of a mapping that is written on one line."""


def default_paths(record: BaseModel, like: BaseModel | None = None, at: str = "") -> Iterator[str]:
    """The paths of all values that are the default of their record, or of the record that it stands in.

    like: the default of the whole record, if it has one. at: put before each path.
    """
    for name, field in type(record).model_fields.items():
        value, path = getattr(record, name), f"{at}{field.alias or name}"
        usual = getattr(like, name) if like is not None else field.get_default(call_default_factory=True)
        if isinstance(value, BaseModel):
            yield from default_paths(value, usual if type(usual) is type(value) else None, f"{path}.")
        elif isinstance(value, tuple) and value and all(isinstance(one, BaseModel) for one in value):
            for number, one in enumerate(value):
                yield from default_paths(one, None, f"{path}.{number}.")
        elif (like is not None or not field.is_required()) and value == usual:
            yield path


def equal_paths(tree: Mapping[str, Any], other: Mapping[str, Any], at: str = "") -> Iterator[str]:
    """The paths of all values that two plain trees have in common."""
    for key, value in tree.items():
        if isinstance(value, Mapping) and isinstance(other.get(key), Mapping):
            yield from equal_paths(value, other[key], f"{at}{key}.")
        elif key in other and value == other[key]:
            yield f"{at}{key}"


def marked_yaml(tree: Mapping[str, Any], defaults: Set[str]) -> str:
    """The tree as YAML with a comment behind the values whose paths are in `defaults`; short mappings take one line."""
    return "".join(f"{line}\n" for line in _lines(tree, defaults, ""))


def _lines(node: Any, defaults: Set[str], at: str) -> Iterator[str]:
    """The lines of a mapping or a list, without indentation."""
    items = node.items() if isinstance(node, Mapping) else enumerate(node)
    for key, value in items:
        path = f"{at}{key}"
        head = f"{_flow(key)}:" if isinstance(node, Mapping) else "-"
        one_line = _one_line(value, defaults, path)
        if one_line is not None:
            yield f"{head} {one_line}"
            continue
        below = [f"  {line}" for line in _lines(value, defaults, f"{path}.")]
        if head == "-":
            below[0] = f"- {below[0][2:]}"
        else:
            yield head
        yield from below


def _one_line(value: Any, defaults: Set[str], path: str) -> str | None:
    """A value on one line with its mark; None if it takes several lines."""
    text = _flow(value)
    if not isinstance(value, Mapping) or not value:
        return None if _holds_mappings(value) else text + (MARK if path in defaults else "")
    marked = {f"{path}.{key}" in defaults for key in value}
    if len(marked) > 1 or len(text) > ONE_LINE_MAX or any(_holds_mappings(one) for one in value.values()):
        return None
    return text + (MARK if marked == {True} else "")


def _holds_mappings(value: Any) -> bool:
    """Whether a value is a mapping, or a list with a mapping in it; empty ones do not count."""
    if isinstance(value, list | tuple):
        return any(_holds_mappings(one) for one in value)
    return isinstance(value, Mapping) and bool(value)


def _flow(value: Any) -> str:
    """A value in flow style, on one line; with escapes if a text in it has line breaks or control characters."""
    text = _dump(value)
    return text if text.isprintable() else _dump(value, allow_unicode=False, default_style='"')


def _dump(value: Any, **style: Any) -> str:
    options = {"default_flow_style": True, "allow_unicode": True, "sort_keys": False, "width": 10**6}
    return str(yaml.safe_dump(value, **(options | style))).removesuffix("\n").removesuffix("\n...")
