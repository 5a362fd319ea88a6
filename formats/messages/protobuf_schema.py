"""Protobuf definitions: the FileDescriptorSet beside a channel as a tree, with the number of every field.

The set is a Protobuf message itself (google/protobuf/descriptor.proto), so the same walk reads it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import msgspec
from msgspec import field

from locfuse.formats.caps import MAX_DEFINITION, MAX_DEPTH, MAX_FIELDS, names_its_cap

from .layout import MalformedError
from .objects import NUMBER, TIME
from .protobuf_wire import BYTES, FIXED_32, FIXED_64, VARINT, contents, whole
from .schema import Many, Node, Record, Scalar, SchemaError, Text, count_fields

NAME = re.compile(rb"[A-Za-z0-9_.]*")
REPEATED = 3  # FieldDescriptorProto.Label
TEXT_KIND, MESSAGE_KIND, BYTES_KIND, BOOL_KIND = 9, 11, 12, 8  # FieldDescriptorProto.Type
TIME_TYPES = ("google.protobuf.Timestamp", "google.protobuf.Duration")
TIME_PARTS = {1: "sec", 2: "nanosec"}
# FieldDescriptorProto.Type -> how a number lies on the wire, and as what it is read
NUMBERS: dict[int, tuple[int, str]] = {
    1: (FIXED_64, "<f8"), 2: (FIXED_32, "<f4"), 3: (VARINT, "i8"), 4: (VARINT, "u8"), 5: (VARINT, "i4"),
    6: (FIXED_64, "<u8"), 7: (FIXED_32, "<u4"), BOOL_KIND: (VARINT, "?"), 13: (VARINT, "u4"), 14: (VARINT, "i4"),
    15: (FIXED_32, "<i4"), 16: (FIXED_64, "<i8"), 17: (VARINT, "z4"), 18: (VARINT, "z8"),
}  # fmt: skip


class Field(msgspec.Struct, frozen=True, eq=False):
    """One field of a message: z4 and z8 are numbers in zigzag coding."""

    name: str
    wire: int
    repeated: bool
    dtype: str = ""  # of a number
    text: bool = False
    inside: Message | None = None  # the message that it holds


class Message(msgspec.Struct, frozen=True, eq=False):
    """A message type; it may hold itself."""

    name: str
    fields: dict[int, Field] = field(default_factory=dict)

    @property
    def is_time(self) -> bool:
        """Whether it is a stamp or a duration: delivered as one number of nanoseconds."""
        return self.name in TIME_TYPES


def parse_descriptors(name: str, data: bytes) -> tuple[Message, Record]:
    """Return message type `name` of a FileDescriptorSet, and the tree of what can be a column."""
    if len(data) > MAX_DEFINITION:
        raise SchemaError(
            names_its_cap(f"its protobuf definition of {name} is too long", len(data), MAX_DEFINITION, "bytes")
        )
    try:
        described = dict(_described(data))
        if name not in described:
            raise SchemaError(f"its protobuf definition does not define {name}")
        message = _message(name, described, {})
    except MalformedError:
        raise SchemaError(f"its protobuf definition of {name} cannot be parsed") from None
    tree = _Trees().record(message, 0)
    if (fields := count_fields(tree)) > MAX_FIELDS:
        raise SchemaError(
            names_its_cap(f"its definition of {name} unfolds to too many fields", fields, MAX_FIELDS)
        )
    return message, tree


def _described(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield the full name of every message type in a FileDescriptorSet, and its DescriptorProto."""
    for file in contents(data, 1):
        package = _name(file, 2)
        for one in contents(file, 4):
            yield from _nested(package, one, 0)


def _nested(scope: str, data: bytes, depth: int) -> Iterator[tuple[str, bytes]]:
    if depth > MAX_DEPTH:
        raise MalformedError("too deep")
    name = _name(data, 1)
    full = f"{scope}.{name}" if scope else name
    yield full, data
    for one in contents(data, 3):
        yield from _nested(full, one, depth + 1)


def _message(name: str, described: dict[str, bytes], made: dict[str, Message]) -> Message:
    """Return a message type with those that it holds; each is made once."""
    waiting = [name]
    made[name] = Message(name)
    while waiting:
        message = made[waiting.pop()]
        for data in contents(described[message.name], 2):
            number, kind, label = (whole(data, at) for at in (3, 5, 4))
            held = _name(data, 6).removeprefix(".")
            if kind == MESSAGE_KIND and held not in described:
                raise SchemaError(f"its definition names {held} and does not define it")
            if kind == MESSAGE_KIND and held not in made:
                made[held] = Message(held)
                waiting.append(held)
            one = _field(_name(data, 1), kind, label == REPEATED, made.get(held) if kind == MESSAGE_KIND else None)
            if one is not None:
                message.fields[number] = one
    return made[name]


def _name(data: bytes, number: int) -> str:
    """Return the name that one field holds, "" where it is left out. Raises MalformedError where it is no name."""
    name = b"".join(contents(data, number)[-1:])
    if NAME.fullmatch(name) is None:
        raise MalformedError("a name of other letters")
    return name.decode("ascii")


def _field(name: str, kind: int, repeated: bool, inside: Message | None) -> Field | None:
    """Return a field, None for a group, which nobody writes since 2008."""
    if kind in NUMBERS:
        wire, dtype = NUMBERS[kind]
        return Field(name, wire, repeated, dtype)
    if kind in (TEXT_KIND, BYTES_KIND, MESSAGE_KIND):
        return Field(name, BYTES, repeated, text=kind == TEXT_KIND, inside=inside)
    return None


class _Trees:
    """Builds the tree of each type once; where a type holds itself, the tree ends."""

    def __init__(self) -> None:
        self._made: dict[str, Record] = {}
        self._open: set[str] = set()

    def record(self, message: Message, depth: int) -> Record:
        """Return the tree of a type, `depth` structures deep in the message."""
        if depth > MAX_DEPTH:
            raise SchemaError(f"its definition nests more than {MAX_DEPTH} structures")
        if message.name not in self._made:
            self._open.add(message.name)
            nodes = {one.name: self._node(one, depth + 1) for one in message.fields.values()}
            fields = {name: node for name, node in nodes.items() if node is not None and name and "." not in name}
            self._made[message.name] = Record(message.name, fields)
            self._open.discard(message.name)
        return self._made[message.name]

    def _node(self, one: Field, depth: int) -> Node | None:
        node: Node | None
        if one.inside is not None:
            node = TIME if one.inside.is_time else None
            if node is None and one.inside.name not in self._open:
                node = self.record(one.inside, depth)
        elif one.dtype:
            node = Scalar("?", 1) if one.dtype == "?" else NUMBER
        else:
            node = Text() if one.text else Many(Scalar("u1", 1), None)
        return Many(node, None) if one.repeated and node is not None else node
