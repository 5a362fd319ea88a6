"""Decoding of CDR and ROS 1 messages into columns: one field of all messages of a chunk at a time.

The layout of a message depends only on the length words of its strings and arrays. So messages are grouped by
layout. The first message of a group is parsed (`read_layout`), and the length words of all others are compared
with its words at once. Then each wanted field of the group is gathered from the chunk at once. Only an array of
numbers at the end of a message (the bytes of an image) may differ in length within a group. Each new layout costs
time: unusual messages are decoded slowly, but correctly.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.formats.columns import Bytes, nested, view
from locfuse.formats.inputs import MAX_ITEMS, MAX_TEXT
from locfuse.fusion.data import Column, Ints, Mask, Ragged, totals
from locfuse.fusion.streams import concat, take

from .schema import Decoded, FieldPart, LengthCounts, Many, MessageDecoder, Node, Scalar, Structure, Text, resolve

UINT32 = struct.Struct("<I")


class MalformedError(ValueError):
    """Error: a message does not fit its definition; the text is the reason."""


class LayoutRules(NamedTuple):
    """The rules of a serialisation format (CDR, ROS 1): header, alignment, end of strings, padding."""

    header: int  # bytes before the first value; alignment is relative to their end
    aligned: bool  # numbers are at multiples of their size
    nul: int  # bytes that end a string and count in its length
    spare: int  # bytes of padding allowed at the end


CDR = LayoutRules(header=4, aligned=True, nul=1, spare=3)  # OMG DDSI-RTPS, plain CDR as in ROS 2
ROS1 = LayoutRules(header=0, aligned=False, nul=0, spare=0)

# Wanted parts of a message: field name -> wanted parts of the field, or its dotted path if it is a wanted leaf.
Wanted = Mapping[str, "Wanted | str"]


class Leaf(msgspec.Struct):
    """The offset of a wanted field in a message; several offsets if the field is inside an array."""

    offsets: list[int] = []  # bytes from the payload's start
    counts: list[int] = []  # elements (arrays) or bytes (strings) at each offset


class Tail(NamedTuple):
    """An array of numbers of variable length at the end of a message."""

    spot: int  # offset of the array's length word
    start: int  # offset of the first element
    size: int  # bytes of an element
    path: str | None  # field path if it is wanted


class Layout(msgspec.Struct, frozen=True, eq=False):
    """Byte offsets of the wanted fields, for all messages with equal length and equal length words.

    These messages have `length` bytes, and `words` (lengths of strings and arrays) at the byte offsets `spots`. If
    there is a tail, its length word is not in `words`, and message lengths may differ.
    """

    length: int
    little: bool  # byte order of the numbers
    spots: Ints  # (s,)
    words: NDArray[np.uint32]  # (s,) the 4 bytes at each spot
    leaves: dict[str, Leaf]
    tail: Tail | None


def read_layout(message: Structure, wanted: Wanted, payload: memoryview, rules: LayoutRules) -> Layout:
    """Return a message's layout. Raises MalformedError unless the message fills `payload` (except padding)."""
    walk = _LayoutWalk(payload, rules)
    try:
        walk.step(message, wanted)
    except struct.error:
        raise MalformedError("shorter than its type") from None
    walk.room(0)
    if len(payload) - walk.at > rules.spare:
        raise MalformedError("longer than its type")
    tail = walk.tail if walk.at == walk.tail_end else None
    if tail:
        walk.spots.pop()
    words = np.array([UINT32.unpack_from(payload, spot)[0] for spot in walk.spots], "<u4")
    return Layout(len(payload), walk.little, np.array(walk.spots, np.int64), words, walk.leaves, tail)


