"""Protobuf messages, such as Foxglove's, as columns. A field that the bytes leave out is zero, "" or empty.

Encoding: https://protobuf.dev/programming-guides/encoding. Unknown fields, and known ones that lie in another way
than their definition says, are passed over, as Protobuf wants it; of a repeated single value the last one counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.caps import MAX_DEPTH, MAX_ITEMS, MAX_MESSAGE, MAX_TEXT
from locfuse.fusion.data import Ints

from .decoded import Decoded
from .fields import LENGTH, OR, resolve
from .layout import MalformedError
from .objects import column
from .protobuf_schema import TIME_PARTS, Field, Message
from .protobuf_wire import BYTES, FIXED_SIZE, MAX_VARINT, varint, walk
from .schema import Record

# Which parts of a message are wanted: field name -> its wanted parts, none for a whole value.
Wanted = Mapping[str, "Wanted"]
Value = Any
NOTHING: Wanted = {}


class ProtobufDecoder:
    """Columns out of Protobuf messages."""

    def __init__(self, message: Message, tree: Record) -> None:
        self.message = tree
        self.fast = 0
        self.general = 0
        self._type = message

    def decode(self, data: NDArray[np.uint8], start: Ints, length: Ints, fields: Sequence[str]) -> Decoded:
        """Return the fields of the messages that lie at data[start[i] : start[i] + length[i]]."""
        parts = {path: resolve(self.message, path) for path in fields}
        wanted = _wanted(fields)
        good, bad = np.ones(len(start), bool), Counter[str]()
        objects: list[dict[str, Value]] = []
        for i, (at, n) in enumerate(zip(start.tolist(), length.tolist(), strict=True)):
            try:
                objects.append(_Reader(data[at : at + n].tobytes()).message(self._type, wanted))
            except MalformedError as problem:
                good[i] = False
                bad[str(problem)] += 1
        self.general += len(objects)
        return Decoded(good, {path: column(objects, path, part) for path, part in parts.items()}, bad)


def _wanted(fields: Sequence[str]) -> Wanted:
    """Return the tree of what is wanted; of several names of one field all are."""
    tree: dict[str, Any] = {}
    for path in (name for field in fields for name in field.split(OR)):
        at = tree
        for name in path.removesuffix(f".{LENGTH}").split("."):
            at = at.setdefault(name, {})
    return tree


class _Reader:
    """One message: every byte is checked, so that the verdict does not depend on what is wanted."""

    def __init__(self, data: bytes) -> None:
        if len(data) > MAX_MESSAGE:
            raise MalformedError(f"longer than {MAX_MESSAGE >> 20} MiB")
        self.data = data
        self.items = 0

    def message(self, kind: Message, wanted: Wanted) -> dict[str, Value]:
        """Return the wanted parts of the message."""
        return self._parts(kind, wanted, 0, len(self.data), 0)

    def _parts(self, kind: Message, wanted: Wanted, at: int, end: int, depth: int) -> dict[str, Value]:
        if depth > MAX_DEPTH:
            raise MalformedError(f"more than {MAX_DEPTH} structures in structures")
        found = _defaults(kind, wanted)
        for number, wire, first, stop in walk(self.data, at, end):
            field = kind.fields.get(number)
            if field is not None and field.inside is not None and wire == BYTES:
                self._inside(found, field, field.inside, wanted.get(field.name), (first, stop, depth))
            elif field is not None:
                self._value(found, field, wire, first, stop)
        return found

    def _inside(
        self,
        found: dict[str, Value],
        field: Field,
        kind: Message,
        wanted: Wanted | None,
        where: tuple[int, int, int],
    ) -> None:
        """Read a message in the message."""
        self._count()
        first, stop, depth = where
        if kind.is_time:
            value = self._time(first, stop)
        else:
            value = self._parts(kind, NOTHING if wanted is None else wanted, first, stop, depth + 1)
        if wanted is None:
            return
        if field.repeated:
            found[field.name].append(value)
        else:
            found[field.name] = value

    def _time(self, first: int, stop: int) -> dict[str, int]:
        """Return seconds and nanoseconds."""
        parts = dict.fromkeys(TIME_PARTS.values(), 0)
        for number, wire, at, end in walk(self.data, first, stop):
            if number in TIME_PARTS and wire == 0:
                parts[TIME_PARTS[number]] = _signed(varint(self.data, at, end)[0])
        return parts

    def _value(self, found: dict[str, Value], field: Field, wire: int, first: int, stop: int) -> None:
        """Take a number, an array of numbers, a text or bytes."""
        packed = bool(field.dtype) and wire == BYTES and field.repeated
        if not packed and wire != field.wire:
            return
        if packed:
            self._check_packed(field, first, stop)
        elif field.repeated:
            self._count()
        if field.text and stop - first > MAX_TEXT:
            raise MalformedError(f"a text longer than {MAX_TEXT >> 20} MiB")
        if field.name not in found:
            return
        if packed:
            found[field.name].extend(_packed(self.data[first:stop], field))
        elif field.repeated:
            found[field.name].append(_single(self.data, first, stop, field))
        else:
            found[field.name] = _single(self.data, first, stop, field)

    def _check_packed(self, field: Field, first: int, stop: int) -> None:
        size = FIXED_SIZE.get(field.wire)
        if size is not None:
            whole = (stop - first) % size == 0
        else:
            ends = np.flatnonzero(np.frombuffer(self.data, np.uint8, stop - first, first) < 0x80)
            longest = np.diff(ends, prepend=-1).max(initial=0)
            whole = stop == first or (bool(len(ends)) and ends[-1] == stop - first - 1 and longest <= MAX_VARINT)
        if not whole:
            raise MalformedError("an array that ends within a number")

    def _count(self) -> None:
        """Refuse what would take minutes to walk."""
        self.items += 1
        if self.items > MAX_ITEMS:
            raise MalformedError(f"more than {MAX_ITEMS} strings and structures of their own length")


def _defaults(kind: Message, wanted: Wanted) -> dict[str, Value]:
    """Return what the wanted fields are where the bytes leave them out."""
    if not wanted:
        return {}
    found: dict[str, Value] = {}
    for field in kind.fields.values():
        if field.name not in wanted:
            continue
        if field.repeated:
            found[field.name] = []
        elif field.inside is not None:
            found[field.name] = {} if field.inside.is_time else _defaults(field.inside, wanted[field.name])
        else:
            found[field.name] = 0.0 if field.dtype else "" if field.text else b""
    return found


def _single(data: bytes, first: int, stop: int, field: Field) -> Value:
    if not field.dtype:
        value = data[first:stop]
        return value.decode("utf-8", "replace") if field.text else value
    if field.wire in FIXED_SIZE:
        return np.frombuffer(data, field.dtype, 1, first)[0].item()
    return _number(varint(data, first, stop)[0], field.dtype)


def _packed(data: bytes, field: Field) -> list[Any]:
    if field.wire in FIXED_SIZE:
        return list(np.frombuffer(data, field.dtype).tolist())
    found, at = [], 0
    while at < len(data):
        value, at = varint(data, at, len(data))
        found.append(_number(value, field.dtype))
    return found


def _number(value: int, dtype: str) -> float:
    """Return the number that a varint of 64 bits means."""
    if dtype[0] == "z":
        value &= 0xFFFFFFFF if dtype == "z4" else 0xFFFFFFFFFFFFFFFF
        return (value >> 1) ^ -(value & 1)
    if dtype == "?":
        return bool(value)
    if dtype[1] == "4":  # of 32 bits the lower half counts
        value &= 0xFFFFFFFF
        return value - (1 << 32) if dtype[0] == "i" and value >= 1 << 31 else value
    return _signed(value) if dtype[0] == "i" else value


def _signed(value: int) -> int:
    return value - (1 << 64) if value >= 1 << 63 else value
