"""Reads configuration files: YAML fills a tree of frozen, typed records, and every fault is named.

The YAML is stricter than usual: `1e-4` is a number, `no` and `on` are words, and a key that is written twice is an
error. Records are pydantic models that refuse unknown keys, wrong types and values out of range.
"""

import re
from collections.abc import Hashable, Mapping
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

CONFIG_DIRECTORY = Path(__file__).resolve().parent


class ConfigError(Exception):
    """A configuration that cannot be used. The message has one line per fault: file, path, value, what is allowed."""


class ConfigRecord(BaseModel):
    """Base of every configuration record: strict, frozen, unknown keys refused."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False)


RecordT = TypeVar("RecordT", bound=BaseModel)


class _Loader(yaml.SafeLoader):
    """SafeLoader with the scalars of YAML 1.2; it refuses duplicate keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[Hashable] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key!r} is written twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


_Loader.yaml_implicit_resolvers = {
    first: [
        (tag, pattern)
        for tag, pattern in resolvers
        if tag
        not in {
            "tag:yaml.org,2002:bool",
            "tag:yaml.org,2002:float",
            "tag:yaml.org,2002:int",
            "tag:yaml.org,2002:timestamp",
        }
    ]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile(r"^(?:true|false)$"), list("tf"))
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"^[-+]?(?:0|[1-9][0-9]*)$"), list("-+0123456789"))
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]+)?$"),
    list("-+.0123456789"),
)


@lru_cache(maxsize=128)
def _parsed(text: str) -> Any:
    """The tree of a text, cached: a campaign reads the same few files for each of its thousands of flights."""
    return yaml.load(text, Loader=_Loader)


def parse_yaml(text: str, source: str) -> Any:
    """The plain tree of a YAML text.

    Raises
    ------
    ConfigError
        If the text is not YAML, or a key is written twice; the message names `source` and the line.
    """
    try:
        return deepcopy(_parsed(text))
    except yaml.YAMLError as error:
        raise ConfigError(f"{source}: {' '.join(str(error).split())}") from None


def parse_mapping(text: str, source: str) -> dict[str, Any]:
    """The mapping of a YAML text. Raises ConfigError as `parse_yaml` does, and if the text is not a mapping."""
    tree = parse_yaml(text, source)
    if not isinstance(tree, dict):
        raise ConfigError(f"{source}: holds {type(tree).__name__}, expected a mapping of keys")
    return tree


def read_tree(path: Path) -> dict[str, Any]:
    """The mapping that a YAML file holds.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not YAML, or does not hold a mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ConfigError(f"{path}: cannot be read: {reason}") from None
    return parse_mapping(text, str(path))


def fill(record_type: type[RecordT], tree: Mapping[str, Any], source: str, at: str = "") -> RecordT:
    """A record filled from a plain tree. One error names all faults.

    Parameters
    ----------
    source: the file (or option) the tree came from, for the message.
    at: path of the tree within the file, such as "onboard.".

    Raises
    ------
    ConfigError
        One line per fault: source, path, the value and what is allowed.
    """
    try:
        return record_type.model_validate(_lists_as_tuples(tree), strict=True)
    except ValidationError as error:
        faults = (_describe(fault, source, at, record_type) for fault in error.errors())
        raise ConfigError("\n".join(faults)) from None


def load(record_type: type[RecordT], path: Path) -> RecordT:
    """A record filled from a YAML file. Raises ConfigError."""
    return fill(record_type, read_tree(path), str(path))


def load_section(record_type: type[RecordT], path: Path, name: str) -> RecordT:
    """A record filled from one top-level section of a YAML file. Raises ConfigError."""
    return fill_section(record_type, read_tree(path), str(path), name)


def fill_section(record_type: type[RecordT], tree: Mapping[str, Any], source: str, name: str) -> RecordT:
    """A record filled from one top-level section of a plain tree. Raises ConfigError."""
    if not isinstance(tree.get(name), dict):
        raise ConfigError(f"{source}: {name}: missing, expected a mapping of keys")
    return fill(record_type, tree[name], source, at=f"{name}.")


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with the keys of `over` laid over it: mappings are merged, everything else is replaced."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = merge(below, value) if isinstance(value, Mapping) and isinstance(below, Mapping) else value
    return merged


def set_path(tree: Mapping[str, Any], assignment: str) -> dict[str, Any]:
    """`tree` with one `path.to.key=value` assignment (the value is YAML) laid over it.

    A mapping of another `kind` than the one at this path replaces it.

    Raises
    ------
    ConfigError
        If the assignment has no `=`, or its path runs through something that is neither a mapping nor a list.
    """
    path, equals, text = assignment.partition("=")
    if not equals or not path.strip():
        raise ConfigError(f"--set {assignment}: expected path.to.key=value")
    value = parse_yaml(text, f"--set {assignment}")
    changed: dict[str, Any] = _with_value(tree, path.strip().split("."), 0, value, assignment)
    return changed


def _with_value(node: Any, keys: list[str], depth: int, value: Any, assignment: str) -> Any:
    """`node` with `value` at keys[depth:]; a number in the path counts the items of a list from 0."""
    if depth == len(keys):
        merges = (
            isinstance(value, Mapping) and isinstance(node, Mapping) and value.get("kind") in (None, node.get("kind"))
        )
        return merge(node, value) if merges else value
    key = keys[depth]
    if isinstance(node, list | tuple):
        if not key.isdigit() or int(key) >= len(node):
            at = ".".join(keys[:depth])
            raise ConfigError(f"--set {assignment}: {at} is a list of {len(node)}; count its items from 0")
        items = list(node)
        items[int(key)] = _with_value(node[int(key)], keys, depth + 1, value, assignment)
        return items
    if not isinstance(node, Mapping | None):
        raise ConfigError(f"--set {assignment}: {'.'.join(keys[:depth])} holds no keys")
    below = None if node is None else node.get(key)
    return {**(node or {}), key: _with_value(below, keys, depth + 1, value, assignment)}


def _lists_as_tuples(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _lists_as_tuples(below) for key, below in value.items()}
    if isinstance(value, list | tuple):
        return tuple(_lists_as_tuples(below) for below in value)
    return value


def _describe(fault: Any, source: str, at: str, record_type: type[BaseModel]) -> str:
    path = (at + ".".join(str(part) for part in fault["loc"])).rstrip(".")
    if fault["type"] == "extra_forbidden":
        known = _keys_beside(record_type, fault["loc"])
        return f"{source}: {path}: unknown key" + (f"; allowed are {', '.join(known)}" if known else "")
    if fault["type"] == "missing":
        return f"{source}: {path}: missing"
    said = fault["msg"].removeprefix("Value error, ")
    if isinstance(fault["input"], Mapping | BaseModel):  # of several values together; the message names them
        return f"{source}: {path}: {said}"
    return f"{source}: {path}: {fault['input']!r}: {said}"


def _keys_beside(record_type: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """The keys a record allows where `loc` names an unknown one; none where a choice of records makes that unclear."""
    for part in loc[:-1]:
        field = record_type.model_fields.get(str(part))
        if field is None or not (isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)):
            return []
        record_type = field.annotation
    return sorted(field.alias or name for name, field in record_type.model_fields.items())
