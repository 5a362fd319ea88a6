"""Kinds of column: what a field of a message holds, and what its readers expect of it.

A message type is only a name; the definition in the log says what the messages hold. Where the two disagree (a
LaserScan whose `ranges` is one number), the field is refused in one line before anything is decoded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .fields import FieldError, Part
from .schema import Many, Scalar, Text

NUMBER, TRUTH, TEXT, TIME, BYTES = "a number", "true or false", "a text", "a time", "bytes"
NUMBERS, TRUTHS, TEXTS, TIMES = "an array of numbers", "an array of true or false", "an array of texts", "times"
NINE = "9 numbers"

# dotted path, or its end -> the kinds that its readers take; every other field is one number
EXPECTED: Mapping[str, tuple[str, ...]] = {
    "header.stamp": (TIME,),
    "timestamp": (TIME,),
    "ranges": (NUMBERS,),
    "name": (TEXTS,),
    "position": (NUMBERS,),
    "format": (TEXT,),
    "encoding": (TEXT,),
    "orientation_covariance": (NINE,),
    "angular_velocity_covariance": (NINE,),
    "position_covariance": (NINE, NUMBERS),  # JSON arrays do not say their length
}
OF_TYPE: Mapping[tuple[str, str], tuple[str, ...]] = {
    ("std_msgs/msg/String", "data"): (TEXT,),
    ("sensor_msgs/msg/CompressedImage", "data"): (BYTES,),
    ("sensor_msgs/msg/Image", "data"): (BYTES,),
    ("foxglove.CompressedImage", "data"): (BYTES,),
}
TF = "transforms."  # one value for each transform of a message
TF_TEXTS = ("frame_id",)


def kind_of(parts: Sequence[Part]) -> str:
    """Return what a resolved field holds in one message: the kind of its column."""
    first = parts[0]
    if len(parts) == 2:
        return TIMES if first.inside else TIME
    node, many = first.node, first.inside
    if isinstance(node, Many):
        if isinstance(node.element, Scalar) and node.element.dtype == "u1" and node.count is None:
            return BYTES
        if isinstance(node.element, Scalar) and node.element.dtype != "?" and node.count is not None:
            return f"{node.count} numbers"
        node, many = node.element, True
    if isinstance(node, Text):
        return TEXTS if many else TEXT
    if isinstance(node, Scalar) and node.dtype == "?":
        return TRUTHS if many else TRUTH
    return NUMBERS if many else NUMBER


def expected(msgtype: str, path: str) -> tuple[str, ...]:
    """Return the kinds that whoever reads this field of this message type can take."""
    if path.startswith(TF):
        return (TEXTS,) if path.endswith(TF_TEXTS) else (NUMBERS,)
    return OF_TYPE.get((msgtype, path)) or EXPECTED.get(path) or (NUMBER,)


def check_kind(msgtype: str, path: str, parts: Sequence[Part]) -> None:
    """Raise FieldError where a field is of a kind that its readers cannot take."""
    found, accepted = kind_of(parts), expected(msgtype, path)
    if found not in accepted:
        raise FieldError(f"{path} is {found} by its definition; accepted: {' or '.join(accepted)}")
