"""Message definitions (ros2msg, ros2idl, ros1msg) as a tree that says how the bytes of a message lie."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from locfuse.formats.container.source import message_type

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc, Typesdict

DTYPES = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
TIMES = frozenset({"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"})
MAX_DEPTH = 32
FILLER = "structure_needs_at_least_one_member"  # the byte that an empty message takes in CDR
DIVIDER = re.compile(r"^={20,}\s*$", re.MULTILINE)


class SchemaError(ValueError):
    """A message definition that cannot be used; the message is the reason in a few words."""


@dataclass(frozen=True, eq=False)
class Scalar:
    """One number."""

    dtype: str  # NumPy letter and size, e.g. "f8"; "?" for bool
    size: int  # bytes, and so its alignment


@dataclass(frozen=True, eq=False)
class Text:
    """A string."""


@dataclass(frozen=True, eq=False)
class Many:
    """An array: of fixed `count`, or a sequence that says its length itself (None)."""

    element: Node
    count: int | None


@dataclass(frozen=True, eq=False)
class Record:
    """A message or a part of one."""

    name: str
    fields: dict[str, Node]

    @property
    def is_time(self) -> bool:
        """Whether this is a stamp or a duration: delivered as one number of nanoseconds."""
        parts = tuple(self.fields.values())
        return self.name in TIMES and len(parts) == 2 and all(isinstance(part, Scalar) for part in parts)


Node = Scalar | Text | Many | Record


def parse(name: str, encoding: str, text: str, filler: bool = True) -> Record:
    """Return the layout of message type `name`, whose definition `text` is in the language `encoding`.

    `filler`: an empty message takes a byte, as in ROS 2.
    """
    from rosbags.typesys import TypesysError

    msgtype = message_type(name)
    try:
        types = _types(msgtype, encoding, text.replace("\r\n", "\n"))
    except (TypesysError, RecursionError, ValueError, KeyError, AssertionError, TypeError):
        raise SchemaError(f"its {encoding} definition of {msgtype} cannot be parsed") from None
    tree = _record(msgtype, types, 0)
    return tree if filler else _without_filler(tree)


def _types(msgtype: str, encoding: str, text: str) -> Typesdict:
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if encoding != "ros2idl":
        return get_types_from_msg(text, msgtype)
    found: Typesdict = {}
    for one in DIVIDER.split(text):
        idl = "\n".join(line for line in one.split("\n") if not line.startswith(("IDL: ", "#include")))
        if idl.strip():
            found.update(get_types_from_idl(idl))
    return found


def _record(name: str, types: Typesdict, depth: int) -> Record:
    if depth > MAX_DEPTH:
        raise SchemaError("its definition contains itself")
    if name not in types:
        if name in TIMES:
            return Record(name, {"sec": Scalar("i4", 4), "nanosec": Scalar("u4", 4)})
        raise SchemaError(f"its definition names {name} and does not define it")
    fields = {field: _node(desc, types, depth + 1) for field, desc in types[name][1]}
    return Record(name, fields or {FILLER: Scalar("u1", 1)})


def _without_filler(record: Record) -> Record:
    """Return the same tree with its empty parts really empty."""
    return Record(record.name, {name: _bare(part) for name, part in record.fields.items() if name != FILLER})


def _bare(node: Node) -> Node:
    if isinstance(node, Record):
        return _without_filler(node)
    return Many(_bare(node.element), node.count) if isinstance(node, Many) else node


def _node(desc: FieldDesc, types: Typesdict, depth: int) -> Node:
    kind, detail = desc[0].name, desc[1]
    if kind == "NAME":
        return _record(str(detail), types, depth)
    if kind == "BASE":
        return _base(str(detail[0]))
    element, size = cast("tuple[FieldDesc, int]", detail)
    return Many(_node(element, types, depth), size if kind == "ARRAY" else None)


def _base(name: str) -> Node:
    if name == "string":
        return Text()
    if name not in DTYPES:
        raise SchemaError(f"its definition uses {name}, which is not supported")
    return Scalar(DTYPES[name], int(DTYPES[name][1:] or 1))


def signature(node: Node) -> object:
    """Return a value that is equal for definitions whose columns are alike."""
    if isinstance(node, Record):
        return tuple((name, signature(part)) for name, part in node.fields.items())
    if isinstance(node, Many):
        return (node.count, signature(node.element))
    return node.dtype if isinstance(node, Scalar) else "text"
