"""Constants of the Python core that the C core needs as well. Their one owner is the Python module."""

from collections.abc import Iterator
from enum import Enum
from importlib import import_module
from typing import Any, Final

from protocol.signals import SIGNAL_NAMES

CONSTANTS: Final[dict[str, tuple[str, ...]]] = {
    "protocol.conventions": ("GRAVITY", "NEVER_NS"),
    "protocol.signals": ("SIGNAL_COUNT",),
}
"""Module, and names there; `OLD=NEW` gives it another name in C."""
ENUMERATIONS: Final[dict[str, type[Enum]]] = {}
"""Prefix of the members in C, and the enumeration."""


def constants() -> Iterator[tuple[str, Any, str]]:
    """Name in C, value and module of each constant."""
    for module, names in CONSTANTS.items():
        for name in names:
            old, _, new = name.partition("=")
            yield (new or old).lstrip("_"), getattr(import_module(module), old), module


def literal(value: Any) -> str:
    """The value in C."""
    if isinstance(value, float):
        return f"REAL({value!r})"
    return f"INT64_C({value})" if abs(value) >= 2**31 else f"({value})" if value < 0 else str(value)


def enumerations() -> Iterator[tuple[str, list[str]]]:
    """Name in C and members, in the order of their numbers, from 0."""
    yield "Signal", [f"SIGNAL_{name.upper()}" for name in SIGNAL_NAMES]
    for prefix, one in ENUMERATIONS.items():
        yield one.__name__, [f"{prefix}_{member.name}" for member in one]
