"""The table of the configuration, made of the Python records: names, units and places, for both sides.

Each field becomes a member of a C structure of the same name and takes 8 bytes for each number in the packed image: a
float64, or an int64 for whole numbers, switches and choices, little-endian. A field of a kind that C cannot have is an
error here, and a field that no C file reads is one in generate.py: so a new field is either in both cores or named in
OUTSIDE.
"""

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from hashlib import blake2b
from operator import attrgetter
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from onboard.config import OnboardConfig
from onboard.control.cascade import CascadedController, CascadeSettings
from onboard.flight.trajectory import Lissajous, Swing, swings
from protocol.feature_config import feature_digest
from protocol.messages import LAYOUT_BYTES

OUTSIDE: Final[dict[str, str]] = {
    "OnboardConfig.realtime": "of the process around the core",
    "OnboardConfig.vehicle_link": "MAVLink stays outside",
    "OnboardConfig.ground_link": "MAVLink stays outside",
    "OnboardConfig.pose_health": "arming checks are made outside; the supervisor gets their result",
    "OnboardConfig.pose_wait_s": "the same",
    "OnboardConfig.seed": "what is drawn by it is in the image",
    "Lissajous.seed": "what is drawn by it is in the image",
    "OnboardConfig.features": "the features that a flight starts with are given to the core beside the image",
    "CascadeSettings.features": "the same as OnboardConfig.features",
}
"""Fields that the C core does not need, by record and name, and why."""
NOT_YET: Final[tuple[str, ...]] = ()
"""Fields of rooms that are not written in C yet (README.md)."""
UNREAD_YET: Final[frozenset[str]] = frozenset()
"""Fields, or whole records, that are in the table although no C file reads them yet."""
CASCADE: Final = f"{CascadedController.__module__}:{CascadedController.__name__}"
LEAF_BYTES: Final = 8
MAGIC: Final = b"DMRC"
HEADER_BYTES: Final = 12
"""The magic word, and 8 bytes that name the layout."""


class TableError(Exception):
    """A configuration record that cannot be brought to C. The message names record, field and what is allowed."""


@dataclass(frozen=True)
class Leaf:
    """A number."""

    c_type: str
    choices: tuple[str, ...] = ()
    """Words that are stored as their index."""

    def pack(self, value: Any) -> bytes:
        """8 bytes."""
        if self.c_type == "real":
            return struct.pack("<d", value)
        return struct.pack("<q", self.choices.index(value) if self.choices else int(value))


@dataclass(frozen=True)
class Several:
    """An array of `length`; if `counted`, its used length is stored before it."""

    of: "Node"
    length: int
    counted: bool
    limit: str = ""
    """Name of the limit in C, if it has one."""

    def pack(self, values: Any) -> bytes:
        """All elements; the unused ones are zero."""
        items = list(values)
        if len(items) > self.length or not (self.counted or len(items) == self.length):
            raise TableError(f"{len(items)} values, allowed {self.length}")
        packed = b"".join(self.of.pack(item) for item in items)
        count = struct.pack("<q", len(items)) if self.counted else b""
        return count + packed + bytes((self.length - len(items)) * size_of(self.of))


@dataclass(frozen=True)
class Field:
    """A member of a record."""

    name: str
    node: "Node"
    unit: str
    get: Callable[[Any], Any]


@dataclass(frozen=True)
class Record:
    """A structure."""

    name: str
    fields: tuple[Field, ...]

    def pack(self, value: Any) -> bytes:
        """The members in their order."""
        return b"".join(field.node.pack(field.get(value)) for field in self.fields)


@dataclass(frozen=True)
class OneOf:
    """One of several records: their index as `kind`, then all of them. Those that are not chosen are zero."""

    name: str
    prefix: str
    """Of the names of the kinds in C."""
    members: tuple[tuple[str, Record], ...]
    """Kind and structure. One without fields has no member in C, as C99 has no empty structure."""

    @property
    def kind(self) -> Leaf:
        """The number that tells which."""
        return Leaf(f"{self.name}Kind", tuple(kind for kind, _ in self.members))

    def pack(self, value: Any) -> bytes:
        """The kind and all members."""
        packed = self.kind.pack(value.kind)
        for kind, record in self.members:
            packed += record.pack(value) if kind == value.kind else bytes(size_of(record))
        return packed


Node = Leaf | Several | Record | OneOf


def size_of(node: Node) -> int:
    """Bytes in the image."""
    match node:
        case Leaf():
            return LEAF_BYTES
        case Several():
            return LEAF_BYTES * node.counted + node.length * size_of(node.of)
        case Record():
            return sum(size_of(field.node) for field in node.fields)
        case OneOf():
            return LEAF_BYTES + sum(size_of(record) for _, record in node.members)


def _controller_settings(config: OnboardConfig) -> BaseModel:
    """The settings of the cascade. Raises TableError for another class of controller."""
    path = config.controller.class_path
    if path != CASCADE:
        raise TableError(f"controller.class: {path!r} is not in the C core, allowed is {CASCADE!r}")
    return config.controller.filled_settings(config.features)