class _LayoutWalk:
    def __init__(self, payload: memoryview, rules: LayoutRules) -> None:
        self.payload = payload
        self.rules = rules
        self.at = rules.header
        self.items = 0
        self.spots: list[int] = []
        self.leaves: dict[str, Leaf] = {}
        self.tail: Tail | None = None  # the last sequence of numbers
        self.tail_end = -1
        self.nested = 0  # number of arrays around the current position
        self.little = True  # byte order of the numbers
        if rules.header:
            kind = bytes(payload[:2])
            if len(payload) < rules.header:
                raise MalformedError("shorter than its type")
            if kind not in {b"\x00\x00", b"\x00\x01"}:
                raise MalformedError("not plain CDR")
            self.spots.append(0)
            self.little = kind == b"\x00\x01"
        self.word = struct.Struct("<I" if self.little else ">I")

    def room(self, n: int) -> None:
        """Raise MalformedError if fewer than n bytes remain."""
        if self.at + n > len(self.payload):
            raise MalformedError("shorter than its type")

    def step(self, node: Node, wanted: Wanted | str | None) -> None:
        """Advance over one value, and store the byte offsets of its fields that are in `wanted`."""
        if wanted is None and (size := fixed_size(node, self._phase(), self.rules.aligned)) is not None:
            self.at += size
        elif isinstance(node, Scalar):
            self._numbers(node, 1, wanted)
        elif isinstance(node, Text):
            self._text(wanted)
        elif isinstance(node, Structure):
            parts = wanted if isinstance(wanted, Mapping) else {}
            for name, part in node.fields.items():
                self.step(part, parts.get(name))
        elif isinstance(node, Many):
            self._many(node, wanted)

    def _phase(self) -> int:
        return (self.at - self.rules.header) % 8

    def _align(self, size: int) -> None:
        if self.rules.aligned:
            self.at += -(self.at - self.rules.header) % size

    def _length(self) -> int:
        """Read a length word and store its offset."""
        self._align(4)
        (n,) = self.word.unpack_from(self.payload, self.at)
        self.spots.append(self.at)
        self.at += 4
        self.room(n)  # an element takes at least one byte
        return int(n)

    def _store_leaf(self, wanted: Wanted | str | None, count: int) -> None:
        if isinstance(wanted, str):
            leaf = self.leaves.setdefault(wanted, Leaf())
            leaf.offsets.append(self.at)
            leaf.counts.append(count)

    def _numbers(self, node: Scalar, count: int, wanted: Wanted | str | None) -> None:
        if count:
            self._align(node.size)
        self.room(count * node.size)
        self._store_leaf(wanted, count)
        self.at += count * node.size

    def _text(self, wanted: Wanted | str | None) -> None:
        n = self._length()
        if n > MAX_TEXT:
            raise MalformedError(f"a text longer than {MAX_TEXT >> 20} MiB")
        self._store_leaf(wanted, max(n - self.rules.nul, 0))
        self.at += n

    def _many(self, node: Many, wanted: Wanted | str | None) -> None:
        count = self._length() if node.count is None else node.count
        if isinstance(node.element, Scalar):
            may_be_tail = node.count is None and not (self.nested and wanted is not None)
            if may_be_tail:
                padding = -(self.at - self.rules.header) % node.element.size if self.rules.aligned else 0
                path = wanted if isinstance(wanted, str) else None
                self.tail = Tail(self.at - 4, self.at + padding, node.element.size, path)
            self._numbers(node.element, count, wanted)
            self.tail_end = self.at if may_be_tail else -1
            return
        size = _fixed_run(node.element, count, self._phase(), self.rules.aligned)
        if size is None:
            self.items += count
            if self.items > MAX_ITEMS:  # independent of the wanted fields, so that validity is too
                raise MalformedError(f"more than {MAX_ITEMS} strings and structures of their own length")
        else:
            self.room(size)
            if wanted is None:
                self.at += size
                return
        self.nested += 1
        for _ in range(count):
            self.step(node.element, wanted)
        self.nested -= 1


@lru_cache(maxsize=4096)
def fixed_size(node: Node, phase: int, aligned: bool) -> int | None:
    """Return the size [bytes] of a value with the padding for its alignment; None if the size varies.

    `phase` is the byte offset of the value modulo 8.
    """
    if isinstance(node, Scalar):
        return node.size + (-phase % node.size if aligned else 0)
    if isinstance(node, Structure):
        size = 0
        for part in node.fields.values():
            more = fixed_size(part, (phase + size) % 8, aligned)
            if more is None:
                return None
            size += more
        return size
    if isinstance(node, Many) and node.count is not None:
        return _fixed_run(node.element, node.count, phase, aligned)
    return None


