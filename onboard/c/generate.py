"""Writes the C files that follow from Python: the table of the configuration and the shared constants.

    python -m onboard.c.generate

The files are kept with the sources. A build checks that they are those of the present records, and that every field
of the table is read by a C file; `check` says what is wrong.
"""

import re
from collections.abc import Callable, Iterator
from typing import Final

from onboard.c.compile import FOLDER
from onboard.c.config_table import (
    HEADER_BYTES,
    LEAF_BYTES,
    MAGIC,
    UNREAD_YET,
    Leaf,
    Node,
    OneOf,
    Record,
    Several,
    TableError,
    layout,
    size_of,
    table,
    walk,
)
from onboard.c.constants_table import constants, enumerations, literal, mode_enumerations, mode_sets, transitions
from protocol.signals import SIGNAL_NAMES

GENERATED: Final = FOLDER / "generated"
COMMAND: Final = "python -m onboard.c.generate"
_NOTE: Final = f"Written by {COMMAND}. Do not edit."


def files() -> dict[str, str]:
    """Text of each generated file."""
    return {
        "constants.h": _constants(),
        "config.h": _config_header(),
        "config.c": _config_source(),
        "modes.h": _modes_header(),
        "modes.c": _modes_source(),
    }


def write() -> None:
    """Write the files that have changed."""
    for name, text in files().items():
        path = GENERATED / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def check() -> None:
    """Check the generated files, and that each field is read.

    Raises
    ------
    TableError
        Naming the file that is out of date, or the fields that no C file reads.
    """
    for name, text in files().items():
        path = GENERATED / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            raise TableError(f"{path} does not fit the configuration records: run {COMMAND}")
    forgotten = unread_fields(_written_by_hand())
    if forgotten:
        raise TableError(
            f"no C file reads {', '.join(forgotten)}: "
            "use it there, or name it in onboard/c/config_table.py OUTSIDE with the reason"
        )


def unread_fields(source: str) -> list[str]:
    """Fields of the table, as Record.field, that do not occur in the C sources as `.name` or `->name`."""
    read = set(re.findall(r"(?:\.|->)(\w+)", source))
    records = {node.name: node for node in walk(table()) if isinstance(node, Record)}
    return [
        f"{name}.{field.name}"
        for name, one in records.items()
        for field in one.fields
        if field.name not in read and not UNREAD_YET & {name, f"{name}.{field.name}"}
    ]


def _written_by_hand() -> str:
    paths = [path for path in sorted(FOLDER.rglob("*.c")) if path.parent != GENERATED]
    return "\n".join(path.read_text(encoding="utf-8") for path in paths)


# --- constants.h ---


def _guarded(name: str, body: str) -> str:
    guard = f"DMRAC_{name.upper()}_H"
    return f"/* {_NOTE} */\n#ifndef {guard}\n#define {guard}\n\n{body}\n#endif\n"


def _constants() -> str:
    lines = ["#include <stdint.h>\n", '#include "numerics/real.h"\n']
    lines += [f"#define {name} {literal(value)} /* {module} */" for name, value, module in constants()]
    lines.append(f"#define SIGNAL_NAMES {', '.join(map(literal, SIGNAL_NAMES))} /* protocol.signals */")
    lines += [f"#define {name.upper()}_COUNT {len(members)}" for name, members in enumerations()]
    lines += [_numbered(name, members) for name, members in enumerations()]
    return _guarded("constants", "\n".join(lines) + "\n")


def _numbered(name: str, members: list[str]) -> str:
    listed = ",\n".join(f"    {member} = {index}" for index, member in enumerate(members))
    return f"\ntypedef enum {{\n{listed}\n}} {name};"


# --- modes.h and modes.c ---

_TRANSITION: Final = """
/* An event that ends a mode, and the next mode. */
typedef struct {
    Event event;
    FlightMode target;
} Transition;

/* Entry `index` of the row of a mode, the most urgent first; false behind the last one. */
bool transition(FlightMode mode, int32_t index, Transition *out);
"""


