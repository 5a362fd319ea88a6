"""Decoding of Protobuf messages, such as Foxglove's, into columns. A missing field is zero, "" or empty.

Encoding: https://protobuf.dev/programming-guides/encoding. As Protobuf requires, unknown fields are skipped, and
fields whose wire type differs from their definition. If a single field occurs several times, its last value
counts.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from locfuse.formats.columns import Bytes, nested
from locfuse.formats.inputs import MAX_DEFINITION, MAX_DEPTH, MAX_ITEMS, MAX_MESSAGE, MAX_TEXT, refuse_above
from locfuse.fusion.data import Ints

from .cdr import MalformedError
from .json_messages import NUMBER, TIME, column
from .schema import (
    Decoded,
    Many,
    MessageDecoder,
    Node,
    Scalar,
    SchemaError,
    Structure,
    Text,
    refuse_many_fields,
    resolve,
)

VARINT, FIXED_64, BYTES, FIXED_32 = 0, 1, 2, 5  # wire types
FIXED_SIZE = {FIXED_64: 8, FIXED_32: 4}
MAX_VARINT = 10  # bytes
SHORT = "shorter than its type"


def varint(data: bytes, at: int, end: int) -> tuple[int, int]:
    """Return the varint at an offset (seven bits per byte, lowest bits first), and its end offset."""
    value = shift = 0
    for i in range(at, min(end, at + MAX_VARINT)):
        byte = data[i]
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, i + 1
        shift += 7
    raise MalformedError(SHORT if at + MAX_VARINT > end else "a number longer than 10 bytes")


def walk(data: bytes, at: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """Yield (number, wire type, start, end) of each field of the message data[at:end]. Raises MalformedError.

    For text, bytes and nested messages, start and end are the offsets of the content.
    """
    while at < end:
        tag, at = (data[at], at + 1) if data[at] < 0x80 else varint(data, at, end)
        wire = tag & 7
        if wire == BYTES:
            n, at = (data[at], at + 1) if at < end and data[at] < 0x80 else varint(data, at, end)
            stop = at + n
        elif wire == VARINT:
            _, stop = varint(data, at, end)
        elif wire in FIXED_SIZE:
            stop = at + FIXED_SIZE[wire]
        else:
            raise MalformedError(f"a field of wire type {wire}, which is not supported")
        if stop > end:
            raise MalformedError(SHORT)
        if tag < 8:
            raise MalformedError("a field of number 0")
        yield tag >> 3, wire, at, stop
        at = stop


def contents(data: bytes, number: int) -> list[bytes]:
    """Return the bytes of each occurrence of field `number` (text, bytes or a nested message) in a message."""
    return [data[at:end] for n, how, at, end in walk(data, 0, len(data)) if n == number and how == BYTES]


def whole(data: bytes, number: int) -> int:
    """Return the integer in a field of a message; 0 if it is missing."""
    found = [at for n, how, at, _ in walk(data, 0, len(data)) if n == number and how == VARINT]
    return varint(data, found[-1], len(data))[0] if found else 0


# --- Definitions: the FileDescriptorSet of a channel (google/protobuf/descriptor.proto) as a tree

NAME = re.compile(rb"[A-Za-z0-9_.]*")
LABEL_REPEATED = 3  # FieldDescriptorProto.Label
TEXT_KIND, MESSAGE_KIND, BYTES_KIND = 9, 11, 12  # FieldDescriptorProto.Type
TIME_TYPES = ("google.protobuf.Timestamp", "google.protobuf.Duration")
# FieldDescriptorProto.Type -> wire type and dtype of a number
NUMBERS: dict[int, tuple[int, str]] = {
    1: (FIXED_64, "<f8"), 2: (FIXED_32, "<f4"), 3: (VARINT, "i8"), 4: (VARINT, "u8"), 5: (VARINT, "i4"),
    6: (FIXED_64, "<u8"), 7: (FIXED_32, "<u4"), 8: (VARINT, "?"), 13: (VARINT, "u4"), 14: (VARINT, "i4"),
    15: (FIXED_32, "<i4"), 16: (FIXED_64, "<i8"), 17: (VARINT, "z4"), 18: (VARINT, "z8"),
}  # fmt: skip


class Field(msgspec.Struct, frozen=True, eq=False):
    """A field of a message type; the dtypes z4 and z8 are integers in zigzag encoding."""

    name: str
    wire: int
    repeated: bool
    dtype: str = ""  # of a number
    text: bool = False
    inside: Message | None = None  # type of a nested message


class Message(msgspec.Struct, frozen=True, eq=False):
    """A message type, which may contain itself."""

    name: str
    fields: dict[int, Field] = {}

    @property
    def is_time(self) -> bool:
        """Whether this is a time or duration, which becomes one number of nanoseconds."""
        return self.name in TIME_TYPES


# seconds and nanoseconds, with their names in ROS
TIME_FIELDS = {1: Field("sec", VARINT, repeated=False, dtype="i8"), 2: Field("nanosec", VARINT, False, "i8")}


def parse_descriptors(name: str, data: bytes) -> tuple[Message, Structure]:
    """Return message type `name` of a FileDescriptorSet, and the tree of its fields that can be columns."""
    refuse_above(f"its protobuf definition of {name} is too long", len(data), MAX_DEFINITION, "bytes", SchemaError)
    described: dict[str, bytes] = {}
    try:
        for file in contents(data, 1):
            described.update(_types(_name(file, 2), contents(file, 4), 0))
        if name not in described:
            raise SchemaError(f"its protobuf definition does not define {name}")
        message = _message(name, described)
    except MalformedError:
        raise SchemaError(f"its protobuf definition of {name} cannot be parsed") from None
    tree = _tree(message, (), {})
    refuse_many_fields(tree)
    return message, tree


def _types(scope: str, types: Sequence[bytes], depth: int) -> Iterator[tuple[str, bytes]]:
    """Yield (full name, DescriptorProto) of every message type, nested ones too."""
    if depth > MAX_DEPTH and types:
        raise MalformedError("too deep")
    for data in types:
        full = f"{scope}.{_name(data, 1)}".removeprefix(".")
        yield full, data
        yield from _types(full, contents(data, 3), depth + 1)


def _message(name: str, described: Mapping[str, bytes]) -> Message:
    """Return a message type with its nested types.

    Each type is built once. Groups (deprecated since 2008) are left out.
    """
    made = {name: Message(name)}
    waiting = [name]
    while waiting:
        message = made[waiting.pop()]
        for data in contents(described[message.name], 2):
            number, kind, label = (whole(data, at) for at in (3, 5, 4))
            wire, dtype = NUMBERS.get(kind, (BYTES, ""))
            held, inside = _name(data, 6).removeprefix("."), None
            if kind == MESSAGE_KIND:
                if held not in described:
                    raise SchemaError(f"its definition names {held} and does not define it")
                if held not in made and held in TIME_TYPES:
                    made[held] = Message(held, TIME_FIELDS)
                elif held not in made:
                    made[held] = Message(held)
                    waiting.append(held)
                inside = made[held]
            if dtype or kind in (TEXT_KIND, BYTES_KIND, MESSAGE_KIND):
                repeated = label == LABEL_REPEATED
                message.fields[number] = Field(_name(data, 1), wire, repeated, dtype, kind == TEXT_KIND, inside)
    return made[name]


def _name(data: bytes, number: int) -> str:
    """Return the name in a field; "" if it is missing. Raises MalformedError for invalid characters."""
    name = b"".join(contents(data, number)[-1:])
    if NAME.fullmatch(name) is None:
        raise MalformedError("a name of other letters")
    return name.decode("ascii")


def _tree(message: Message, above: tuple[str, ...], made: dict[str, Structure]) -> Structure:
    """Return the tree of a type, which is built once.

    Fields of its own type, or of a type in `above`, are left out: such trees would have no end.
    """
    if len(above) > MAX_DEPTH:
        raise SchemaError(f"its definition nests more than {MAX_DEPTH} structures")
    if message.name not in made:
        nodes = {one.name: _node(one, (*above, message.name), made) for one in message.fields.values()}
        fields = {name: node for name, node in nodes.items() if node is not None and name and "." not in name}
        made[message.name] = Structure(message.name, fields)
    return made[message.name]


def _node(one: Field, above: tuple[str, ...], made: dict[str, Structure]) -> Node | None:
    node: Node | None
    if one.inside is not None:
        node = TIME if one.inside.is_time else None
        if node is None and one.inside.name not in above:
            node = _tree(one.inside, above, made)
    elif one.dtype:
        node = Scalar("?", 1) if one.dtype == "?" else NUMBER
    else:
        node = Text() if one.text else Many(Scalar("u1", 1), None)
    return Many(node, None) if one.repeated and node is not None else node


# --- Messages

# Wanted parts of a message: field name -> wanted parts of the field; {} for its whole value.
Wanted = Mapping[str, "Wanted"]
Value = Any
NOTHING: Wanted = {}
WHOLE_TIME: Wanted = {field.name: NOTHING for field in TIME_FIELDS.values()}


class ProtobufDecoder(MessageDecoder):
    """Decodes Protobuf messages of one type into columns."""

    def __init__(self, message: Message, tree: Structure) -> None:
        super().__init__(tree)
        self._type = message

    def decode(self, data: Bytes, start: Ints, length: Ints, fields: Sequence[str]) -> Decoded:
        """Return the fields of the messages data[start[i] : start[i] + length[i]] as columns."""
        parts = {path: resolve(self.message, path) for path in fields}
        wanted = nested({part.path: NOTHING for found in parts.values() for part in found})
        good, bad = np.ones(len(start), bool), Counter[str]()
        objects: list[dict[str, Value]] = []
        for i, (at, n) in enumerate(zip(start.tolist(), length.tolist(), strict=True)):
            try:
                objects.append(_Reader(data[at : at + n].tobytes()).parts(self._type, wanted, 0, n, 0))
            except MalformedError as problem:
                good[i] = False
                bad[str(problem)] += 1
        return Decoded(good, {path: column(objects, path, part) for path, part in parts.items()}, bad)


class _Reader:
    """Parser of one message: checks every byte, so that validity does not depend on the wanted fields."""

    def __init__(self, data: bytes) -> None:
        if len(data) > MAX_MESSAGE:
            raise MalformedError(f"longer than {MAX_MESSAGE >> 20} MiB")
        self.data = data
        self.items = 0

    def parts(self, kind: Message, wanted: Wanted, at: int, end: int, depth: int) -> dict[str, Value]:
        """Return the wanted parts of the message data[at:end]."""
        if depth > MAX_DEPTH:
            raise MalformedError(f"more than {MAX_DEPTH} structures in structures")
        found = _defaults(kind, wanted)
        for number, wire, first, stop in walk(self.data, at, end):
            field = kind.fields.get(number)
            if field is None:
                continue
            packed = bool(field.dtype) and wire == BYTES and field.repeated
            if wire != field.wire and not packed:
                continue
            self._check(field, packed, first, stop)
            inner = wanted.get(field.name)
            value = self._value(field, packed, inner, first, stop, depth)
            if inner is not None and packed:
                found[field.name].extend(value)
            elif inner is not None and field.repeated:
                found[field.name].append(value)
            elif inner is not None:
                found[field.name] = value
        return found

    def _check(self, field: Field, packed: bool, first: int, stop: int) -> None:
        """Raise MalformedError for invalid values, and for messages that would take minutes to parse."""
        if field.text and stop - first > MAX_TEXT:
            raise MalformedError(f"a text longer than {MAX_TEXT >> 20} MiB")
        if packed and field.wire in FIXED_SIZE:
            fits = (stop - first) % FIXED_SIZE[field.wire] == 0
        elif packed:
            ends = np.flatnonzero(np.frombuffer(self.data, np.uint8, stop - first, first) < 0x80)
            longest = np.diff(ends, prepend=-1).max(initial=0)
            fits = stop == first or (bool(len(ends)) and ends[-1] == stop - first - 1 and longest <= MAX_VARINT)
        else:
            fits = True
            self.items += field.repeated or field.inside is not None
        if not fits:
            raise MalformedError("an array that ends within a number")
        if self.items > MAX_ITEMS:
            raise MalformedError(f"more than {MAX_ITEMS} strings and structures of their own length")

    def _value(self, field: Field, packed: bool, inner: Wanted | None, first: int, stop: int, depth: int) -> Value:
        """Return a field's value: number, list (packed array), text, bytes, or wanted parts of a message."""
        if field.inside is not None:
            wanted = WHOLE_TIME if field.inside.is_time else inner or NOTHING
            return self.parts(field.inside, wanted, first, stop, depth + 1)
        if inner is None:
            return None
        if not field.dtype:
            value = self.data[first:stop]
            return value.decode("utf-8", "replace") if field.text else value
        if field.wire in FIXED_SIZE:
            numbers = np.frombuffer(self.data[first:stop], field.dtype).tolist()
            return numbers if packed else numbers[0]
        found = []
        while first < stop:
            bits, first = varint(self.data, first, stop)
            found.append(_number(bits, field.dtype))
        return found if packed else found[0]


def _defaults(kind: Message, wanted: Wanted) -> dict[str, Value]:
    """Return the default values of the wanted fields."""
    found: dict[str, Value] = {}
    for field in kind.fields.values() if wanted else ():
        if field.name not in wanted:
            continue
        if field.repeated:
            found[field.name] = []
        elif field.inside is not None:
            found[field.name] = _defaults(field.inside, wanted[field.name])
        else:
            found[field.name] = 0.0 if field.dtype else "" if field.text else b""
    return found


def _number(value: int, dtype: str) -> float:
    """Return the number of `dtype` in a 64-bit varint; 32-bit types use the lower 32 bits."""
    if dtype == "?":
        return bool(value)
    bits = 32 if dtype[1] == "4" else 64
    value &= (1 << bits) - 1
    if dtype[0] == "z":
        return (value >> 1) ^ -(value & 1)
    return value - (1 << bits) if dtype[0] == "i" and value >> (bits - 1) else value
