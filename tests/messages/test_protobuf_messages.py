"""Protobuf messages as columns: held to the values that Google's library reads."""

import struct
from typing import Any

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from hypothesis import given, strategies as st
from invented import decode as decode_by, plain

from benchmarks.field_paths import paths
from locfuse.formats.inputs import MAX_DEFINITION
from locfuse.formats.messages import protobuf_messages, schema as message_schema
from locfuse.formats.messages.protobuf_messages import ProtobufDecoder, parse_descriptors
from locfuse.formats.messages.schema import Decoded, SchemaError

KINDS = descriptor_pb2.FieldDescriptorProto
NUMBERS = (
    *("double", "float", "int64", "uint64", "int32", "fixed64", "fixed32", "bool", "uint32"),
    *("sfixed32", "sfixed64", "sint32", "sint64"),
)
HALVES = {"int32": 31, "sint32": 31, "sfixed32": 31, "int64": 52, "sint64": 52, "sfixed64": 52}  # signed
WHOLE = {"uint32": 32, "fixed32": 32, "uint64": 53, "fixed64": 53}


def files() -> Any:
    """A type with a field of every kind, single, repeated, and repeated without packing; parts; and itself."""
    found = descriptor_pb2.FileDescriptorSet()
    timestamp_pb2.DESCRIPTOR.CopyToProto(found.file.add())
    file = found.file.add(name="a.proto", package="made.up", syntax="proto3")
    file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    message = file.message_type.add(name="All")
    part = message.nested_type.add(name="Part")
    part.field.add(name="x", number=1, type=KINDS.TYPE_DOUBLE, label=1)
    part.field.add(name="text", number=7, type=KINDS.TYPE_STRING, label=1)
    part.field.add(name="row", number=3, type=KINDS.TYPE_FLOAT, label=3)
    part.field.add(name="length", number=9, type=KINDS.TYPE_DOUBLE, label=1)  # a number, of no array
    number = 0
    for name in NUMBERS:
        kind = getattr(KINDS, f"TYPE_{name.upper()}")
        for ending, label, packed in (("", 1, None), ("s", 3, True), ("s_apart", 3, False)):
            number += 1
            field = message.field.add(name=name + ending, number=number, type=kind, label=label)
            if packed is not None:
                field.options.packed = packed
    for name, kind, label, of in (
        ("text", KINDS.TYPE_STRING, 1, ""),
        ("texts", KINDS.TYPE_STRING, 3, ""),
        ("raw", KINDS.TYPE_BYTES, 1, ""),
        ("at", KINDS.TYPE_MESSAGE, 1, ".google.protobuf.Timestamp"),
        ("part", KINDS.TYPE_MESSAGE, 1, ".made.up.All.Part"),
        ("parts", KINDS.TYPE_MESSAGE, 3, ".made.up.All.Part"),
        ("itself", KINDS.TYPE_MESSAGE, 1, ".made.up.All"),
    ):
        number += 1
        message.field.add(name=name, number=number + 900, type=kind, label=label, type_name=of or None)
    return found


FILES = files()
POOL = descriptor_pool.DescriptorPool()
for one in FILES.file:
    POOL.Add(one)
All: Any = message_factory.GetMessageClass(POOL.FindMessageTypeByName("made.up.All"))
SCHEMA = FILES.SerializeToString()


def decoder() -> ProtobufDecoder:
    return ProtobufDecoder(*parse_descriptors("made.up.All", SCHEMA))


FIELDS = tuple(paths(decoder().message))


def decode(messages: list[bytes], fields: tuple[str, ...] = FIELDS) -> Decoded:
    return decode_by(decoder(), messages, fields)


def value_of(message: Any, path: str) -> Any:
    """Return what Google's library reads."""
    name, _, rest = path.partition(".")
    value = getattr(message, name)
    if name == "at":
        return value.seconds * 10**9 + value.nanos
    if name == "parts":
        inside = [value_of(one, rest) for one in value]
        flat = [v for row in inside for v in row] if rest == "row" else inside
        return tuple(flat) if rest == "text" else flat
    if rest:
        return value_of(value, rest)
    if isinstance(value, str | bytes | bool | int | float):
        return value
    return tuple(value) if name == "texts" else list(value)


def numbers(name: str) -> st.SearchStrategy[Any]:
    if name == "bool":
        return st.booleans()
    if name in {"double", "float"}:
        return st.floats(allow_nan=False, width=64 if name == "double" else 32)
    bits = HALVES.get(name)
    low, high = (-(1 << bits), (1 << bits) - 1) if bits else (0, (1 << WHOLE[name]) - 1)
    return st.integers(low, high)


PARTS = st.fixed_dictionaries(
    {},
    optional={"x": numbers("double"), "text": st.text(max_size=3), "row": st.lists(numbers("float"), max_size=3)},
)
MESSAGES = st.fixed_dictionaries(
    {},
    optional={
        **{name: numbers(name) for name in NUMBERS},
        **{f"{name}{end}": st.lists(numbers(name), max_size=4) for name in NUMBERS for end in ("s", "s_apart")},
        "text": st.text(max_size=5),
        "texts": st.lists(st.text(max_size=3), max_size=3),
        "raw": st.binary(max_size=5),
        "at": st.fixed_dictionaries({"seconds": st.integers(0, 2**31), "nanos": st.integers(0, 10**9 - 1)}),
        "part": PARTS,
        "parts": st.lists(PARTS, max_size=3),
        "itself": st.fixed_dictionaries({"text": st.text(max_size=2)}),
    },
)


