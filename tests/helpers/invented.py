"""Message types that nobody wrote, their values by rosbags, and columns held to them."""

import random
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory, timestamp_pb2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from locfuse.formats.messages import cdr
from locfuse.formats.messages.cdr import Layout, read_layout
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


def walks(monkeypatch: pytest.MonkeyPatch) -> list[Layout]:
    """A list that gets the layout of every message that is parsed, not gathered by the layout of another one."""
    found: list[Layout] = []

    def read(*message: Any) -> Layout:
        found.append(read_layout(*message))
        return found[-1]

    monkeypatch.setattr(cdr, "read_layout", read)
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


# --- protobuf messages for tests, built by Google's library from JSON schemas: it knows nothing of our reader

KINDS = descriptor_pb2.FieldDescriptorProto
TIME = {"sec", "nsec"}


class Definition:
    """A message type made of the properties of a JSON schema."""

    def __init__(self, name: str, properties: dict[str, Any]) -> None:
        self.pool = descriptor_pool.DescriptorPool()
        self.files = descriptor_pb2.FileDescriptorSet()
        timestamp_pb2.DESCRIPTOR.CopyToProto(self.files.file.add())
        package, _, short = name.rpartition(".")
        file = self.files.file.add(name="made.proto", package=package, syntax="proto3")
        file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
        self._add(file.message_type.add(name=short), name, properties)
        for one in self.files.file:
            self.pool.Add(one)
        self.type: Any = message_factory.GetMessageClass(self.pool.FindMessageTypeByName(name))

    def _add(self, message: Any, full: str, properties: dict[str, Any]) -> None:
        for number, (name, said) in enumerate(properties.items(), 1):
            repeated = said.get("type") == "array"
            schema = said["items"] if repeated else said
            label = KINDS.LABEL_REPEATED if repeated else KINDS.LABEL_OPTIONAL
            field = message.field.add(name=name, number=number, label=label)
            inside = schema.get("properties")
            if schema.get("contentEncoding") == "base64":
                field.type = KINDS.TYPE_BYTES
            elif inside is None:
                field.type = {"string": KINDS.TYPE_STRING, "integer": KINDS.TYPE_FIXED32}.get(
                    schema["type"], KINDS.TYPE_DOUBLE
                )
            else:
                field.type = KINDS.TYPE_MESSAGE
                field.type_name = ".google.protobuf.Timestamp" if set(inside) == TIME else f".{full}.In{number}"
                if set(inside) != TIME:
                    self._add(message.nested_type.add(name=f"In{number}"), f"{full}.In{number}", inside)

    @property
    def schema(self) -> bytes:
        """The FileDescriptorSet that an MCAP file carries."""
        return bytes(self.files.SerializeToString())

    def message(self, values: dict[str, Any]) -> bytes:
        """Return values as a message; None is NaN, as where JSON has no word for it."""
        made = self.type()
        json_format.ParseDict(_json(values), made, descriptor_pool=self.pool)
        return bytes(made.SerializeToString())


def _json(value: Any) -> Any:
    """Return a value as Protobuf's own JSON: times are texts."""
    if isinstance(value, dict) and set(value) == TIME:
        return timestamp_pb2.Timestamp(seconds=value["sec"], nanos=value["nsec"]).ToJsonString()
    if isinstance(value, dict):
        return {key: _json(one) for key, one in value.items()}
    if isinstance(value, list):
        return ["NaN" if one is None else _json(one) for one in value]
    return value


def invented(seed: int, n: int) -> tuple[str, Any, list[Any]]:
    """The definition of a type t/msg/Top that nobody wrote, its rosbags store, and n messages."""
    rng = random.Random(seed)
    text, store = invented_type(rng), get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, "t/msg/Top"))
    fields = store.get_msgdef("t/msg/Top").fields
    made = [{name: invented_value(rng, desc, store) for name, desc in fields} for _ in range(n)]
    return text, store, [store.types["t/msg/Top"](**values) for values in made]


def written(store: Any, message: Any, kind: str) -> bytes:
    """The bytes of a t/msg/Top by rosbags: as CDR, little or big endian, or as ROS 1 has it."""
    if kind == "ros1":
        return bytes(store.serialize_ros1(message, "t/msg/Top"))
    return bytes(store.serialize_cdr(message, "t/msg/Top", little_endian=kind == "little"))
