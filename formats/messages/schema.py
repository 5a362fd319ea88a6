"""Message definitions (ros2msg, ros2idl, ros1msg) as trees of fields, and lookup of fields by dotted paths."""

from __future__ import annotations

import difflib
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from importlib.resources import files
from typing import TYPE_CHECKING, NamedTuple, cast

import msgspec

from locfuse.formats.columns import Bytes
from locfuse.formats.container.source import message_type
from locfuse.formats.inputs import (
    MAX_DEFINITION,
    MAX_DEFINITION_LINES,
    MAX_DEPTH,
    MAX_EXPRESSIONS,
    MAX_FIELDS,
    refuse_above,
)
from locfuse.fusion.data import Column, Ints, Mask

if TYPE_CHECKING:
    from rosbags.interfaces.typing import FieldDesc, Typesdict

DTYPES = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
TIME_TYPES = frozenset({"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"})
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
        return self.name in TIME_TYPES and whole == [True, True]


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
            if name in self._types:
                fields = {field: self._node(desc, depth + 1) for field, desc in self._types[name][1]}
            elif name in TIME_TYPES:
                fields = {"sec": Scalar("i4", 4), "nanosec": Scalar("u4", 4)}
            else:
                raise SchemaError(f"its definition names {name} and does not define it")
            made = Structure(name, fields or dict(self._filler))
            parts = (part.element if isinstance(part, Many) else part for part in made.fields.values())
            heights = (1 + self._height.get(part.name, 0) for part in parts if isinstance(part, Structure))
            self._made[name], self._height[name] = made, max(heights, default=0)
        return self._made[name]

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


# --- Dotted field paths ("header.stamp"): lookup in a message type, and check of the kind of a field

STAMPS = ("header.stamp", "timestamp")  # the time of measurement: ROS, Foxglove
FRAMES = ("header.frame_id", "frame_id")


class FieldError(KeyError):
    """Error: the message type lacks the field, or it cannot be a column; the text is the reason."""


class FieldPart(NamedTuple):
    """A resolved field of a message; a stamp has two parts, seconds and nanoseconds."""

    path: str
    node: Node
    inside: bool  # whether it is in an array of structures: one value per element
    depth: int = 0  # number of nested arrays around the field


LENGTH = "length"  # last name of the path to the lengths of inner arrays: "echoes.ranges.length"
OR = "|"  # separates the names of a field in different releases of a package: "k|K"


def resolve(message: Structure, path: str) -> tuple[FieldPart, ...]:
    """Return the parts of a field path; of alternatives "a|b", those of the first one in the message.

    Raises FieldError, with the most similar name, if there is no such field. Arrays inside an array become one
    concatenated column; `PATH.length` has the length of each array.
    """
    *earlier, last = path.split(OR)
    for name in (path, *earlier) if earlier else ():  # a field's own name may contain "|"
        with suppress(FieldError):
            return _resolve(message, name)
    return _resolve(message, last)


def _resolve(message: Structure, path: str) -> tuple[FieldPart, ...]:
    node: Node = message
    inside, depth = False, 0
    walked: list[str] = []
    for name in path.split("."):
        if name == LENGTH and inside and isinstance(node, Many) and not isinstance(node.element, Structure):
            return (FieldPart(".".join(walked), LengthCounts(), inside=True),)
        if isinstance(node, Many) and isinstance(node.element, Structure):
            node, inside, depth = node.element, True, depth + 1
        if not isinstance(node, Structure):
            raise FieldError(f"{'.'.join(walked)} has no parts")
        if name not in node.fields:
            near = difflib.get_close_matches(name, node.fields, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(node.fields)}"
            raise FieldError(f"{'.'.join(walked) or node.name} has no field {name!r}; {hint}")
        node = node.fields[name]
        walked.append(name)
    if isinstance(node, Many) and isinstance(node.element, Structure) and node.element.is_time and not inside:
        node, inside = node.element, True
    if isinstance(node, Structure) and node.is_time:
        return tuple(FieldPart(f"{path}.{name}", part, inside) for name, part in node.fields.items())
    if isinstance(node, Structure) or (isinstance(node, Many) and isinstance(node.element, Structure | Many)):
        raise FieldError(f"{path} is a structure: name a part of it")
    if isinstance(node, Many) and inside and not isinstance(node.element, Scalar | Text):
        raise FieldError(f"{path} is an array inside an array: it cannot be a column")
    return (FieldPart(path, node, inside, depth),)


def stamp_path(message: Structure) -> str | None:
    """Return the path of the message's stamp; None if it has no stamp."""
    return next((path for path in STAMPS if len(_resolved(message, path)) == 2), None)


