"""Decoding of JSON messages into columns; conversion of Python objects to columns (also for Protobuf).

A missing value becomes NaN, "" or an empty array. An invalid time becomes 0; logs.clock replaces such times.
"""

from __future__ import annotations

import base64
import binascii
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.formats.columns import Bytes
from locfuse.formats.inputs import MAX_DEPTH, MAX_MESSAGE
from locfuse.formats.text import writable
from locfuse.fusion.data import Column, Ints, Ragged, totals

from .schema import (
    TIME_TYPES,
    Decoded,
    FieldPart,
    LengthCounts,
    Many,
    MessageDecoder,
    Node,
    Scalar,
    SchemaError,
    Structure,
    Text,
    refuse_large,
    resolve,
)

NUMBER = Scalar("f8", 8)
WHOLE = Scalar("i8", 8)
TIME = Structure(min(TIME_TYPES - {"builtin_interfaces/msg/Duration"}), {"sec": WHOLE, "nanosec": WHOLE})
NANOSECONDS = ("nsec", "nanosec", "nsecs")
NAN = float("nan")


def column(objects: list[dict[str, Any]], path: str, parts: tuple[FieldPart, ...]) -> Column:
    """Return one field of all messages as a column; `parts` is the resolved `path`.

    The inner arrays of an array become one row of a message; for a field "PATH.length", the row has their lengths.
    """
    part = parts[0]
    path = part.path.rpartition(".")[0] if len(parts) == 2 else part.path
    values = [_at(one, path.split(".")) for one in objects]
    node = TIME if len(parts) == 2 else part.node
    many = isinstance(node, Many)
    if not part.inside and not many:
        return [_text(v) for v in values] if isinstance(node, Text) else _scalars(node, values)
    if isinstance(node, Many):
        node = node.element
    if not part.inside and isinstance(node, Scalar) and node.dtype == "u1":
        return [_bytes(value) for value in values]
    rows = [_listed(value) for value in values]
    if isinstance(node, LengthCounts):
        return _ragged([np.array([len(_listed(v)) for v in row], np.int64) for row in rows], "i8")
    for _ in range(part.depth - (not many)):  # lists in lists become one list
        rows = [[v for one in row for v in _listed(one)] for row in rows]
    if isinstance(node, Text):
        return [tuple(_text(v) for v in row) for row in rows]
    if many:
        return _ragged([_floats(row) for row in rows], "f8")
    return _ragged([_scalars(node, row) for row in rows], _dtype(node))


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _at(value: Any, names: Sequence[str]) -> Any:
    """Return the value at a path of names in nested JSON objects; None if it is missing.

    For a list of objects, return the list of their values.
    """
    for i, name in enumerate(names):
        if isinstance(value, list):
            return [_at(one, names[i:]) for one in value]
        value = value.get(name) if isinstance(value, dict) else None
    return value


def _scalars(node: Node, values: list[Any]) -> NDArray[Any]:
    convert = _nanoseconds if node is TIME else bool if _dtype(node) == "?" else _number
    return np.array([convert(value) for value in values], _dtype(node))


def _dtype(node: Node) -> str:
    return "i8" if node is TIME else node.dtype if isinstance(node, Scalar) else "f8"


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return NAN


def _nanoseconds(value: Any) -> int:
    """Return a time {sec, nsec} in ns; 0 for an invalid one."""
    if not isinstance(value, dict):
        return 0
    fraction = next((value[key] for key in NANOSECONDS if key in value), 0)
    total = _number(value.get("sec", 0)), _number(fraction)
    if not all(abs(one) < 2**32 for one in total):
        return 0
    return int(total[0]) * 10**9 + int(total[1])


def _text(value: Any) -> str:
    return writable(value) if isinstance(value, str) else ""  # JSON can contain half a surrogate pair


def _bytes(value: Any) -> bytes:
    try:
        return value if isinstance(value, bytes) else base64.b64decode(value)
    except (TypeError, ValueError, binascii.Error):
        return b""


def _floats(row: list[Any]) -> NDArray[Any]:
    try:
        numbers = np.array(row, float)  # None (NaN in JSON) becomes NaN
    except (TypeError, ValueError, OverflowError):
        numbers = np.empty((0, 0))
    return numbers if numbers.ndim == 1 else np.array([_number(value) for value in row], float)


def _ragged(rows: list[NDArray[Any]], dtype: str) -> Ragged:
    first = totals([len(row) for row in rows], np.int64)
    return Ragged(np.concatenate([np.empty(0, dtype), *rows]).astype(dtype), first)


# --- JSON messages, such as Foxglove's

SCALARS: dict[str, Node] = {"number": NUMBER, "integer": NUMBER, "boolean": Scalar("?", 1), "string": Text()}


def parse_jsonschema(name: str, text: str) -> Structure:
    """Return a JSON schema (numbers, strings, base64 bytes, arrays, objects, times) as a tree."""
    try:
        refuse_large(name, "jsonschema", text)
        tree = _node(name, msgspec.json.decode(text), 0)
    except (msgspec.DecodeError, RecursionError, UnicodeEncodeError):
        raise SchemaError(f"its jsonschema definition of {name} cannot be parsed") from None
    if not isinstance(tree, Structure):
        raise SchemaError(f"its jsonschema definition of {name} is not that of an object")
    return tree


def _node(name: str, schema: Any, depth: int) -> Node | None:
    """Return a part of a JSON schema as a tree; None if its kind is not supported."""
    if not isinstance(schema, Mapping) or depth > MAX_DEPTH:
        return None
    kind = schema.get("type")
    if isinstance(kind, list):  # such as ["number", "null"]
        kind = next((k for k in kind if k != "null"), None)
    if kind == "array":
        element = _node(name, schema.get("items"), depth + 1)
        return Many(element, None) if element is not None else None
    if kind != "object":
        if schema.get("contentEncoding") == "base64":
            return Many(Scalar("u1", 1), None)
        return SCALARS.get(str(kind))
    properties = schema.get("properties")
    if not isinstance(properties, Mapping):
        return None
    if "sec" in properties and len(properties) == 2 and not properties.keys().isdisjoint(NANOSECONDS):
        return TIME
    # empty keys and keys with a dot cannot be part of a dotted path
    parts = {key: _node(key, value, depth + 1) for key, value in properties.items() if key and "." not in key}
    return Structure(name, {key: node for key, node in parts.items() if node is not None})


class JsonDecoder(MessageDecoder):
    """Decodes JSON messages of one type into columns."""

    def decode(self, data: Bytes, start: Ints, length: Ints, fields: Sequence[str]) -> Decoded:
        """Return the fields of the messages data[start[i] : start[i] + length[i]] as columns."""
        places = zip(start.tolist(), length.tolist(), strict=True)
        objects: list[Any] = []
        for at, n in places:
            text = data[at : at + n].tobytes() if n <= MAX_MESSAGE else b""
            try:
                objects.append(msgspec.json.decode(text))
            except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
                try:
                    objects.append(json.loads(text))  # accepts NaN and Infinity, which some writers use
                except (ValueError, RecursionError):
                    objects.append(None)
        good = np.array([isinstance(one, dict) for one in objects], bool)
        found = [one for one in objects if isinstance(one, dict)]
        columns = {path: column(found, path, resolve(self.message, path)) for path in fields}
        return Decoded(good, columns, +Counter({"not a JSON object": len(objects) - len(found)}))