@given(st.lists(MESSAGES, max_size=3))
def test_every_column_is_what_googles_library_reads(values: list[dict[str, Any]]) -> None:
    made = [All(**value) for value in values]
    found = decode([one.SerializeToString() for one in made])
    assert found.good.all()
    for path, column in found.columns.items():
        assert plain(column) == [value_of(one, path) for one in made], path


def test_arrays_inside_an_array_say_how_long_each_is() -> None:
    made = [All(parts=[{"row": [1, 2]}, {}, {"row": [3]}]), All()]
    found = decode([one.SerializeToString() for one in made], ("parts.row", "parts.row.length"))
    assert [plain(column) for column in found.columns.values()] == [[[1.0, 2.0, 3.0], []], [[2, 0, 1], []]]


def test_a_type_that_holds_itself_ends_there() -> None:
    assert not [path for path in FIELDS if path.startswith("itself")]
    # of `parts` x, text and length: an array in an array is asked for by name
    assert len(FIELDS) == 3 * len(NUMBERS) + 4 + 4 + 3


def test_unknown_fields_are_passed_over_and_of_a_value_twice_the_last_counts() -> None:
    known = All(text="a").SerializeToString()
    unknown = b"\xf8\xff\x01\x05" + b"\xfa\xff\x01\x02hi" + b"\x0d" + struct.pack("<f", 1.0)  # field 1 is a double
    found = decode([known + unknown], ("text", "double"))
    assert (found.columns["text"], plain(found.columns["double"])) == (["a"], [0.0])
    twice = All(double=1.0, text="a").SerializeToString() + All(double=2.0, text="b").SerializeToString()
    found = decode([twice], ("text", "double"))
    assert (found.columns["text"], plain(found.columns["double"])) == (["b"], [2.0])
    found = decode([All(double=1.0, float=2.0).SerializeToString()], ("none|double", "float|double"))
    assert [plain(column) for column in found.columns.values()] == [[1.0], [2.0]]


@given(MESSAGES, st.data())
def test_a_verdict_on_damaged_bytes_does_not_depend_on_fields(values: dict[str, Any], data: st.DataObject) -> None:
    whole = bytearray(All(**values).SerializeToString())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(whole)))
        whole[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=3))
    every, none = decode([bytes(whole)]), decode([bytes(whole)], ())
    assert every.good.tolist() == none.good.tolist()
    assert every.bad == none.bad
    for path, column in every.columns.items():
        assert len(column) == every.good.sum(), path


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"\x09\x00", "shorter than its type"),
        (b"\xb2\x1f\x05ab", "shorter than its type"),
        (b"\x80", "shorter than its type"),
        (b"\x80" * 10, "a number longer than 10 bytes"),
        (b"\x00\x01", "a field of number 0"),
        (b"\x0b", "a field of wire type 3, which is not supported"),
        (b"\x12\x07" + bytes(7), "an array that ends within a number"),  # doubles
        (b"\x42\x02\x01\x80", "an array that ends within a number"),  # int64s
        (b"\x42\x0c" + b"\x80" * 11 + b"\x01", "an array that ends within a number"),
    ],
)
def test_what_is_no_message_is_counted_with_its_reason(data: bytes, says: str) -> None:
    found = decode([data, b""])
    assert found.good.tolist() == [False, True]
    assert found.bad == {says: 1}


def reason(message: bytes, fields: tuple[str, ...] = FIELDS) -> str:
    """Why a message is refused, "" where it is read."""
    return next(iter(decode([message], fields).bad), "")


@pytest.mark.parametrize("fields", [FIELDS, ()])
def test_caps_are_reached_and_not_passed(monkeypatch: pytest.MonkeyPatch, fields: tuple[str, ...]) -> None:
    """Structures in structures, texts and numbers on their own, bytes of a text, and bytes of a message."""
    monkeypatch.setattr(protobuf_messages, "MAX_DEPTH", 4)
    monkeypatch.setattr(protobuf_messages, "MAX_ITEMS", 6)
    monkeypatch.setattr(protobuf_messages, "MAX_TEXT", 5)
    monkeypatch.setattr(protobuf_messages, "MAX_MESSAGE", 40)
    deep = All()
    at = deep
    for depth in (1, 2, 3, 4, 5):
        at = at.itself
        at.SetInParent()
        assert reason(deep.SerializeToString(), fields) == (
            "" if depth < 5 else "more than 4 structures in structures"
        )
    for n, good in ((6, True), (7, False)):
        for made in (
            All(texts=[""] * n),
            All(parts=[{}] * n),
            All(int32s_apart=[1] * n),
            All(texts=[""] * 3, int32s_apart=[1] * (n - 3)),
        ):
            assert (reason(made.SerializeToString(), fields) == "") is good, (n, made)
        assert reason(All(int32s=[1] * n).SerializeToString(), fields) == ""  # packed they are one
    assert reason(All(text="12345").SerializeToString(), fields) == ""
    assert reason(All(text="123456").SerializeToString(), fields).startswith("a text longer than")
    assert reason(All(raw=b"123456").SerializeToString(), fields) == ""
    for n in (36, 37):  # and four bytes of tag and length
        message = All(raw=bytes(n)).SerializeToString()
        assert (reason(message, fields) == "") is (len(message) <= 40)
        assert len(message) in {39, 40, 41}