def frame_path(message: Structure) -> str | None:
    """Return the path of the message's frame_id; None if it has no frame_id."""
    found = ((path, _resolved(message, path)) for path in FRAMES)
    return next((path for path, parts in found if parts and isinstance(parts[0].node, Text)), None)


def _resolved(message: Structure, path: str) -> tuple[FieldPart, ...]:
    try:
        return resolve(message, path)
    except FieldError:
        return ()


# --- Kinds of column: the kind of a field by its definition, and the kinds that locfuse accepts
# The definition of a type in a log may differ from the standard (a LaserScan whose `ranges` is one number). Such a
# field is refused before decoding.

NUMBER, TRUTH, TEXT, TIME, BYTES = "a number", "true or false", "a text", "a time", "bytes"
NUMBERS, TRUTHS, TEXTS, TIMES = "an array of numbers", "an array of true or false", "an array of texts", "times"
NINE = "9 numbers"
XYZW = ("x", "y", "z", "w")
# alternative names of a field in releases of a package
CAMERA_MATRIX = "k|K"  # ROS 2, ROS 1
CENTRE_2D = "detections.bbox.center.position.x|detections.bbox.center.x"
CLASS = "detections.results.hypothesis.class_id|detections.results.id"
TRACK_OR_CLASS = f"detections.id|{CLASS}"


class CheckedFields(msgspec.Struct):
    """The content of kinds.toml."""

    packages: frozenset[str]
    numbers: frozenset[str]
    lists: frozenset[str]
    fields: dict[str, list[str]]
    types: dict[str, list[str]]


CHECKED = msgspec.toml.decode((files(__package__) / "kinds.toml").read_bytes(), type=CheckedFields)
EXPECTED = {path: tuple(kinds.split(" | ")) for kinds, paths in CHECKED.fields.items() for path in paths}
OF_TYPE = {
    (msgtype, name): (kind,)
    for kind, lines in CHECKED.types.items()
    for msgtype, *names in map(str.split, lines)
    for name in names
}
TF = "transforms."  # one value for each transform of a message
TF_TEXTS = ("frame_id",)


def kind_of(parts: Sequence[FieldPart]) -> str:
    """Return the kind of a resolved field, such as NUMBER, TEXTS or "9 numbers"."""
    first = parts[0]
    if len(parts) == 2:
        return TIMES if first.inside else TIME
    node, many = first.node, first.inside
    if isinstance(node, LengthCounts):
        return NUMBERS
    if isinstance(node, Many):
        if isinstance(node.element, Scalar) and node.element.dtype == "u1" and node.count is None and not many:
            return BYTES
        if isinstance(node.element, Scalar) and node.element.dtype != "?" and node.count is not None and not many:
            return f"{node.count} numbers"
        node, many = node.element, True
    if isinstance(node, Text):
        return TEXTS if many else TEXT
    if isinstance(node, Scalar) and node.dtype == "?":
        return TRUTHS if many else TRUTH
    return NUMBERS if many else NUMBER


def expected(msgtype: str, path: str) -> tuple[str, ...]:
    """Return the accepted kinds of a field of a message type; () for a field that is not checked."""
    if path in STAMPS:
        return (TIME,)
    if msgtype.replace(".", "/").partition("/")[0] not in CHECKED.packages:
        return ()
    if path.startswith(("transforms.header.stamp", "poses.header.stamp")):
        return (TIMES, TIME)
    if path.startswith(TF) and OR in path:
        return (TEXTS, TEXT) if path.endswith(TF_TEXTS) else (NUMBERS, NUMBER)
    if path.startswith(TF):
        return (TEXTS,) if path.endswith(TF_TEXTS) else (NUMBERS,) if path.rpartition(".")[2] in XYZW else ()
    if kinds := OF_TYPE.get((msgtype, path)) or EXPECTED.get(path):
        return kinds
    many = not CHECKED.lists.isdisjoint(path.split(".")) or msgtype.startswith("gazebo_msgs/")
    number = path.partition(OR)[0].rpartition(".")[2] in CHECKED.numbers
    return ((NUMBERS if many else NUMBER),) if number else ()


def check_kind(msgtype: str, path: str, parts: Sequence[FieldPart]) -> None:
    """Raise FieldError if a field's kind is not accepted."""
    found, accepted = kind_of(parts), expected(msgtype, path)
    if accepted and found not in accepted:
        raise FieldError(f"{path} is {found} by its definition; accepted: {' or '.join(accepted)}")
