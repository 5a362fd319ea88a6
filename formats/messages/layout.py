"""Where the fields of one message lie: a checked walk over its bytes, remembering what the result depends on.

Strings and arrays say their own lengths, so the layout of a message depends on its length words and nothing
else: a second message with the same words at the same places has the same layout, but for the length of an
array of numbers at its very end (an image's bytes). That is what lets `cdr` gather a field of a thousand
messages at once after walking the first.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import field
from numpy.typing import NDArray

from locfuse.formats.caps import MAX_ITEMS, MAX_TEXT
from locfuse.fusion.data import Ints

from .schema import Many, Node, Record, Scalar, Text

WORD = struct.Struct("<I")


class MalformedError(ValueError):
    """A message that is not what its definition says; the message is the reason in a few words."""


class Rules(NamedTuple):
    """How a serialisation lays values out."""

    header: int  # bytes before the first value; alignment counts from behind them
    aligned: bool  # numbers stand at multiples of their size
    nul: int  # bytes that end a string and count in its length
    spare: int  # bytes of padding allowed at the end


CDR = Rules(header=4, aligned=True, nul=1, spare=3)  # OMG DDSI-RTPS, plain CDR as in ROS 2
ROS1 = Rules(header=0, aligned=False, nul=0, spare=0)

# Which parts of a message are wanted: field name -> its wanted parts, or the dotted path of a wanted leaf.
Wanted = Mapping[str, "Wanted | str"]


class Leaf(msgspec.Struct):
    """Where one wanted field lies in a message; several times where it lies inside an array."""

    offsets: list[int] = field(default_factory=list)  # bytes from the payload's start
    counts: list[int] = field(default_factory=list)  # elements (arrays) or bytes (strings) at each offset


class Tail(NamedTuple):
    """An array of numbers at the very end of a message: its length is free."""

    spot: int  # where its length word lies
    start: int  # where its elements begin, if there are any
    size: int  # bytes of an element
    path: str | None  # if it is wanted


class Layout(msgspec.Struct, frozen=True, eq=False):
    """The layout shared by all messages with `words` at the byte offsets `spots` that are `length` bytes long.

    Where there is a tail, its word is not among them and the length follows from it.
    """

    length: int
    little: bool  # byte order of its numbers
    spots: Ints  # (s,)
    words: NDArray[np.uint32]  # (s,) the 4 bytes at each spot
    leaves: dict[str, Leaf]
    tail: Tail | None


def read_layout(message: Record, wanted: Wanted, payload: memoryview, rules: Rules) -> Layout:
    """Walk one message. Raises MalformedError when it does not fill its bytes exactly (but for padding)."""
    walk = _Walk(payload, rules)
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
    words = np.array([WORD.unpack_from(payload, spot)[0] for spot in walk.spots], "<u4")
    return Layout(len(payload), walk.little, np.array(walk.spots, np.int64), words, walk.leaves, tail)


class _Walk:
    def __init__(self, payload: memoryview, rules: Rules) -> None:
        self.payload = payload
        self.rules = rules
        self.at = rules.header
        self.items = 0
        self.spots: list[int] = []
        self.leaves: dict[str, Leaf] = {}
        self.tail: Tail | None = None  # the last sequence of numbers
        self.tail_end = -1
        self.nested = 0  # arrays that the walk is in
        self.little = self._encapsulation() if rules.header else True
        self.word = struct.Struct("<I" if self.little else ">I")

    def _encapsulation(self) -> bool:
        """Read the CDR header: whether the numbers are little-endian."""
        kind = bytes(self.payload[:2])
        if len(self.payload) < self.rules.header:
            raise MalformedError("shorter than its type")
        if kind not in {b"\x00\x00", b"\x00\x01"}:
            raise MalformedError("not plain CDR")
        self.spots.append(0)
        return kind == b"\x00\x01"

    def room(self, n: int) -> None:
        """Check that n more bytes are there."""
        if self.at + n > len(self.payload):
            raise MalformedError("shorter than its type")

    def step(self, node: Node, wanted: Wanted | str | None) -> None:
        """Go over one value and remember where its wanted parts lie."""
        if wanted is None and (size := fixed_size(node, self._phase(), self.rules.aligned)) is not None:
            self.at += size
        elif isinstance(node, Scalar):
            self._numbers(node, 1, wanted)
        elif isinstance(node, Text):
            self._text(wanted)
        elif isinstance(node, Record):
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
        """Read a length word and remember its place."""
        self._align(4)
        (n,) = self.word.unpack_from(self.payload, self.at)
        self.spots.append(self.at)
        self.at += 4
        self.room(n)  # every element takes a byte or more
        return int(n)

    def _note(self, wanted: Wanted | str | None, count: int) -> None:
        if isinstance(wanted, str):
            leaf = self.leaves.setdefault(wanted, Leaf())
            leaf.offsets.append(self.at)
            leaf.counts.append(count)

    def _numbers(self, node: Scalar, count: int, wanted: Wanted | str | None) -> None:
        if count:
            self._align(node.size)
        self.room(count * node.size)
        self._note(wanted, count)
        self.at += count * node.size

    def _text(self, wanted: Wanted | str | None) -> None:
        n = self._length()
        if n > MAX_TEXT:
            raise MalformedError(f"a text longer than {MAX_TEXT >> 20} MiB")
        self._note(wanted, max(n - self.rules.nul, 0))
        self.at += n

    def _tail(self, size: int, wanted: Wanted | str | None) -> Tail:
        """Describe the sequence whose length word was just read as the last of the message."""
        padding = -(self.at - self.rules.header) % size if self.rules.aligned else 0
        return Tail(self.at - 4, self.at + padding, size, wanted if isinstance(wanted, str) else None)

    def _count_items(self, count: int) -> None:
        """Refuse what would take minutes to walk; the verdict must not depend on what is wanted."""
        self.items += count
        if self.items > MAX_ITEMS:
            raise MalformedError(f"more than {MAX_ITEMS} strings and structures of their own length")

    def _many(self, node: Many, wanted: Wanted | str | None) -> None:
        count = self._length() if node.count is None else node.count
        if isinstance(node.element, Scalar):
            free = node.count is None and not (self.nested and wanted is not None)  # of several lengths all count
            if free:
                self.tail = self._tail(node.element.size, wanted)
            self._numbers(node.element, count, wanted)
            self.tail_end = self.at if free else -1
            return
        size = _fixed_run(node.element, count, self._phase(), self.rules.aligned)
        if size is None:
            self._count_items(count)
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
    """Return the bytes a value takes, alignment included, from `phase` = offset mod 8 on; None if it depends."""
    if isinstance(node, Scalar):
        return node.size + (-phase % node.size if aligned else 0)
    if isinstance(node, Record):
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


def _fixed_run(element: Node, count: int, phase: int, aligned: bool) -> int | None:
    """Return the bytes of `count` elements in a row; their strides repeat as soon as the phase does."""
    size, i = 0, 0
    seen: dict[int, tuple[int, int]] = {}
    while i < count:
        now = (phase + size) % 8
        if now in seen:
            i_before, size_before = seen[now]
            cycles = (count - i) // (i - i_before)
            size += cycles * (size - size_before)
            i += cycles * (i - i_before)
            seen = {}
            if i == count:
                break
        seen[now] = (i, size)
        more = fixed_size(element, now, aligned)
        if more is None:
            return None
        size += more
        i += 1
    return size
