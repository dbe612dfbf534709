"""Reads the parts of a flight by kind and name: scenarios, vehicles, controllers, radio profiles, dropouts.

A part NAME of a kind is the file configs/KIND/NAME.yaml. Two keys save repetition:

    extends: OTHER        the file holds only what differs from the part OTHER (a name, or a file beside this one)
    variants: {A: ...}    the file FAMILY.yaml holds the parts FAMILY_A and so on, each laid over the rest of the file
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from configs.loader import CONFIG_DIRECTORY, ConfigError, merge, read_tree


def named_file(kind: str, name: str) -> Path:
    """The file that holds a part: its own, or its family's; or `name` itself, if it is the path of a .yaml file.

    Raises
    ------
    ConfigError
        If there is none; the message lists the names there are.
    """
    return _find(kind, name)[0]


def part_names(kind: str) -> list[str]:
    """The names of all parts of a kind that are shipped."""
    return sorted(name for path in (CONFIG_DIRECTORY / kind).glob("*.yaml") for name in _names_in(path))


def read_part(kind: str, name: str) -> dict[str, Any]:
    """The plain tree of a part, with what it extends.

    Raises
    ------
    ConfigError
        If a file cannot be read or is no part, or if parts extend each other in a ring.
    """
    return _read(kind, name, "", ())


def _read(kind: str, name: str, source: str, above: tuple[str, ...]) -> dict[str, Any]:
    """The plain tree of a part. source: what is put before a message; above: the parts that extend this one."""
    path, variant = _find(kind, name, source)
    part = f"{path} {variant}".strip()
    if part in above:
        raise ConfigError(f"{source}these extend each other: {', '.join(above)}")
    layer = read_tree(path)
    layer.pop("variants", None)
    layer = merge(layer, _variants(path)[variant]) if variant else layer
    base = layer.pop("extends", None)
    if base is None:
        return layer
    source = f"{path}: extends: "
    if not isinstance(base, str):
        raise ConfigError(f"{source}{base!r}: expected the name of a {_singular(kind)}, or the path of a .yaml file")
    if base.endswith((".yaml", ".yml")):
        base = str(path.parent / base)
    return merge(_read(kind, base, source, (*above, part)), layer)


def _find(kind: str, name: str, source: str = "") -> tuple[Path, str]:
    """The file of a part and its variant in it; "" where the file is one part."""
    if name.endswith((".yaml", ".yml")):
        path, variant = Path(name), ""
    else:
        path, variant = next(_candidates(CONFIG_DIRECTORY / kind, name), (Path(name), ""))
    if not path.is_file() or (not variant and _variants(path)):
        allowed = f"allowed are {', '.join(part_names(kind))}, or the path of a .yaml file"
        raise ConfigError(f"{source}unknown {_singular(kind)} {name!r}: {allowed}")
    return path, variant


def _candidates(directory: Path, name: str) -> Iterator[tuple[Path, str]]:
    """Files that may hold the part: NAME.yaml, then every FAMILY.yaml with a variant that makes up the name."""
    if (directory / f"{name}.yaml").is_file():
        yield directory / f"{name}.yaml", ""
    for at in (at for at, letter in enumerate(name) if letter == "_"):
        family, variant = directory / f"{name[:at]}.yaml", name[at + 1 :]
        if family.is_file() and variant in _variants(family):
            yield family, variant


def _names_in(path: Path) -> list[str]:
    return [f"{path.stem}_{variant}" for variant in _variants(path)] or [path.stem]


def _variants(path: Path) -> Mapping[str, Any]:
    """The variants that a file holds, by name."""
    variants = read_tree(path).get("variants", {})
    if not isinstance(variants, dict) or not all(isinstance(one, dict) for one in variants.values()):
        raise ConfigError(f"{path}: variants: expected a mapping of names to what is laid over the rest of the file")
    return {str(name): one for name, one in variants.items()}


def _singular(kind: str) -> str:
    return kind.removesuffix("s")
