"""Decode serialised messages into columns: a field of all messages of a chunk at once.

Messages of one length are grouped by layout: the first of a group is walked (`layout.read_layout`), the length
words that its layout depends on are compared for all the others in one go, and each wanted field is then one
gather out of the chunk. A message that differs founds a group of its own, so what is odd is slow, never wrong.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..fusion.data import Column, Ints, Ragged
from .columns import concat, take
from .fields import Part, resolve
from .layout import CDR, Layout, Leaf, MalformedError, Rules, read_layout
from .messages import Decoded
from .schema import Many, Record, Scalar, Text

Bytes = NDArray[np.uint8]

KNOWN_LAYOUTS = 32  # per message length, kept from chunk to chunk
GROUPS = 64  # layouts of one length tried on all remaining messages of a chunk; then one by one
GATHER = 1 << 21  # length words compared in one go


@dataclass
class Request:
    """A set of fields of one message type, resolved."""

    fields: dict[str, tuple[Part, ...]]  # (seconds, nanoseconds) for a stamp
    wanted: dict[str, Any] = field(default_factory=dict)
    layouts: dict[int, list[Layout]] = field(default_factory=dict)  # by message length


class Decoder:
    """Columns out of the messages of one type."""

    def __init__(self, message: Record, rules: Rules = CDR) -> None:
        self.message = message
        self.rules = rules
        self.fast = 0  # messages gathered by a layout that another message gave
        self.general = 0  # messages walked by themselves
        self._requests: dict[tuple[str, ...], Request] = {}

    def decode(self, data: Bytes, start: Ints, length: Ints, fields: Sequence[str]) -> Decoded:
        """Return the fields of the messages that lie at data[start[i] : start[i] + length[i]]."""
        request = self._request(tuple(fields))
        groups, bad = self._groups(data, start, length, request)
        good = np.zeros(len(start), bool)
        for rows, _ in groups:
            good[rows] = True
        columns = {name: _gather(data, start, groups, parts) for name, parts in request.fields.items()}
        return Decoded(good, columns, bad)

    def _request(self, fields: tuple[str, ...]) -> Request:
        if fields not in self._requests:
            request = Request({path: resolve(self.message, path) for path in fields})
            for parts in request.fields.values():
                for part in parts:
                    _want(request.wanted, part.path)
            self._requests[fields] = request
        return self._requests[fields]

    def _groups(
        self, data: Bytes, start: Ints, length: Ints, request: Request
    ) -> tuple[list[tuple[Ints, Layout]], Counter[str]]:
        """Split the messages into groups of equal layout; count the malformed ones by reason."""
        groups: list[tuple[Ints, Layout]] = []
        bad: Counter[str] = Counter()
        for n in np.unique(length).tolist():
            rows = np.flatnonzero(length == n)
            known = request.layouts.setdefault(n, [])
            for layout in known:
                same = _same(data, start[rows], layout)
                if same.any():
                    groups.append((rows[same], layout))
                    self.fast += int(same.sum())
                    rows = rows[~same]
                if not len(rows):
                    break
            groups += self._new_groups(data, start, rows, n, request, bad)
        return groups, bad

    def _new_groups(
        self, data: Bytes, start: Ints, rows: Ints, n: int, request: Request, bad: Counter[str]
    ) -> list[tuple[Ints, Layout]]:
        """Walk the first of the remaining messages, gather those like it, and so on."""
        groups: list[tuple[Ints, Layout]] = []
        i = 0
        while i < len(rows):
            at = int(start[rows[i]])
            try:
                layout = read_layout(self.message, request.wanted, data[at : at + n].data, self.rules)
            except MalformedError as problem:
                bad[str(problem)] += 1
                i += 1
                continue
            rest = rows[i:]
            same = np.zeros(len(rest), bool)
            same[0] = True
            if len(groups) < GROUPS:
                same |= _same(data, start[rest], layout)
                request.layouts[n] = [layout, *request.layouts[n][: KNOWN_LAYOUTS - 1]]
                rows, i = rest[~same], 0
            else:
                i += 1
            groups.append((rest[same], layout))
            self.general += 1
            self.fast += int(same.sum()) - 1
        return groups


def _want(tree: dict[str, Any], path: str) -> None:
    *parents, last = path.split(".")
    for name in parents:
        tree = tree.setdefault(name, {})
    tree[last] = path


def _same(data: Bytes, start: Ints, layout: Layout) -> NDArray[np.bool_]:
    """Tell which messages have the length words of a layout (they have its length already)."""
    spots = np.array(layout.spots, np.int64)
    same: NDArray[np.bool_] = np.ones(len(start), bool)
    if not len(spots):
        return same
    step = max(GATHER // len(spots), 1)
    words = np.ndarray((len(data) - 3,), "<u4", data, 0, (1,))
    expected = np.array(layout.words, "<u4")
    for i in range(0, len(start), step):
        same[i : i + step] = (words[start[i : i + step, None] + spots] == expected).all(axis=1)
    return same


def _gather(data: Bytes, start: Ints, groups: list[tuple[Ints, Layout]], parts: tuple[Part, ...]) -> Column:
    """Return one field of all groups, in the order of the messages."""
    if len(parts) == 2:
        return _nanoseconds(*(_gather(data, start, groups, (part,)) for part in parts))
    part = parts[0]
    pieces = [_leaf(data, start[rows], layout, part) for rows, layout in groups]
    if not pieces:
        return _empty(part)
    column = concat(pieces)
    if len(pieces) == 1:
        return column
    return take(column, np.argsort(np.concatenate([rows for rows, _ in groups]), kind="stable"))


def _nanoseconds(seconds: Column, nanoseconds: Column) -> Column:
    if isinstance(seconds, Ragged) and isinstance(nanoseconds, Ragged):
        return Ragged(seconds.values.astype(np.int64) * 10**9 + nanoseconds.values, seconds.first)
    total: Ints = np.asarray(seconds).astype(np.int64) * 10**9 + np.asarray(nanoseconds)
    return total


def _leaf(data: Bytes, start: Ints, layout: Layout, part: Part) -> Column:
    """Gather one field of messages that share a layout."""
    leaf = layout.leaves.get(part.path, Leaf())
    node = part.node
    if isinstance(node, Scalar):
        offsets = np.array(leaf.offsets, np.int64)
        values = _numbers(data, start[:, None] + offsets, node.dtype, layout.little)
        return _rows(values) if part.inside else values[:, 0]
    if isinstance(node, Text):
        if part.inside:
            return _texts(data, start, leaf)
        texts = _text(data, start + leaf.offsets[0], leaf.counts[0])
        return texts * (len(start) // len(texts))
    assert isinstance(node, Many)
    if isinstance(node.element, Text):
        return _texts(data, start, leaf)
    assert isinstance(node.element, Scalar)
    return _array(data, start + leaf.offsets[0], leaf.counts[0], node, layout.little)


def _array(data: Bytes, at: Ints, count: int, node: Many, little: bool) -> Column:
    assert isinstance(node.element, Scalar)
    dtype = node.element.dtype
    if node.count is None and dtype == "u1":
        return [data[i : i + count].tobytes() for i in at.tolist()]
    size = node.element.size
    if not count:
        values = np.empty((len(at), 0), dtype)
    else:
        rows = np.ndarray((len(data) - count * size + 1,), f"V{count * size}", data, 0, (1,))[at]
        values = _native(rows.view(np.uint8).reshape(len(at), -1).view(_stored(dtype, little)), dtype)
    return _rows(values) if node.count is None else values


def _numbers(data: Bytes, at: Ints, dtype: str, little: bool) -> NDArray[Any]:
    """Read a number at each offset, aligned or not."""
    stored = np.dtype(_stored(dtype, little))
    if not at.size:
        return np.empty(at.shape, dtype)
    return _native(np.ndarray((len(data) - stored.itemsize + 1,), stored, data, 0, (1,))[at], dtype)


def _stored(dtype: str, little: bool) -> str:
    return "u1" if dtype == "?" else ("<" if little else ">") + dtype


def _native(values: NDArray[Any], dtype: str) -> NDArray[Any]:
    return values != 0 if dtype == "?" else values.astype(dtype, copy=False)


def _rows(values: NDArray[Any]) -> Ragged:
    """Turn (n, m) values into n rows of a ragged column."""
    n, m = values.shape
    return Ragged(values.reshape(-1), np.arange(n + 1) * m)


def _texts(data: Bytes, start: Ints, leaf: Leaf) -> list[tuple[str, ...]]:
    """Read the strings of every message; mostly all messages have the same ones."""
    columns = [_text(data, start + offset, n) for offset, n in zip(leaf.offsets, leaf.counts, strict=True)]
    if not columns:
        return [()] * len(start)
    if all(len(column) == 1 for column in columns):
        return [tuple(column[0] for column in columns)] * len(start)
    return list(zip(*(column * (len(start) // len(column)) for column in columns), strict=True))


def _text(data: Bytes, at: Ints, n: int) -> list[str]:
    """Read a string of n bytes at each offset; one entry when all are equal."""
    if not n:
        return [""]
    rows = np.ndarray((len(data) - n + 1,), f"V{n}", data, 0, (1,))[at].view(np.uint8).reshape(len(at), n)
    if (rows == rows[0]).all():
        return [rows[0].tobytes().decode("utf-8", "replace")]
    return [row.tobytes().decode("utf-8", "replace") for row in rows]


def _empty(part: Part) -> Column:
    """Return the column of no messages."""
    node = part.node
    if isinstance(node, Text):
        return []
    element = node.element if isinstance(node, Many) else node
    if not isinstance(element, Scalar):
        return []
    ragged = part.inside or (isinstance(node, Many) and node.count is None)
    if ragged and element.dtype == "u1" and not part.inside:
        return []
    if ragged:
        return Ragged(np.empty(0, element.dtype), np.zeros(1, np.int64))
    shape = (0, node.count) if isinstance(node, Many) and node.count is not None else (0,)
    return np.empty(shape, element.dtype)
