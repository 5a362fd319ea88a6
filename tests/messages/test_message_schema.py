"""Definitions as trees: sizes, caps and depths at their bounds, and what kind of value a field is."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import STORE, definition
from commands import locfuse, ok
from google.protobuf import descriptor_pb2, timestamp_pb2
from hostile import DIVIDER, FIX, Put, fix, lies, sample, write
from hypothesis import event, given, settings, strategies as st
from invented import decode
from present import present

from benchmarks.field_paths import paths
from locfuse.formats.container.source import ChannelInfo
from locfuse.formats.inputs import MAX_EXPRESSIONS
from locfuse.formats.logs.files import encoding_problem, make_decoder
from locfuse.formats.messages import schema, schema as kinds
from locfuse.formats.messages.json_messages import JsonDecoder, parse_jsonschema
from locfuse.formats.messages.schema import (
    FieldError,
    Many,
    Node,
    Scalar,
    SchemaError,
    Structure,
    Text,
    check_kind,
    count_fields,
    expected,
    frame_path,
    kind_of,
    parse,
    refuse_large,
    resolve,
    signature,
    stamp_path,
)
from locfuse.formats.robot.transforms import FIELDS as TF_FIELDS
from locfuse.fusion.data import Column, Ragged
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.truth import TRUTH_READS
from locfuse.fusion.wheels.read import WHEEL_READS

TIME = f"{DIVIDER}builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
ALL = f"""bool truth
float64 number
float64[] numbers
float32[9] nine
bool[3] truths
uint8[] raw
uint8[4] four
string text
string[] texts
string[2] pair
builtin_interfaces/Time at
builtin_interfaces/Time[] times
a/Part part
a/Part[] parts
a/Part[2] two
{DIVIDER}a/Part
float64 x
float32[] row
uint8[] bytes
float32[3] three
string name
string[] names
builtin_interfaces/Time at
a/Deep[] deep
{DIVIDER}a/Deep
float64 y
{TIME}"""


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("truth", "true or false"),
        ("number", "a number"),
        ("numbers", "an array of numbers"),
        ("nine", "9 numbers"),
        ("truths", "an array of true or false"),
        ("raw", "bytes"),
        ("four", "4 numbers"),
        ("text", "a text"),
        ("texts", "an array of texts"),
        ("pair", "an array of texts"),
        ("at", "a time"),
        ("times", "times"),
        ("part.x", "a number"),
        ("part.row", "an array of numbers"),
        ("parts.x", "an array of numbers"),
        ("parts.row", "an array of numbers"),
        ("parts.row.length", "an array of numbers"),
        ("parts.names.length", "an array of numbers"),
        ("parts.bytes", "an array of numbers"),
        ("parts.three", "an array of numbers"),
        ("parts.name", "an array of texts"),
        ("parts.names", "an array of texts"),
        ("parts.at", "times"),
        ("parts.deep.y", "an array of numbers"),
        ("two.x", "an array of numbers"),
    ],
)
def test_a_field_is_of_the_kind_that_its_definition_says(path: str, kind: str) -> None:
    message = parse("a/msg/All", "ros2msg", ALL)
    assert kind_of(resolve(message, path)) == kind


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("parts.deep", "is a structure: name a part of it"),
        ("part", "is a structure: name a part of it"),
        ("number.length", "number has no parts"),
        ("numbers.length", "numbers has no parts"),
        ("parts.length", "has no field 'length'"),
        ("part.row.length", "part.row has no parts"),
        ("txet", "did you mean 'text'"),
        ("zzz", "it has truth, number,"),
        ("part.zzz", "part has no field 'zzz'"),
        ("zzz|yyy", "no field 'yyy'"),
    ],
)
def test_a_path_that_is_no_column_says_why(path: str, says: str) -> None:
    with pytest.raises(FieldError, match=says.replace(".", r"\.")):
        resolve(parse("a/msg/All", "ros2msg", ALL), path)


def test_of_several_names_the_first_that_there_is_counts() -> None:
    message = parse("a/msg/All", "ros2msg", ALL)
    for path, name in (("zzz|text", "text"), ("text|number", "text"), ("zzz|yyy|number", "number")):
        assert [part.path for part in resolve(message, path)] == [name]
    odd = Structure("a", {"a|b": Text(), "b": Text(), "a": Text()})
    assert resolve(odd, "a|b")[0].path == "a|b"


@pytest.mark.parametrize(
    ("text", "stamp", "frame"),
    [
        (
            f"a/Header header\n{DIVIDER}a/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n{TIME}",
            "header.stamp",
            "header.frame_id",
        ),
        (f"builtin_interfaces/Time timestamp\nstring frame_id\n{TIME}", "timestamp", "frame_id"),
        ("float64 timestamp\nfloat64 frame_id\n", None, None),
        ("float64 x\n", None, None),
    ],
)
def test_where_a_message_says_when_and_in_which_frame(text: str, stamp: str | None, frame: str | None) -> None:
    message = parse("a/msg/B", "ros2msg", text)
    assert (stamp_path(message), frame_path(message)) == (stamp, frame)


@pytest.mark.parametrize(
    ("language", "text", "what"),
    [
        ("ros2msg", "x" * 20, "20 characters"),
        ("ros2msg", "a\nb\n  c", "3 lines"),
        ("ros2idl", "[ == [", "3 arrays and constants"),
    ],
)
def test_a_definition_as_long_as_a_cap_is_parsed_and_a_longer_one_refused(
    language: str, text: str, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    count, unit = what.split(" ", 1)
    name = {"characters": "MAX_DEFINITION", "lines": "MAX_DEFINITION_LINES"}.get(unit, "MAX_EXPRESSIONS")
    monkeypatch.setattr(schema, name, int(count))
    refuse_large("A", language, text)
    monkeypatch.setattr(schema, name, int(count) - 1)
    with pytest.raises(SchemaError, match=f"too long: {what}, more than the cap of {int(count) - 1}"):
        refuse_large("A", language, text)
    monkeypatch.setattr(schema, "MAX_DEFINITION", 99)
    monkeypatch.setattr(schema, "MAX_DEFINITION_LINES", 1)  # without comments and empty lines
    monkeypatch.setattr(schema, "MAX_EXPRESSIONS", 0)  # of IDL alone
    refuse_large("A", "ros2msg", "# a comment\n\n   \n  # another [\nfloat64[] x")


def chain(depth: int) -> str:
    """A type in a type in a type."""
    inner = "".join(f"{DIVIDER}a/T{i}\na/T{i + 1} x\n" for i in range(1, depth))
    return f"a/T1 x\n{inner}{DIVIDER}a/T{depth}\nfloat64 x\n"


@pytest.mark.parametrize("array", ["", "[]"])
def test_structures_nest_as_deep_as_the_cap_and_no_deeper(array: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schema, "MAX_DEPTH", 5)
    assert paths(parse("a/msg/T0", "ros2msg", chain(5))) == ["x.x.x.x.x.x"]
    with pytest.raises(SchemaError, match="nests more than 5 structures"):
        parse("a/msg/T0", "ros2msg", chain(6).replace(" x\n", f"{array} x\n"))
    twice = f"a/T3{array} before\na/T1{array} x\n" + chain(6).split("\n", 1)[1]  # T3 is known when T2 mentions it
    with pytest.raises(SchemaError, match="nests more than 5 structures"):
        parse("a/msg/T0", "ros2msg", twice)
    assert (
        "before"
        in parse("a/msg/T0", "ros2msg", twice.replace("a/T6", "a/T5").replace("a/T5 x", "float64 x")).fields
    )


def counted(node: Node) -> int:
    if isinstance(node, Many):
        return counted(node.element)
    return 1 + sum(counted(part) for part in node.fields.values()) if isinstance(node, Structure) else 1


def test_fields_are_counted_at_every_mention_up_to_the_cap(monkeypatch: pytest.MonkeyPatch) -> None:
    message = parse("a/msg/All", "ros2msg", ALL)
    assert count_fields(message, {}) == counted(message) == 53
    monkeypatch.setattr(schema, "MAX_FIELDS", 53)
    parse("a/msg/All", "ros2msg", ALL)
    monkeypatch.setattr(schema, "MAX_FIELDS", 52)
    with pytest.raises(SchemaError, match="unfolds to too many fields: 53, more than the cap of 52"):
        parse("a/msg/All", "ros2msg", ALL)


@pytest.mark.parametrize(
    ("one", "other", "alike"),
    [
        ("float64 x\n", "float64 x\n", True),
        ("float64 x\n", "float64 y\n", False),
        ("float64 x\n", "float32 x\n", False),
        ("float64[] x\n", "float64[2] x\n", False),
        ("float64[] x\n", "float32[] x\n", False),
        ("string x\n", "float64 x\n", False),
        (f"a/P x\n{DIVIDER}a/P\nstring y\n", f"a/Q x\n{DIVIDER}a/Q\nstring y\n", True),
        ("float64 x\nfloat64 y\n", "float64 y\nfloat64 x\n", False),
    ],
)
def test_definitions_whose_columns_are_alike_have_one_signature(one: str, other: str, alike: bool) -> None:
    found = [signature(parse("a/msg/B", "ros2msg", text)) for text in (one, other)]
    assert (found[0] == found[1]) is alike


@pytest.mark.parametrize(
    ("fields", "is_time"),
    [
        ("int32 sec\nuint32 nanosec\n", True),
        ("int64 s\nint64 ns\n", True),
        ("float64 sec\nuint32 nanosec\n", False),
        ("int32 sec\nfloat32 nanosec\n", False),
        ("int32 sec\n", False),
        ("int32 sec\nuint32 nanosec\nuint8 more\n", False),
    ],
)
def test_a_time_is_two_whole_numbers(fields: str, is_time: bool) -> None:
    text = f"builtin_interfaces/Time t\n{DIVIDER}builtin_interfaces/Time\n{fields}"
    node = parse("a/msg/B", "ros2msg", text).fields["t"]
    assert isinstance(node, Structure)
    assert node.is_time is is_time
    other = parse("a/msg/B", "ros2msg", text.replace("builtin_interfaces/Time", "a/Time")).fields["t"]
    assert isinstance(other, Structure)
    assert not other.is_time


PX4 = {
    "VehicleOdometry": "float32[3] position\nfloat32[4] q\nuint8 velocity_frame\nfloat32[3] velocity\n"
    "float32[3] angular_velocity\n",
    "VehicleLocalPosition": "float32 x\nfloat32 y\nfloat32 heading\nfloat32 vx\nfloat32 vy\n",
    "SensorCombined": "float32[3] gyro_rad\nfloat32[3] accelerometer_m_s2\n",
}


@pytest.mark.parametrize("name", PX4)
def test_the_messages_of_px4_are_as_they_are_defined_and_no_number_longer(name: str) -> None:
    kind = f"px4_msgs/msg/{name}"
    message = parse(kind, "ros2msg", PX4[name])
    for path in paths(message):
        assert expected(kind, path)
        check_kind(kind, path, resolve(message, path))
    longer = parse(kind, "ros2msg", PX4[name].replace("[3]", "[2]").replace("[4]", "[5]").replace("32 ", "32[1] "))
    for path in paths(longer):
        if "frame" not in path:
            with pytest.raises(FieldError, match="by its definition; accepted:"):
                check_kind(kind, path, resolve(longer, path))


# --- which decoder a channel gets, and why one gets none


DESCRIBED = descriptor_pb2.FileDescriptorProto()
timestamp_pb2.DESCRIPTOR.CopyToProto(DESCRIBED)


def channel(encoding: str, language: str, schema: bytes = b"uint8 a\n", msgtype: str = "t/A") -> ChannelInfo:
    return ChannelInfo("/a", msgtype, encoding, language, schema, 0)


@pytest.mark.parametrize(
    ("info", "words"),
    [
        (channel("flatbuffer", "ros2msg"), "encoded as 'flatbuffer'; cdr, ros1, json, protobuf are read"),
        (channel("cdr", "ros1msg"), "described in 'ros1msg'; for cdr ros2msg and ros2idl are read"),
        (channel("cdr", ""), "its type is not described; for cdr ros2msg and ros2idl are read"),
        (channel("json", "protobuf"), "described in 'protobuf'; for json jsonschema are read"),
    ],
)
def test_what_cannot_be_decoded_says_why(info: ChannelInfo, words: str) -> None:
    problem = present(encoding_problem(info))
    assert words in problem
    with pytest.raises(SchemaError, match="are read"):
        make_decoder(info)


# --- the kind that a field must be of

# every field that anything reads, by message type
READS = {
    **TRUTH_READS,
    **WHEEL_READS,
    **{kind: fields for sensor in REGISTRY.values() for kind, fields in sensor.reads.items()},
    "tf2_msgs/msg/TFMessage": TF_FIELDS,
    "std_msgs/msg/String": ("data",),
}
ALL_READ = [(kind, path) for kind, paths in READS.items() for path in paths]
STANDARD = [(kind, path) for kind, path in ALL_READ if kind in STORE.types]


@pytest.mark.parametrize(("msgtype", "path"), STANDARD)
def test_every_field_read_is_of_the_expected_kind_in_its_standard_definition(msgtype: str, path: str) -> None:
    message = parse(msgtype, "ros2msg", definition(msgtype).decode())
    check_kind(msgtype, path, resolve(message, path))


def test_of_every_field_that_is_read_the_expected_kind_is_known() -> None:
    """A new sensor that reads a field says in kinds.toml what it takes."""
    assert [(kind, path) for kind, path in ALL_READ if not expected(kind, path)] == []


LIES = (
    "string",
    "float64[]",
    "string[]",
    "std_msgs/Header",
    "float64[3]",
    "float64",
    "bool",
    "uint8[]",
    "bool[4]",
)
FIELDS = {
    "/ground_truth/pose": (b"float64 x\n", b"float64 w\n"),
    "/scan": (b"float32[] ranges", b"float32 angle_min", b"float32 range_max"),
    "/joint_states": (b"string[] name", b"float64[] position"),
    "/tf_static": (b"string child_frame_id", b"float64 x\n", b"string frame_id"),
    "/camera/image_raw/compressed": (b"uint8[] data", b"string format"),
    "/compass": (b"float64 x\n",),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_definition_that_lies_costs_one_line_at_most(tmp_path: Path, lie: str) -> None:
    """77 of 373 such logs ended in a traceback."""
    topics = {put.topic for put in sample()[0]}
    for topic, fields in FIELDS.items():
        for field in fields:
            if topic not in topics:
                continue
            text, name = field.split()[0], field.split()[1]
            log = write(tmp_path / "f.mcap", lies(topic, field, field.replace(text, lie.encode(), 1)), seconds=1.0)
            how = ("--no-advice", "--no-smooth", "--write", "json", "-q")
            done = locfuse("run", log, *how, "-o", tmp_path / "o")
            assert done.exit_code in {0, 1, 3}, (topic, name, done)
            assert len(done.stderr.splitlines()) <= 1, done.stderr
            if done.exit_code == 1 and "by its definition" in done.stderr:
                assert topic in done.stderr
                assert "accepted: " in done.stderr


def test_the_line_names_topic_field_kind_found_and_kind_accepted(tmp_path: Path) -> None:
    log = write(tmp_path / "f.mcap", lies("/scan", b"float32[] ranges", b"float64 ranges"), seconds=1.0)
    done = locfuse("run", log, "-o", tmp_path / "o")
    line = "/scan (sensor_msgs/msg/LaserScan): ranges is a number by its definition; accepted: an array of numbers"
    assert f"not used: lrf: {line}\n" in done.stderr
    assert done.exit_code in {0, 1}


BASE = st.sampled_from(
    ["bool", "uint8", "int8", "int32", "uint64", "float32", "float64", "string", "a/Inner", "T"]
)
ARRAY = st.sampled_from(["", "[]", "[1]", "[3]", "[9]", "[<=4]"])


@st.composite
def definitions(draw: st.DrawFn, path: str) -> str:
    """A ros2msg text in which a path leads somewhere, through structures and arrays of them."""
    names = path.split(".")
    texts = []
    for i, name in enumerate(names):
        last = i == len(names) - 1
        kind = draw(BASE).replace("T", "builtin_interfaces/Time") if last else f"a/L{i + 1}"
        array = draw(ARRAY) if last or draw(st.booleans()) else ""
        before = draw(st.sampled_from(["", "string filler_a\n", "uint8[] filler_b\n"]))
        texts.append((f"L{i}", f"{before}{kind}{array} {name}\n"))
    texts.append(("Inner", "float64 x\n"))
    return texts[0][1] + "".join(f"{DIVIDER}a/{n}\n{t}" for n, t in texts[1:])


def is_of(kind: str, column: Column, n: int) -> bool:
    """Whether a column is what the readers of a kind take, whatever it holds."""
    if len(column) != n:
        return False
    if kind in {kinds.NUMBER, kinds.TIME}:
        return isinstance(column, np.ndarray) and column.shape == (n,) and column.dtype.kind in "iuf"
    if kind == kinds.NUMBERS:
        return isinstance(column, Ragged) and column.values.dtype.kind in "iuf"
    if kind == kinds.NINE:
        return isinstance(column, np.ndarray) and column.shape == (n, 9) and column.dtype.kind in "iuf"
    if not isinstance(column, list):
        return False
    if kind == kinds.TEXTS:
        return all(isinstance(v, tuple) and all(isinstance(s, str) for s in v) for v in column)
    return all(isinstance(v, {kinds.TEXT: str, kinds.BYTES: bytes}[kind]) for v in column)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_any_definition_gives_columns_of_the_expected_kind_or_one_line(data: st.DataObject) -> None:
    msgtype, path = data.draw(st.sampled_from(ALL_READ))
    text = data.draw(definitions(path))
    try:
        decoder = make_decoder(ChannelInfo("/a", msgtype, "cdr", "ros2msg", text.encode(), 1))
        parts = resolve(decoder.message, path)
        check_kind(msgtype, path, parts)
    except (SchemaError, FieldError) as refusal:
        event(f"refused: {str(refusal).split()[0]}")
        return
    assert kind_of(parts) in expected(msgtype, path)
    messages = data.draw(st.lists(st.binary(max_size=90).map(lambda b: b"\0\1\0\0" + b), max_size=4))
    found = decode(decoder, messages, (path,))
    assert is_of(kind_of(parts), found.columns[path], int(found.good.sum()))


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just(10**400),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["sec", "nsec", "x"]), inner),
    max_leaves=8,
)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.dictionaries(st.sampled_from(list(FIX["properties"])), VALUES), max_size=4))
def test_any_json_gives_columns_of_the_kind_that_its_schema_promises(values: list[dict[str, Any]]) -> None:
    message = parse_jsonschema("foxglove.LocationFix", json.dumps(FIX))
    paths = tuple(FIX["properties"])
    found = decode(JsonDecoder(message), [json.dumps(value).encode() for value in values], paths)
    for path in paths:
        assert is_of(kind_of(resolve(message, path)), found.columns[path], len(values)), path


JSON_LIES: list[dict[str, Any]] = [
    {"position_covariance": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]},
    {"position_covariance": [10**400] * 9},
    {"position_covariance": "none"},
    {"latitude": [1.0]},
    {"frame_id": "\ud800"},
    {"timestamp": [1, 2]},
]


def test_json_values_that_are_not_what_the_schema_says_are_no_traceback(tmp_path: Path) -> None:
    extra = [fix(i, **lie) for i, lie in enumerate(JSON_LIES * 2)]
    log = write(tmp_path / "f.mcap", extra=extra, seconds=1.0)
    for command in ("run", "info"):
        done = locfuse(command, log, *(("-o", tmp_path / "o", "-q") if command == "run" else ()))
        assert done.exit_code in {0, 1, 3}, done
        assert len(done.stderr.splitlines()) <= 1


def test_covariances_of_changing_length_are_none(tmp_path: Path) -> None:
    extra = [fix(i, position_covariance=[1.0] * i) for i in range(12)]
    ok("run", write(tmp_path / "f.mcap", extra=extra), "-o", tmp_path / "o")


@pytest.mark.parametrize("kind", ["string", "object", "boolean", "array"])
def test_json_schemas_of_another_kind_are_one_line(tmp_path: Path, kind: str) -> None:
    for field in ("latitude", "position_covariance", "position_covariance_type", "frame_id", "timestamp"):
        schema = {**FIX, "properties": {**FIX["properties"], field: {"type": kind}}}  # type: ignore[dict-item]
        log = write(tmp_path / "f.mcap", extra=[fix(i, schema) for i in range(9)], seconds=1.0)
        done = locfuse("run", log, "-o", tmp_path / "o", "-q")
        assert done.exit_code in {0, 1, 3}, (field, done)
        assert len(done.stderr.splitlines()) <= 1


def doubling(n: int) -> bytes:
    """Every type holds the next one twice."""
    middle = "".join(f"{DIVIDER}pkg/T{i}\npkg/T{i + 1} a\npkg/T{i + 1} b\n" for i in range(n))
    return f"pkg/T0 a\n{middle}{DIVIDER}pkg/T{n}\nfloat64 x\n".encode()


def test_a_definition_beyond_a_cap_is_refused_on_a_topic_that_nobody_uses_too(tmp_path: Path) -> None:
    words = "unfolds to too many fields: 201 326 592, more than the cap of 10 000"
    odd = Put(
        "pkg/msg/Odd", "ros2msg", doubling(26), "/odd", "cdr", sample()[0][0].log_time, b"\0\1\0\0" + bytes(8)
    )
    done = ok("info", write(tmp_path / "f.mcap", extra=[odd], seconds=0.5))
    assert words in done.stdout.replace("\n  ", " ")


@pytest.mark.parametrize("member", ["long a[9]; ", "@range(min=9) long a; "])
def test_idl_of_many_arrays_or_annotations_on_one_line_is_refused_before_it_is_parsed(member: str) -> None:
    """Each takes the parser 2 ms: 256 kB of them take it 45 s."""
    idl = "module pkg {{ module msg {{ struct Odd {{ {} }}; }}; }};"
    with pytest.raises(SchemaError, match="1 025 arrays and constants, more than the cap of 1 024"):
        parse("pkg/msg/Odd", "ros2idl", idl.format(member * (MAX_EXPRESSIONS + 1)))
    assert "a" in parse("pkg/msg/Odd", "ros2idl", idl.format(member * 3)).fields


def test_a_key_that_holds_a_dot_is_no_field_as_no_path_leads_to_it() -> None:
    number = {"type": "number"}
    message = parse_jsonschema("A", json.dumps({"type": "object", "properties": {"a": number, "b.c": number}}))
    assert paths(message) == ["a"]
    for path in paths(message):
        resolve(message, path)


def test_times_that_a_definition_only_mentions_are_those_of_ros() -> None:
    node = parse("a/msg/B", "ros2msg", "builtin_interfaces/Time t\nbuiltin_interfaces/Duration d\n").fields["t"]
    assert isinstance(node, Structure)
    assert [(n, p.dtype, p.size) for n, p in node.fields.items() if isinstance(p, Scalar)] == [
        ("sec", "i4", 4),
        ("nanosec", "u4", 4),
    ]
