"""What each number of a packed record may be, from the limits of the Python records: a C table for the library's check.

The library has the table, not the image: an image of another version, or one that was written by hand, is refused with
the name of the number that is out of its range. A number of a choice that was not made is not judged.
"""

import math
from collections.abc import Iterator
from typing import Annotated, Any, Final, NamedTuple, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel

from onboard.c.config_table import LEAF_BYTES, Leaf, Node, OneOf, Record, Several, size_of
from onboard.control.cascade import CascadeSettings

INT_MAX: Final = 2.0**62
REAL_MAX: Final = 3.4e38
"""The largest number of the float core."""


class Guard(NamedTuple):
    """A choice on which numbers depend."""

    place: int
    """Of its kind in the packed record, bytes."""
    value: int
    parent: int
    """Index of the guard that must hold too; -1: none."""


class Limits(NamedTuple):
    """What a number may be."""

    low: float
    high: float
    low_open: bool = False
    high_open: bool = False


class Range(NamedTuple):
    """One number, or several alike in a row."""

    name: str
    place: int
    numbers: int
    whole: bool
    limits: Limits
    guard: int


class RangeTable:
    """All ranges of a record. `model`: the pydantic record that it was made of."""

    def __init__(self, record: Record, model: type[BaseModel]) -> None:
        self.guards: list[Guard] = []
        self.ranges: list[Range] = list(self._record(record, model, "", 0, -1))

    def _record(
        self, record: Record, model: type[BaseModel] | None, path: str, place: int, guard: int
    ) -> Iterator[Range]:
        for field in record.fields:
            known = model is not None and field.name in model.model_fields
            annotation = model.model_fields[field.name].annotation if known and model is not None else None
            metadata = tuple(model.model_fields[field.name].metadata) if known and model is not None else ()
            if record.name == "OnboardConfig" or (record.name == "CoreConfig" and field.name == "controller"):
                annotation = CascadeSettings if field.name == "controller" else annotation
            yield from self._node(field.node, annotation, metadata, f"{path}{field.name}", place, guard)
            place += size_of(field.node)

    def _node(
        self, node: Node, annotation: Any, metadata: tuple[Any, ...], name: str, place: int, guard: int
    ) -> Iterator[Range]:
        while get_origin(annotation) is Annotated:
            annotation, *more = get_args(annotation)
            metadata = (*metadata, *_flat(more))
        match node:
            case Leaf():
                yield Range(name, place, 1, node.c_type != "real", _limits(node, metadata), guard)
            case Several():
                yield from self._several(node, annotation, name, place, guard)
            case Record():
                model = annotation if isinstance(annotation, type) and issubclass(annotation, BaseModel) else None
                yield from self._record(node, model, f"{name}.", place, guard)
            case OneOf():
                yield from self._choice(node, annotation, name, place, guard)

    def _several(self, node: Several, annotation: Any, name: str, place: int, guard: int) -> Iterator[Range]:
        if node.counted:
            yield Range(f"{name} count", place, 1, True, Limits(0, node.length), guard)
            place += LEAF_BYTES
        arguments = get_args(annotation)
        inner = arguments[0] if arguments else None
        if isinstance(node.of, Leaf):
            (one,) = self._node(node.of, inner, (), name, place, guard)
            unused = Limits(min(one.limits.low, 0.0), max(one.limits.high, 0.0)) if node.counted else one.limits
            yield one._replace(numbers=node.length, limits=unused)
            return
        for index in range(node.length):
            at = place + index * size_of(node.of)
            yield from self._node(node.of, inner, (), f"{name}[{index}]", at, guard)

    def _choice(self, node: OneOf, annotation: Any, name: str, place: int, guard: int) -> Iterator[Range]:
        yield Range(f"{name} kind", place, 1, True, Limits(0, len(node.members) - 1), guard)
        models = {get_args(one.model_fields["kind"].annotation)[0]: one for one in get_args(annotation)}
        at = place + LEAF_BYTES
        for index, (kind, record) in enumerate(node.members):
            self.guards.append(Guard(place, index, guard))
            yield from self._record(record, models.get(kind), f"{name}.{kind}.", at, len(self.guards) - 1)
            at += size_of(record)


def _flat(metadata: list[Any]) -> Iterator[Any]:
    """The limits in the metadata of an Annotated type: those of a Field stand within it."""
    for one in metadata:
        yield from getattr(one, "metadata", (one,))


def _limits(leaf: Leaf, metadata: tuple[Any, ...]) -> Limits:
    if leaf.choices:
        return Limits(0, len(leaf.choices) - 1)
    if leaf.c_type == "bool":
        return Limits(0, 1)
    most = REAL_MAX if leaf.c_type == "real" else 2.0**31 - 1 if leaf.c_type == "int32_t" else INT_MAX
    low, high = Limits(-most, most)[:2]
    low_open = high_open = False
    for one in metadata:
        match one:
            case Ge(ge=value):
                low, low_open = float(value), False  # type: ignore[arg-type]
            case Gt(gt=value):
                low, low_open = float(value), True  # type: ignore[arg-type]
            case Le(le=value):
                high, high_open = float(value), False  # type: ignore[arg-type]
            case Lt(lt=value):
                high, high_open = float(value), True  # type: ignore[arg-type]
    return Limits(low, high, low_open, high_open)


def c_table(name: str, table: RangeTable) -> str:
    """The C arrays `name`_guards and `name`_ranges, with their counts."""
    guards = ",\n".join(f"    {{{one.place}, {one.value}, {one.parent}}}" for one in table.guards) or "    {0, 0, -1}"
    ranges = ",\n".join(_row(one) for one in table.ranges)
    return (
        f"const RangeGuard {name}_guards[] = {{\n{guards}}};\n"
        f"const Range {name}_ranges[] = {{\n{ranges}}};\n"
        f"const int32_t {name}_range_count = {len(table.ranges)};\n"
    )


def _row(one: Range) -> str:
    low, high, low_open, high_open = one.limits
    flags = ", ".join(str(int(flag)) for flag in (one.whole, low_open, high_open))
    assert math.isfinite(low)
    assert math.isfinite(high)
    return f'    {{"{one.name}", {low!r}, {high!r}, {one.place}, {one.numbers}, {one.guard}, {flags}}}'
