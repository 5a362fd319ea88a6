"""Dotted field paths ("header.stamp", "transforms.child_frame_id") and what of a message they mean."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from contextlib import suppress
from typing import NamedTuple

from .schema import FILLER, Counts, Many, Node, Record, Scalar, Text

STAMPS = ("header.stamp", "timestamp")  # where a message says when it was measured: ROS, Foxglove
FRAMES = ("header.frame_id", "frame_id")


class FieldError(KeyError):
    """A field path that the message type does not have; the message is the reason in a few words."""


class Part(NamedTuple):
    """A field as it lies in the message: a stamp is two of them, seconds and nanoseconds."""

    path: str
    node: Node
    inside: bool  # in an array of structures: one value per element
    depth: int = 0  # in how many of them, one inside the other


LENGTH = "length"  # of each of the arrays that lie in an array: "echoes.ranges.length"
OR = "|"  # between the names that releases of a package gave to one field: "k|K"


def resolve(message: Record, path: str) -> tuple[Part, ...]:
    """Find a field path in a message type, the first that it has of several. Raises FieldError naming the nearest.

    Arrays inside an array are one column end to end; the `.length` of arrays of numbers says where each ends.
    """
    *earlier, last = path.split(OR)
    for name in (path, *earlier) if earlier else ():  # a definition may call one field "a|b", however odd
        with suppress(FieldError):
            return _resolve(message, name)
    return _resolve(message, last)


def _resolve(message: Record, path: str) -> tuple[Part, ...]:
    node: Node = message
    inside, depth = False, 0
    walked: list[str] = []
    for name in path.split("."):
        if name == LENGTH and inside and isinstance(node, Many) and not isinstance(node.element, Record):
            return (Part(".".join(walked), Counts(), inside=True),)
        if isinstance(node, Many) and isinstance(node.element, Record):
            node, inside, depth = node.element, True, depth + 1
        if not isinstance(node, Record):
            raise FieldError(f"{'.'.join(walked)} has no parts")
        if name not in node.fields:
            raise FieldError(_no_field(node, walked, name))
        node = node.fields[name]
        walked.append(name)
    if isinstance(node, Many) and isinstance(node.element, Record) and node.element.is_time and not inside:
        node, inside = node.element, True
    if isinstance(node, Record) and node.is_time:
        return tuple(Part(f"{path}.{name}", part, inside) for name, part in node.fields.items())
    if isinstance(node, Record) or (isinstance(node, Many) and isinstance(node.element, Record | Many)):
        raise FieldError(f"{path} is a structure: name a part of it")
    if isinstance(node, Many) and inside and not isinstance(node.element, Scalar | Text):
        raise FieldError(f"{path} is an array inside an array: it cannot be a column")
    return (Part(path, node, inside, depth),)


def _no_field(node: Record, walked: list[str], name: str) -> str:
    near = difflib.get_close_matches(name, node.fields, 1)
    hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(node.fields)}"
    return f"{'.'.join(walked) or node.name} has no field {name!r}; {hint}"


def paths(message: Record) -> list[str]:
    """Return the path of every field of a message type that can be a column."""
    return list(_paths(message, "", inside=False))


def _paths(node: Node, path: str, *, inside: bool) -> Iterator[str]:
    if isinstance(node, Record) and not node.is_time:
        for name, part in node.fields.items():
            if name != FILLER:
                yield from _paths(part, f"{path}.{name}" if path else name, inside=inside)
    elif not isinstance(node, Many):
        yield path
    elif not inside:
        if isinstance(node.element, Record):
            yield from _paths(node.element, path, inside=True)
        elif not isinstance(node.element, Many):
            yield path


def stamp_path(message: Record) -> str | None:
    """Return the field that dates the message, None where only the recording does."""
    return next((path for path in STAMPS if len(_resolved(message, path)) == 2), None)


def frame_path(message: Record) -> str | None:
    """Return the field that names the frame of the message's values."""
    found = ((path, _resolved(message, path)) for path in FRAMES)
    return next((path for path, parts in found if parts and isinstance(parts[0].node, Text)), None)


def _resolved(message: Record, path: str) -> tuple[Part, ...]:
    try:
        return resolve(message, path)
    except FieldError:
        return ()