def _modes_header() -> str:
    kinds = list(mode_enumerations())
    lines = ["#include <stdbool.h>\n#include <stdint.h>\n"]
    lines += [f"#define {members[0].split('_')[0]}_COUNT {len(members)}" for name, members in kinds if name == "Event"]
    lines += [_numbered(name, members) for name, members in kinds]
    lines.append("\n/* Sets of modes: bit `mode` is set for each of them. */")
    lines += [f"#define {name} ({' | '.join(f'1U << {one}' for one in members)})" for name, members in mode_sets()]
    return _guarded("modes", "\n".join([*lines, _TRANSITION]))


def _modes_source() -> str:
    rows = dict(transitions())
    most = max(map(len, rows.values()))
    table = ",\n".join(
        f"        {{{', '.join(f'{{{event}, {to}}}' for event, to in row) or '{0, 0}'}}}" for row in rows.values()
    )
    counts = ", ".join(str(len(row)) for row in rows.values())
    return f"""/* {_NOTE} */
#include "generated/modes.h"

bool transition(FlightMode mode, int32_t index, Transition *out) {{
    static const int32_t counts[{len(rows)}] = {{{counts}}};
    static const Transition table[{len(rows)}][{most}] = {{
{table}}};
    if (index >= counts[mode]) {{
        return false;
    }}
    *out = table[mode][index];
    return true;
}}
"""


# --- config.h ---


def _config_header() -> str:
    return record_header(table(), "config")


def record_header(record: Record, name: str) -> str:
    """Text of the header `name`.h: the structures of a record, and the declaration of `name`_decode."""
    lines = ["#include <stdbool.h>\n#include <stddef.h>\n#include <stdint.h>\n", '#include "numerics/real.h"\n']
    lines.append(f"#define {name.upper()}_IMAGE_BYTES {HEADER_BYTES + size_of(record)}\n")
    lines.append("/* After each member: its place within the packed record, in bytes, and its unit. */")
    declared: set[str] = set()
    for node in walk(record):
        lines += _declaration(node, declared)
    lines.append(
        "\n/* Reads a packed image; false if it is not one of this layout, and `out` must not be used then. */"
    )
    lines.append(f"bool {name}_decode(const uint8_t *packed, size_t size, {record.name} *out);\n")
    return _guarded(name, "\n".join(lines))


def _declaration(node: Node, declared: set[str]) -> Iterator[str]:
    """The C type of a node, once."""
    if isinstance(node, Several) and node.limit and node.limit not in declared:
        declared.add(node.limit)
        yield f"#define {node.limit} {node.length}"
    name = _type_of(node)
    if name in declared or isinstance(node, Several):
        return
    declared.add(name)
    if isinstance(node, Leaf) and node.choices:
        yield _enumeration(name, [f"{_upper(name)}_{choice.upper()}" for choice in node.choices])
    elif isinstance(node, OneOf):
        yield _enumeration(node.kind.c_type, [f"{node.prefix}_{kind.upper()}" for kind, _ in node.members])
        yield _structure(name, [(kind, record, "") for kind, record in node.members if record.fields], node.kind.c_type)
    elif isinstance(node, Record) and node.fields:
        yield _structure(name, [(field.name, field.node, field.unit) for field in node.fields])


def _upper(name: str) -> str:
    """OnPoseStale to ON_POSE_STALE."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).upper()


def _enumeration(name: str, members: list[str]) -> str:
    return f"\ntypedef enum {{ {', '.join(members)} }} {name};"


def _structure(name: str, members: list[tuple[str, Node, str]], kind: str = "") -> str:
    lines, at = [], 0
    if kind:
        lines.append(f"    {kind} kind; /* {at} */")
        at += LEAF_BYTES
    for member, node, unit in members:
        if isinstance(node, Several) and node.counted:
            lines.append(f"    int32_t {member}_count; /* {at} */")
        place = at + LEAF_BYTES * (isinstance(node, Several) and node.counted)
        lines.append(f"    {_member(node, member)}; /* {place}{': ' if unit else ''}{unit} */")
        at += size_of(node)
    return f"\ntypedef struct {{\n{chr(10).join(lines)}\n}} {name};"


def _member(node: Node, name: str) -> str:
    lengths = ""
    while isinstance(node, Several):
        lengths += f"[{node.limit or node.length}]"
        node = node.of
    return f"{_type_of(node)} {name}{lengths}"


def _type_of(node: Node) -> str:
    match node:
        case Leaf():
            return node.c_type
        case Several():
            return _type_of(node.of)
        case Record() | OneOf():
            return node.name


# --- config.c ---

_READER: Final = """
#include <string.h>

