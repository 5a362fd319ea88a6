"""Whatever a definition says of a field: a column of the kind that its readers take, or one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import STORE, definition
from commands import locfuse, ok
from hostile import DIVIDER, FIX, Put, fix, lies, sample, write
from hypothesis import event, given, settings
from hypothesis import strategies as st
from invented import decode

from benchmarks.field_paths import paths
from locfuse.formats.caps import MAX_EXPRESSIONS
from locfuse.formats.container.source import ChannelInfo
from locfuse.formats.logs.channels import make_decoder
from locfuse.formats.messages import fields as kinds
from locfuse.formats.messages.fields import FieldError, check_kind, expected, kind_of, resolve
from locfuse.formats.messages.json_messages import JsonDecoder, parse_jsonschema
from locfuse.formats.messages.schema import SchemaError, parse
from locfuse.formats.robot.transforms import FIELDS as TF_FIELDS
from locfuse.fusion.data import Column, Ragged
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.truth import TRUTH_READS
from locfuse.fusion.wheels.read import WHEEL_READS

# every field that anything reads, by message type
READS = {
    **TRUTH_READS,
    **WHEEL_READS,
    **{kind: fields for sensor in REGISTRY.values() for kind, fields in sensor.reads.items()},
    "tf2_msgs/msg/TFMessage": TF_FIELDS,
    "std_msgs/msg/String": ("data",),
}
ALL = [(kind, path) for kind, paths in READS.items() for path in paths]
STANDARD = [(kind, path) for kind, path in ALL if kind in STORE.types]


@pytest.mark.parametrize(("msgtype", "path"), STANDARD)
def test_every_field_that_is_read_is_of_the_expected_kind_in_its_standard_definition(
    msgtype: str, path: str
) -> None:
    message = parse(msgtype, "ros2msg", definition(msgtype).decode())
    check_kind(msgtype, path, resolve(message, path))


def test_of_every_field_that_is_read_the_expected_kind_is_known() -> None:
    """A new sensor that reads a field says in kinds.py what it takes."""
    assert [(kind, path) for kind, path in ALL if not expected(kind, path)] == []


@pytest.mark.parametrize("msgtype", ["sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "foxglove.Log"])
def test_a_field_that_nothing_of_ours_reads_may_be_of_any_kind(msgtype: str) -> None:
    """Python reads `log.stream("/scan").columns("header.frame_id")`."""
    for path in ("header.frame_id", "message"):
        assert not expected(msgtype, path)


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
            done = locfuse("run", log, "-o", tmp_path / "o", "-q")
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
    msgtype, path = data.draw(st.sampled_from(ALL))
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


def test_a_type_that_is_mentioned_often_is_one_tree() -> None:
    message = parse("pkg/msg/Odd", "ros2msg", doubling(8).decode())
    inner: Any = message.fields["a"]
    assert inner.fields["a"] is inner.fields["b"]


def test_a_key_that_holds_a_dot_is_no_field_as_no_path_leads_to_it() -> None:
    number = {"type": "number"}
    message = parse_jsonschema("A", json.dumps({"type": "object", "properties": {"a": number, "b.c": number}}))
    assert paths(message) == ["a"]
    for path in paths(message):
        resolve(message, path)