@lru_cache(maxsize=4096)
def _fixed_run(element: Node, count: int, phase: int, aligned: bool) -> int | None:
    """Return the size [bytes] of `count` successive elements with alignment; None if the size varies."""
    if count < 2:
        return fixed_size(element, phase, aligned) if count else 0
    first = _fixed_run(element, count // 2, phase, aligned)
    if first is None:
        return None
    rest = _fixed_run(element, count - count // 2, (phase + first) % 8, aligned)
    return None if rest is None else first + rest


# --- Columns of many messages


MAX_LAYOUTS = 64  # layouts kept from chunk to chunk
MAX_GROUPS = 64  # new layouts per chunk; after these, each message is parsed alone
MAX_GATHERED_WORDS = 1 << 21  # length words compared in one operation


class Group(NamedTuple):
    """Messages that share a layout."""

    rows: Ints  # indices in the batch
    layout: Layout
    tails: Ints  # (rows,) number of elements of the tail; 0 without a tail


NOTHING: Ints = np.empty(0, np.int64)
NO_MESSAGES = Group(NOTHING, Layout(0, True, NOTHING, NOTHING.astype(np.uint32), {}, None), NOTHING)


class Request(msgspec.Struct):
    """Resolved fields of one message type, with the layouts found so far."""

    fields: dict[str, tuple[FieldPart, ...]]  # (seconds, nanoseconds) for a stamp
    wanted: Wanted
    layouts: list[Layout] = []  # most recent first


class Decoder(MessageDecoder):
    """Decodes CDR or ROS 1 messages of one type into columns."""

    def __init__(self, message: Structure, rules: LayoutRules = CDR) -> None:
        super().__init__(message)
        self.rules = rules
        self._requests: dict[tuple[str, ...], Request] = {}

    def decode(self, data: Bytes, start: Ints, length: Ints, fields: Sequence[str]) -> Decoded:
        """Return the fields of the messages data[start[i] : start[i] + length[i]] as columns."""
        key = tuple(fields)
        if key not in self._requests:
            resolved = {path: resolve(self.message, path) for path in key}
            paths = [part.path for parts in resolved.values() for part in parts]
            self._requests[key] = Request(resolved, nested(dict(zip(paths, paths, strict=True))))
        request = self._requests[key]
        groups, bad = self._groups(data, start, length, request)
        good = np.zeros(len(start), bool)
        for group in groups:
            good[group.rows] = True
        columns = {name: _gather(data, start, groups, parts) for name, parts in request.fields.items()}
        return Decoded(good, columns, bad)

    def _groups(
        self, data: Bytes, start: Ints, length: Ints, request: Request
    ) -> tuple[list[Group], Counter[str]]:
        """Return the messages in groups of equal layout, and reason -> number of malformed messages.

        First come the known layouts. Then the first message left is parsed, and all messages with its layout form
        a group; this repeats with the other messages.
        """
        rows, spare = np.arange(len(start)), self.rules.spare
        groups: list[Group] = []
        bad: Counter[str] = Counter()
        for layout in list(request.layouts):
            same, tails = _same(data, start[rows], length[rows], layout, spare)
            if same.any():
                groups.append(Group(rows[same], layout, tails[same]))
                rows = rows[~same]
                request.layouts.remove(layout)
                request.layouts.insert(0, layout)
        i, most = 0, len(groups) + MAX_GROUPS
        while i < len(rows):
            at, n = int(start[rows[i]]), int(length[rows[i]])
            try:
                layout = read_layout(self.message, request.wanted, data[at : at + n].data, self.rules)
            except MalformedError as problem:
                bad[str(problem)] += 1
                i += 1
                continue
            alone = len(groups) >= most
            rest = rows[i : i + 1] if alone else rows[i:]
            same, tails = _same(data, start[rest], length[rest], layout, spare)
            groups.append(Group(rest[same], layout, tails[same]))
            if alone:
                i += 1
            else:
                request.layouts = [layout, *request.layouts[: MAX_LAYOUTS - 1]]
                rows, i = rest[~same], 0
        return groups, bad


def _same(data: Bytes, start: Ints, length: Ints, layout: Layout, spare: int) -> tuple[Mask, Ints]:
    """Return the mask (k,) of the messages that have `layout`, and the lengths (k,) of their last array."""
    tail = layout.tail
    tails = np.zeros(len(start), np.int64)
    same = length == layout.length if tail is None else length >= tail.spot + 4
    near = np.flatnonzero(same)
    if tail is not None and len(near):
        count = _numbers(data, start[near] + tail.spot, "u4", layout.little).astype(np.int64)
        end = np.where(count > 0, tail.start + count * tail.size, tail.spot + 4)
        fits = (end <= length[near]) & (length[near] - end <= spare)
        tails[near] = count
        same[near] = fits
        near = near[fits]
    if len(layout.spots):
        step = max(MAX_GATHERED_WORDS // len(layout.spots), 1)
        for i in range(0, len(near), step):
            some = near[i : i + step]
            words = view(data, "<u4", start[some, None] + layout.spots)
            same[some] = (words == layout.words).all(axis=1)
    return same, tails


def _gather(data: Bytes, start: Ints, groups: list[Group], parts: tuple[FieldPart, ...]) -> Column:
    """Return one field of all messages as a column, in the order of the batch."""
    if len(parts) == 2:
        seconds, nanoseconds = (_gather(data, start, groups, (part,)) for part in parts)
        if isinstance(seconds, Ragged) and isinstance(nanoseconds, Ragged):
            return Ragged(seconds.values.astype(np.int64) * 10**9 + nanoseconds.values, seconds.first)
        total: Ints = np.asarray(seconds).astype(np.int64) * 10**9 + np.asarray(nanoseconds)
        return total
    pieces = [_leaf(data, start[group.rows], group, parts[0]) for group in groups or (NO_MESSAGES,)]
    column = concat(pieces)
    if len(pieces) == 1:
        return column
    return take(column, np.argsort(np.concatenate([group.rows for group in groups]), kind="stable"))


def _leaf(data: Bytes, start: Ints, group: Group, part: FieldPart) -> Column:
    """Return one field of a group's messages as a column."""
    # without messages only the type of the column matters, so any offset will do
    leaf = group.layout.leaves.get(part.path, Leaf() if len(start) else Leaf([0], [0]))
    node = part.node
    if isinstance(node, Scalar):
        offsets = np.array(leaf.offsets, np.int64)
        values = _numbers(data, start[:, None] + offsets, node.dtype, group.layout.little)
        return _rows(values) if part.inside else values[:, 0]
    if isinstance(node, LengthCounts):
        return _rows(np.tile(np.array(leaf.counts, np.int64), (len(start), 1)))
    if isinstance(node, Many) and isinstance(node.element, Scalar) and part.inside:  # all inner arrays in a row
        counts = np.array(leaf.counts, np.int64)
        inside = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        offsets = np.repeat(np.array(leaf.offsets, np.int64), counts) + node.element.size * inside
        return _rows(_numbers(data, start[:, None] + offsets, node.element.dtype, group.layout.little))
    if isinstance(node, Text) and not part.inside:
        texts = _text(data, start + leaf.offsets[0], leaf.counts[0])
        return texts * (len(start) // len(texts))
    if isinstance(node, Many) and isinstance(node.element, Scalar):
        return _array(data, start, group, leaf, part)
    return _texts(data, start, leaf)


def _array(data: Bytes, start: Ints, group: Group, leaf: Leaf, part: FieldPart) -> Column:
    """Return an array field as a column: a matrix if its length is fixed, else ragged rows; bytes for uint8."""
    node, tail, little = cast("Many", part.node), group.layout.tail, group.layout.little
    element = cast("Scalar", node.element)
    at, counts = start + leaf.offsets[0], np.full(len(start), leaf.counts[0], np.int64)
    if tail is not None and tail.path == part.path:
        at, counts = start + tail.start, group.tails
    if node.count is None and element.dtype == "u1":
        return [data[i : i + n].tobytes() for i, n in zip(at.tolist(), counts.tolist(), strict=True)]
    n = int(counts.max(initial=0)) if node.count is None else node.count
    if (counts == n).all():
        values = np.empty((len(at), 0), element.dtype)
        if n:
            rows = view(data, f"V{n * element.size}", at).view(np.uint8).reshape(len(at), n * element.size)
            values = _native(rows.view(_stored(element.dtype, little)), element.dtype)
        return _rows(values) if node.count is None else values
    first = totals(counts)
    inside = np.arange(first[-1]) - np.repeat(first[:-1], counts)
    return Ragged(_numbers(data, np.repeat(at, counts) + element.size * inside, element.dtype, little), first)


def _numbers(data: Bytes, at: Ints, dtype: str, little: bool) -> NDArray[Any]:
    """Return the number at each byte offset, aligned or not."""
    return _native(view(data, _stored(dtype, little), at), dtype)


def _stored(dtype: str, little: bool) -> str:
    return "u1" if dtype == "?" else ("<" if little else ">") + dtype


def _native(values: NDArray[Any], dtype: str) -> NDArray[Any]:
    """Return values in the byte order of the machine.

    Signalling NaNs become quiet NaNs, so that no later computation warns.
    """
    native = values != 0 if dtype == "?" else values.astype(dtype, copy=False)
    if native.dtype.kind == "f":
        native[np.isnan(native)] = np.nan
    return native


def _rows(values: NDArray[Any]) -> Ragged:
    """Return values (n, m) as n rows of a ragged column."""
    n, m = values.shape
    return Ragged(values.reshape(-1), np.arange(n + 1) * m)


def _texts(data: Bytes, start: Ints, leaf: Leaf) -> list[tuple[str, ...]]:
    """Return the strings of an array for each message."""
    columns = [_text(data, start + offset, n) for offset, n in zip(leaf.offsets, leaf.counts, strict=True)]
    if not columns:
        return [()] * len(start)
    if all(len(column) == 1 for column in columns):
        return [tuple(column[0] for column in columns)] * len(start)
    return list(zip(*(column * (len(start) // len(column)) for column in columns), strict=True))


def _text(data: Bytes, at: Ints, n: int) -> list[str]:
    """Return the strings of n bytes at offsets `at` (k,): k strings, or only one if all are equal."""
    if not n:
        return [""]
    rows = view(data, f"V{n}", at).view(np.uint8).reshape(len(at), n)
    if (rows == rows[0]).all():
        return [rows[0].tobytes().decode("utf-8", "replace")]
    return [row.tobytes().decode("utf-8", "replace") for row in rows]
