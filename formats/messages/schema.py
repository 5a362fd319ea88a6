"""Message definitions (ros2msg, ros2idl, ros1msg) as trees of fields."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, cast

import msgspec

from locfuse.formats.caps import (
    MAX_DEFINITION,
    MAX_DEFINITION_LINES,
    MAX_DEPTH,
    MAX_EXPRESSIONS,
    MAX_FIELDS,
    refuse_above,
)
from locfuse.formats.columns import Bytes
from locfuse.formats.container.source import message_type
from locfuse.fusion.data import Column, Ints, Mask

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc, Typesdict

DTYPES = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
TIMES = frozenset({"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"})
FILLER = "structure_needs_at_least_one_member"  # field for the byte of an empty message in CDR
DIVIDER = re.compile(r"^={20,}\s*$", re.MULTILINE)
EXPRESSION = re.compile(r"\[|=+")  # beginning of an expression in IDL; a divider line (===) counts once


class SchemaError(ValueError):
    """Error: a message definition cannot be used; the text is the reason."""


class Scalar(msgspec.Struct, frozen=True, eq=False):
    """One number."""

    dtype: str  # NumPy letter and size, e.g. "f8"; "?" for bool
    size: int  # bytes, equal to its alignment in CDR


class Text(msgspec.Struct, frozen=True, eq=False):
    """A string."""


class Many(msgspec.Struct, frozen=True, eq=False):
    """Array with `count` elements; None: each message gives the number in a length word."""

    element: Node
    count: int | None


class Structure(msgspec.Struct, frozen=True, eq=False):
    """A message or a nested message."""

    name: str
    fields: dict[str, Node]

    @property
    def is_time(self) -> bool:
        """Whether this is a time or duration, which becomes one number of nanoseconds."""
        whole = [isinstance(part, Scalar) and part.dtype[0] in "iu" for part in self.fields.values()]
        return self.name in TIMES and whole == [True, True]


class LengthCounts(msgspec.Struct, frozen=True, eq=False):
    """The type of the field "PATH.length": the length of each array inside an outer array."""


Node = Scalar | Text | Many | Structure | LengthCounts


def parse(name: str, encoding: str, text: str, filler: bool = True) -> Structure:
    """Return message type `name` as a tree; its definition `text` is in the language `encoding`.

    `filler`: an empty message takes a byte, as in ROS 2.
    """
    from rosbags.typesys import TypesysError

    msgtype = message_type(name)
    refuse_large(msgtype, encoding, text)
    try:
        types = _types(msgtype, encoding, text.replace("\r\n", "\n"))
    except (TypesysError, RecursionError, ValueError, KeyError, AssertionError, TypeError):
        raise SchemaError(f"its {encoding} definition of {msgtype} cannot be parsed") from None
    tree = _Trees(types, filler).record(msgtype, 0)
    refuse_many_fields(tree)
    return tree


def refuse_many_fields(tree: Structure) -> None:
    """Raise SchemaError if a message has more than MAX_FIELDS fields; nested types count at every use."""
    what = f"its definition of {tree.name} unfolds to too many fields"
    refuse_above(what, count_fields(tree, {}), MAX_FIELDS, error=SchemaError)


def count_fields(node: Node, known: dict[int, int]) -> int:
    """Return the number of fields of a tree; `known` is a cache, id of a structure -> number."""
    if isinstance(node, Many):
        return count_fields(node.element, known)
    if not isinstance(node, Structure):
        return 1
    if id(node) not in known:
        known[id(node)] = 1 + sum(count_fields(part, known) for part in node.fields.values())
    return known[id(node)]


def refuse_large(name: str, encoding: str, text: str) -> None:
    """Raise SchemaError for a definition that the parser would need minutes for."""
    lines = sum(1 for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#"))
    expressions = len(EXPRESSION.findall(text)) if encoding == "ros2idl" else 0
    for found, cap, unit in (
        (len(text), MAX_DEFINITION, "characters"),
        (lines, MAX_DEFINITION_LINES, "lines"),
        (expressions, MAX_EXPRESSIONS, "arrays and constants"),
    ):
        refuse_above(f"its {encoding} definition of {name} is too long", found, cap, unit, SchemaError)


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


class _Trees:
    """Builds the tree of each type in a definition once; all uses of a type share this tree."""

    def __init__(self, types: Typesdict, filler: bool) -> None:
        self._types = types
        self._filler = {FILLER: Scalar("u1", 1)} if filler else {}
        self._made: dict[str, Structure] = {}
        self._height: dict[str, int] = {}  # type -> depth of the nested structures in its tree

    def record(self, name: str, depth: int) -> Structure:
        """Return the tree of type `name` at the nesting depth `depth`.

        Raises SchemaError if structures are nested deeper than MAX_DEPTH.
        """
        if depth + self._height.get(name, 0) > MAX_DEPTH:
            raise SchemaError(f"its definition contains itself, or nests more than {MAX_DEPTH} structures")
        if name not in self._made:
            made = self._new(name, depth)
            parts = (part.element if isinstance(part, Many) else part for part in made.fields.values())
            heights = (1 + self._height.get(part.name, 0) for part in parts if isinstance(part, Structure))
            self._made[name], self._height[name] = made, max(heights, default=0)
        return self._made[name]

    def _new(self, name: str, depth: int) -> Structure:
        if name not in self._types:
            if name in TIMES:
                return Structure(name, {"sec": Scalar("i4", 4), "nanosec": Scalar("u4", 4)})
            raise SchemaError(f"its definition names {name} and does not define it")
        fields = {field: self._node(desc, depth + 1) for field, desc in self._types[name][1]}
        return Structure(name, fields or dict(self._filler))

    def _node(self, desc: FieldDesc, depth: int) -> Node:
        kind, detail = desc[0].name, desc[1]
        if kind == "NAME":
            return self.record(str(detail), depth)
        if kind == "BASE":
            base = str(detail[0])
            if base != "string" and base not in DTYPES:
                raise SchemaError(f"its definition uses {base}, which is not supported")
            return Text() if base == "string" else Scalar(DTYPES[base], int(DTYPES[base][1:] or 1))
        element, size = cast("tuple[FieldDesc, int]", detail)
        return Many(self._node(element, depth), size if kind == "ARRAY" else None)


def signature(node: Node) -> object:
    """Return a hashable value that is equal for trees with equal columns."""
    if isinstance(node, Structure):
        return tuple((name, signature(part)) for name, part in node.fields.items())
    if isinstance(node, Many):
        return (node.count, signature(node.element))
    return node.dtype if isinstance(node, Scalar) else "text"


# --- The interface of decoders of all encodings


class Decoded(NamedTuple):
    """The readable messages of one channel in one batch, as columns."""

    good: Mask  # (k,) mask of the readable messages, which are the rows
    columns: dict[str, Column]
    bad: Counter[str]  # reason -> number of unreadable messages


class MessageDecoder(ABC):
    """Decodes messages of one type into columns.

    Whether a message is valid must not depend on the decoded fields.
    """

    def __init__(self, message: Structure) -> None:
        self.message = message

    @abstractmethod
    def decode(self, data: Bytes, start: Ints, length: Ints, fields: Sequence[str]) -> Decoded:
        """Return the fields of the messages data[start[i] : start[i] + length[i]] as columns."""