@pytest.mark.parametrize("kind", ["int32", "int64", "uint32", "uint64", "sint32", "sint64", "fixed64", "sfixed64"])
def test_whole_numbers_are_right_at_both_ends_of_their_range(kind: str) -> None:
    """As exactly as a float is: a column of numbers."""
    bits, signed = (32 if "32" in kind else 64), not kind.startswith(("u", "f"))
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
    values = [low, high, high - 1, low + 1, 0, 1, high // 2, 127, 128, 16383, 16384]
    for name in (f"{kind}s", f"{kind}s_apart"):
        message = All(**{name: values}).SerializeToString()
        assert plain(decode([message], (name,)).columns[name]) == [[float(v) for v in values]]


def test_a_definition_nests_and_counts_fields_up_to_its_caps(monkeypatch: pytest.MonkeyPatch) -> None:
    def chain(depth: int) -> bytes:
        found = descriptor_pb2.FileDescriptorSet()
        file = found.file.add(name="c.proto", package="c", syntax="proto3")
        for i in range(depth + 1):
            message = file.message_type.add(name=f"T{i}")
            if i < depth:
                message.field.add(name="x", number=1, type=KINDS.TYPE_MESSAGE, label=1, type_name=f".c.T{i + 1}")
            message.field.add(name="y", number=2, type=KINDS.TYPE_DOUBLE, label=1)
        return bytes(found.SerializeToString())

    monkeypatch.setattr(protobuf_messages, "MAX_DEPTH", 4)
    assert "x.x.x.x.y" in paths(parse_descriptors("c.T0", chain(4))[1])
    with pytest.raises(SchemaError, match="nests more than 4 structures"):
        parse_descriptors("c.T0", chain(5))
    monkeypatch.setattr(
        message_schema, "MAX_FIELDS", 9
    )  # five structures of which four are fields, and five numbers
    with pytest.raises(SchemaError, match="unfolds to too many fields: 10, more than the cap of 9"):
        parse_descriptors("c.T0", chain(4))
    monkeypatch.setattr(message_schema, "MAX_FIELDS", 10)
    parse_descriptors("c.T0", chain(4))
    length = len(chain(2))
    for cap in (length, length - 1):
        monkeypatch.setattr(protobuf_messages, "MAX_DEFINITION", cap)
        if cap == length:
            parse_descriptors("c.T0", chain(2))
        else:
            with pytest.raises(SchemaError, match=f"too long: {length} bytes, more than the cap of {cap}"):
                parse_descriptors("c.T0", chain(2))


def test_types_defined_in_types_nest_up_to_the_cap(monkeypatch: pytest.MonkeyPatch) -> None:
    def inside(depth: int) -> bytes:
        found = descriptor_pb2.FileDescriptorSet()
        message = found.file.add(name="c.proto", syntax="proto3").message_type.add(name="T")
        for _ in range(depth):
            message = message.nested_type.add(name="T")
        message.field.add(name="y", number=1, type=KINDS.TYPE_DOUBLE, label=1)
        return bytes(found.SerializeToString())

    monkeypatch.setattr(protobuf_messages, "MAX_DEPTH", 3)
    assert paths(parse_descriptors("T.T.T.T", inside(3))[1]) == ["y"]  # without a package
    with pytest.raises(SchemaError, match="cannot be parsed"):
        parse_descriptors("T.T.T.T", inside(4))


@pytest.mark.parametrize(
    ("name", "schema", "says"),
    [
        ("made.up.Other", SCHEMA, "does not define made.up.Other"),
        ("made.up.All", b"\x0a\x05ab", "cannot be parsed"),
        ("made.up.All", b"", "does not define made.up.All"),
        ("made.up.All", bytes(MAX_DEFINITION + 1), "more than the cap"),
        ("made.up.All", FILES.file[1].SerializeToString(), "cannot be parsed"),  # a file, not a set of them
    ],
)
def test_a_definition_that_is_none_is_refused_in_one_line(name: str, schema: bytes, says: str) -> None:
    with pytest.raises(SchemaError, match=says) as error:
        parse_descriptors(name, schema)
    assert len(str(error.value).splitlines()) == 1


def test_a_definition_that_names_what_it_does_not_define_is_refused() -> None:
    alone = descriptor_pb2.FileDescriptorSet(file=[FILES.file[1]])
    with pytest.raises(SchemaError, match=r"names google\.protobuf\.Timestamp and does not define it"):
        parse_descriptors("made.up.All", alone.SerializeToString())