def _swings(config: OnboardConfig) -> tuple[Swing, Swing]:
    """The motions of a Lissajous path, drawn by its seed."""
    path, still = config.guidance.trajectory.path, Swing(0.0, 0.0, 0.0)
    return swings(path) if isinstance(path, Lissajous) else (still, still)


def _digest(config: OnboardConfig) -> bytes:
    """What the peer's features and sample layout must have: a digest of texts, which stay outside."""
    return feature_digest(config.features)


def record_of(model: type[BaseModel]) -> Record:
    """The structure of a configuration record. Raises TableError for a field that C cannot have."""
    fields: list[Field] = []
    for name, info in model.model_fields.items():
        place = f"{model.__name__}.{name}"
        if place in OUTSIDE or place in NOT_YET or (name == "kind" and get_origin(info.annotation) is Literal):
            continue
        if place == "OnboardConfig.controller":
            fields.append(Field(name, record_of(CascadeSettings), "of the cascade", _controller_settings))
            continue
        node = _node(info.annotation, info, model, name)
        fields.append(Field(name, node, " ".join((info.description or "").split()), attrgetter(name)))
    return Record(model.__name__, tuple(fields))


def _node(annotation: Any, info: FieldInfo | None, model: type[BaseModel], name: str) -> Node:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _node(arguments[0], info, model, name)
    if annotation is bool:
        return Leaf("bool")
    if annotation is float:
        return Leaf("real")
    if annotation is int:
        return Leaf("int64_t" if name.endswith("_ns") else "int32_t")
    if origin is Literal:
        return Leaf(model.__name__.removesuffix("Config") + camel(name), arguments)
    if origin is tuple:
        return _several(arguments, info, model, name)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return record_of(annotation)
    if origin is Union or type(annotation).__name__ == "UnionType":
        return _one_of(arguments, model, name)
    raise TableError(
        f"{model.__name__}.{name}: {annotation} cannot be brought to C; allowed are numbers, switches, choices, "
        "tuples and records of them, or name the field in onboard/c/config_table.py OUTSIDE"
    )


def _several(arguments: tuple[Any, ...], info: FieldInfo | None, model: type[BaseModel], name: str) -> Several:
    if arguments[-1] is not Ellipsis:
        return Several(_node(arguments[0], None, model, name), len(arguments), counted=False)
    longest = [one.max_length for one in (info.metadata if info else ()) if hasattr(one, "max_length")]
    if not longest:
        raise TableError(f"{model.__name__}.{name}: a tuple of any length needs a max_length")
    limit = f"{name.upper()}_MAX"
    return Several(_node(arguments[0], None, model, name), longest[0], counted=True, limit=limit)


def _one_of(models: tuple[Any, ...], model: type[BaseModel], name: str) -> OneOf:
    members = []
    for one in models:
        if not (isinstance(one, type) and issubclass(one, BaseModel) and "kind" in one.model_fields):
            raise TableError(f"{model.__name__}.{name}: a choice of {one}, allowed are records with a kind")
        (kind,) = get_args(one.model_fields["kind"].annotation)
        members.append((kind, record_of(one)))
    return OneOf(model.__name__.removesuffix("Config") + camel(name), name.upper(), tuple(members))


def camel(name: str) -> str:
    """on_pose_stale to OnPoseStale."""
    return "".join(part.capitalize() for part in name.split("_"))


@lru_cache(maxsize=1)
def table() -> Record:
    """The whole configuration of the core, and what is drawn or computed of it."""
    swing = Record("Swing", tuple(Field(name, Leaf("real"), "", attrgetter(name)) for name in Swing._fields))
    drawn = Field("lissajous", Several(swing, 2, counted=False), "north and east; zero on another path", _swings)
    digest = Field("layout", Several(Leaf("int32_t"), LAYOUT_BYTES, counted=False), "bytes of feature_digest", _digest)
    return Record("CoreConfig", (*record_of(OnboardConfig).fields, drawn, digest))


def walk(node: Node) -> Iterator[Node]:
    """All nodes, inner ones first."""
    match node:
        case Several():
            yield from walk(node.of)
        case Record():
            for field in node.fields:
                yield from walk(field.node)
        case OneOf():
            for _, record in node.members:
                yield from walk(record)
    yield node


def layout(record: Record | None = None) -> bytes:
    """8 bytes that change with any name, kind or order in a record; by default in the table."""
    names = re.sub(r"<[^<>]*>", "", repr(table() if record is None else record))
    return blake2b(names.encode(), digest_size=8).digest()


@cache
def _prefix() -> bytes:
    return MAGIC + layout()


def image(config: OnboardConfig) -> bytes:
    """The packed configuration, as `config_decode` of the C core reads it."""
    return _prefix() + table().pack(config)