typedef struct {
    const uint8_t *at;
    bool bad; /* a count or a choice is out of its range */
} Cursor;

static uint64_t read_bits(Cursor *from) {
    uint64_t bits = 0;
    for (int i = 7; i >= 0; i--) {
        bits = bits << 8 | from->at[i];
    }
    from->at += 8;
    return bits;
}

static real read_real(Cursor *from) {
    uint64_t bits = read_bits(from);
    double value;
    memcpy(&value, &bits, sizeof value);
    return (real)value;
}

static int64_t read_int(Cursor *from) {
    uint64_t bits = read_bits(from);
    int64_t value;
    memcpy(&value, &bits, sizeof value);
    return value;
}
"""
_READ_CHOICE: Final = """
/* A whole number from 0 to `most`. */
static int32_t read_choice(Cursor *from, int32_t most) {
    int64_t value = read_int(from);
    if (value < 0 || value > most) {
        from->bad = true;
        return 0;
    }
    return (int32_t)value;
}
"""


def _config_source() -> str:
    return record_source(table(), "config", MAGIC + layout())


def record_source(record: Record, name: str, header: bytes) -> str:
    """Text of `name`.c, which reads a packed record. header: the HEADER_BYTES that such an image begins with."""
    records = {
        _type_of(node): node
        for node in walk(record)
        if isinstance(node, OneOf) or (isinstance(node, Record) and node.fields)
    }
    bodies = "".join(f"\n{_reader(one, node)}" for one, node in records.items())
    chooses = "read_choice" in bodies
    word = ", ".join(f"0x{byte:02x}" for byte in header)
    return f"""/* {_NOTE} */
#include "generated/{name}.h"
{_READER}{_READ_CHOICE if chooses else ""}{bodies}
bool {name}_decode(const uint8_t *packed, size_t size, {record.name} *out) {{
    static const uint8_t header[{HEADER_BYTES}] = {{{word}}};
    if (size != {name.upper()}_IMAGE_BYTES || memcmp(packed, header, sizeof header) != 0) {{
        return false;
    }}
    Cursor from = {{packed + sizeof header, false}};
    read_{record.name}(&from, out);
    return !from.bad;
}}
"""


def _reader(name: str, node: Record | OneOf) -> str:
    lines: list[str] = []
    if isinstance(node, OneOf):
        lines += _reading(node.kind, "out->kind", 1)
        members: list[tuple[str, Node]] = [(kind, record) for kind, record in node.members if record.fields]
    else:
        members = [(field.name, field.node) for field in node.fields]
    for member, inner in members:
        lines += _reading(inner, f"out->{member}", 1)
    return f"static void read_{name}(Cursor *from, {name} *out) {{\n{chr(10).join(lines)}\n}}\n"


def _reading(node: Node, target: str, depth: int) -> Iterator[str]:
    pad = "    " * depth
    match node:
        case Several():
            if node.counted:
                yield f"{pad}{target}_count = read_choice(from, {node.limit});"
            index = "ijk"[depth - 1]
            yield f"{pad}for (int {index} = 0; {index} < {node.limit or node.length}; {index}++) {{"
            yield from _reading(node.of, f"{target}[{index}]", depth + 1)
            yield f"{pad}}}"
        case Record() | OneOf():
            yield f"{pad}read_{_type_of(node)}(from, &{target});"
        case Leaf():
            yield f"{pad}{target} = {_number(node)};"


def _number(leaf: Leaf) -> str:
    readers: dict[str, Callable[[], str]] = {
        "real": lambda: "read_real(from)",
        "int64_t": lambda: "read_int(from)",
        "int32_t": lambda: "(int32_t)read_int(from)",
        "bool": lambda: "read_int(from) != 0",
    }
    if leaf.c_type in readers:
        return readers[leaf.c_type]()
    return f"({leaf.c_type})read_choice(from, {len(leaf.choices) - 1})"


if __name__ == "__main__":
    write()
