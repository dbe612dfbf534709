"""Shared by the commands that print a table: the option `--json`, and how each prints then."""

import argparse
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import Any

from rich.console import Console

from runtime.files import plain_value


def add_json_option(parser: argparse.ArgumentParser, what: str = "the result") -> None:
    """Add `--json`: print JSON on standard output instead of a table; all else goes to standard error."""
    parser.add_argument("--json", action="store_true", help=f"print {what} as JSON, for programs, instead of a table")


def console_for(arguments: argparse.Namespace) -> Console:
    """The console of tables and status lines: standard error if standard output is for JSON."""
    return Console(stderr=bool(arguments.json))


def print_json(value: Any) -> None:
    """Print a value of mappings, lists, dataclasses, named tuples and numbers; null for numbers that are not finite."""
    print(json.dumps(_plain(value), indent=1, default=plain_value, allow_nan=False))


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if hasattr(value, "_asdict"):
        return _plain(value._asdict())
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value
