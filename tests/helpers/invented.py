"""Message types that nobody wrote, their values by rosbags, and columns held to them."""

from __future__ import annotations

import random
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from locfuse.formats.messages.schema import Decoded
from locfuse.fusion.data import Ragged


def decode(decoder: Any, messages: Sequence[bytes], fields: Sequence[str]) -> Decoded:
    """Decode messages that lie one behind the other, at odd places."""
    data, start = b"\x00" * 7, []
    for message in messages:
        start.append(len(data))
        data += message + b"\xff"
    length = [len(message) for message in messages]
    buffer = np.frombuffer(data, np.uint8)
    found: Decoded = decoder.decode(buffer, np.array(start, np.int64), np.array(length, np.int64), fields)
    return found


def plain(column: Any) -> list[Any]:
    """A column as plain values, one or a list per row."""
    if isinstance(column, Ragged):
        return [column.values[a:b].tolist() for a, b in pairwise(column.first)]
    return list(column.tolist()) if isinstance(column, np.ndarray) else list(column)


def at_path(value: Any, path: str) -> Any:
    """The value of a dotted path in a message object; inside arrays of structures one value per element."""
    for name in path.split("."):
        value = [getattr(one, name) for one in value] if isinstance(value, list) else getattr(value, name)
    return nanoseconds(value)


def nanoseconds(value: Any) -> Any:
    if isinstance(value, list):
        return [nanoseconds(one) for one in value]
    if hasattr(value, "nanosec"):
        return value.sec * 10**9 + value.nanosec
    return value


def assert_same(got: Any, expected: Any) -> None:
    if isinstance(expected, str):
        assert got == expected
    elif isinstance(expected, list | tuple) and expected and isinstance(expected[0], str):
        assert list(got) == list(expected)
    else:
        one, other = (
            np.frombuffer(v, np.uint8) if isinstance(v, bytes) else np.asarray(v) for v in (got, expected)
        )
        if one.dtype == np.uint8:  # for `byte` and `char` rosbags says int8, mcap-ros2-support uint8
            other = other.astype(np.int64).astype(np.uint8)
        np.testing.assert_array_equal(one.ravel(), other.ravel())


PRIMITIVES = ["bool", "byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"]

PRIMITIVES += ["float32", "float64", "string"]

ARRAYS = ["", "", "", "[]", "[3]", "[<=4]"]


def invented_type(rng: random.Random) -> str:
    """A message definition nobody wrote: primitives, strings, arrays and two levels of parts."""

    def body(parts: list[str]) -> str:
        kinds = PRIMITIVES + 3 * parts + ["builtin_interfaces/Time"]
        lines = [f"{rng.choice(kinds)}{rng.choice(ARRAYS)} f{i}" for i in range(rng.randint(1, 6))]
        return "\n".join(lines) + "\n"

    rule = "=" * 80 + "\n"
    time = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    return rule.join(
        [body(["Inner", "Leaf"]), f"MSG: t/Inner\n{body(['Leaf'])}", f"MSG: t/Leaf\n{body([])}", time]
    )


def invented_value(rng: random.Random, desc: Any, store: Any) -> Any:
    kind, detail = desc[0].name, desc[1]
    if kind == "NAME":
        definition = store.get_msgdef(detail)
        return store.types[detail](**{n: invented_value(rng, d, store) for n, d in definition.fields})
    if kind == "BASE":
        return invented_scalar(rng, detail[0])
    element, size = detail
    n = size if kind == "ARRAY" else rng.choice([0, 1, 2, 3])
    values = [invented_value(rng, element, store) for _ in range(n)]
    if element[0].name == "NAME" or element[1][0] == "string":
        return values
    return np.array(values, {"byte": "uint8", "char": "uint8"}.get(element[1][0], element[1][0]))


def invented_scalar(rng: random.Random, name: str) -> Any:
    if name == "string":
        return rng.choice(["", "a", "laser", "Räder", "left_wheel_joint"])
    if name == "bool":
        return rng.random() < 0.5
    if name.startswith("float"):
        return rng.choice([0.0, -1.5, 2.0**90, float("inf"), float("nan"), 0.25])
    info = np.iinfo({"byte": "int8", "char": "int8"}.get(name, name))
    if name in {"byte", "char"}:  # ROS 2 says uint8, rosbags int8: stay where they agree
        return rng.randint(0, 127)
    return rng.randint(int(info.min), int(info.max))
