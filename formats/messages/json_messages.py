"""JSON messages, such as Foxglove's, as the same columns: a value that is missing is NaN, "" or an empty array."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.formats.caps import MAX_DEPTH, MAX_MESSAGE
from locfuse.fusion.data import Ints

from .decoded import Decoded
from .fields import resolve
from .objects import NANOSECONDS, NUMBER, TIME, column
from .schema import Many, Node, Record, Scalar, SchemaError, Text, refuse_large

SCALARS: dict[str, Node] = {"number": NUMBER, "integer": NUMBER, "boolean": Scalar("?", 1), "string": Text()}


def parse_jsonschema(name: str, text: str) -> Record:
    """Return the tree of a JSON schema: numbers, strings, base64 bytes, arrays, objects; a time is one value."""
    try:
        refuse_large(name, "jsonschema", text)
        tree = _node(name, msgspec.json.decode(text), 0)
    except (msgspec.DecodeError, RecursionError, UnicodeEncodeError):
        raise SchemaError(f"its jsonschema definition of {name} cannot be parsed") from None
    if not isinstance(tree, Record):
        raise SchemaError(f"its jsonschema definition of {name} is not that of an object")
    return tree


def _node(name: str, schema: Any, depth: int) -> Node | None:
    """Return a schema's tree, None for what cannot be a column."""
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
    # a dot separates the parts of a path, so that no path leads to a key that holds one, or to an empty one
    parts = {key: _node(key, value, depth + 1) for key, value in properties.items() if key and "." not in key}
    return Record(name, {key: node for key, node in parts.items() if node is not None})


class JsonDecoder:
    """Columns out of JSON messages."""

    def __init__(self, message: Record) -> None:
        self.message = message
        self.fast = 0
        self.general = 0

    def decode(self, data: NDArray[np.uint8], start: Ints, length: Ints, fields: Sequence[str]) -> Decoded:
        """Return the fields of the messages that lie at data[start[i] : start[i] + length[i]]."""
        objects = [
            _object(data[at : at + n].tobytes()) for at, n in zip(start.tolist(), length.tolist(), strict=True)
        ]
        found = [one for one in objects if one is not None]
        self.general += len(found)
        good = np.array([one is not None for one in objects], bool)
        columns = {path: column(found, path, resolve(self.message, path)) for path in fields}
        bad = Counter({"not a JSON object": len(objects) - len(found)}) if len(found) < len(objects) else Counter()
        return Decoded(good, columns, Counter(bad))


def _object(text: bytes) -> dict[str, Any] | None:
    value: Any = None
    if len(text) <= MAX_MESSAGE:
        try:
            value = msgspec.json.decode(text)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            try:
                value = json.loads(text)  # some writers put NaN and Infinity, which JSON does not have
            except (ValueError, RecursionError):
                return None
    return value if isinstance(value, dict) else None
