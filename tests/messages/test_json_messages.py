"""JSON messages as columns: held to the values that the json module reads."""

import base64
import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from invented import decode, plain

from benchmarks.field_paths import paths
from locfuse.formats.messages import json_messages
from locfuse.formats.messages.json_messages import JsonDecoder, parse_jsonschema
from locfuse.formats.messages.schema import Many, Scalar, SchemaError, Structure, Text

NUMBER = {"type": "number"}
TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}


def record(**properties: Any) -> Structure:
    return parse_jsonschema("A", json.dumps({"type": "object", "properties": properties}))


def decoded(tree: Structure, *messages: Any) -> dict[str, Any]:
    data = [message if isinstance(message, bytes) else json.dumps(message).encode() for message in messages]
    found = decode(JsonDecoder(tree), data, paths(tree))
    assert found.good.sum() == len(data) - sum(found.bad.values())
    return {name: plain(column) for name, column in found.columns.items()}


@pytest.mark.parametrize(
    ("schema", "node"),
    [
        (NUMBER, Scalar),
        ({"type": "integer"}, Scalar),
        ({"type": ["null", "number"]}, Scalar),
        ({"type": "boolean"}, Scalar),
        ({"type": "string"}, Text),
        ({"type": "string", "contentEncoding": "base64"}, Many),
        ({"type": "array", "items": {"type": "string"}}, Many),
        (TIME, Structure),
        ({"type": "array"}, None),
        ({"type": "array", "items": {"type": "null"}}, None),
        ({"type": ["null"]}, None),
        ({"type": "object"}, None),
        ({"type": "object", "properties": []}, None),
        ({}, None),
        ("number", None),
        (None, None),
    ],
)
def test_a_schema_tells_what_kind_of_column_a_value_is(schema: Any, node: type | None) -> None:
    found = record(a=schema, b=NUMBER).fields
    assert "b" in found
    assert ("a" in found) == (node is not None)
    if node is not None:
        assert isinstance(found["a"], node)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, '{"type": "object"}', "[]", "3", '"\ud800"'])
def test_a_schema_that_is_none_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(SchemaError, match="jsonschema definition of A") as error:
        parse_jsonschema("A", text)
    assert len(str(error.value).splitlines()) == 1


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(st.characters(codec="utf-8"), max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from("xy"), inner, max_size=2),
    max_leaves=8,
)
TREE = record(
    n=NUMBER,
    t={"type": "string"},
    ns={"type": "array", "items": NUMBER},
    ts={"type": "array", "items": {"type": "string"}},
    parts={
        "type": "array",
        "items": {"type": "object", "properties": {"x": NUMBER, "y": {"type": "string"}, "at": TIME}},
    },
)


def number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def many(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def get(value: Any, key: str) -> Any:
    return value.get(key) if isinstance(value, dict) else None


MESSAGES = st.fixed_dictionaries(
    {},
    optional={
        **dict.fromkeys(("n", "t", "ns", "ts"), VALUES),
        "parts": st.none() | st.integers() | st.lists(VALUES.filter(lambda value: not isinstance(value, list))),
    },
)


@given(st.lists(MESSAGES, max_size=3))
def test_every_column_holds_what_the_json_module_reads(messages: list[dict[str, Any]]) -> None:
    found = decoded(TREE, *messages)
    read = [json.loads(json.dumps(one)) for one in messages]
    expected = {
        "n": [number(one.get("n")) for one in read],
        "t": [text(one.get("t")) for one in read],
        "ns": [[number(v) for v in many(one.get("ns"))] for one in read],
        "ts": [tuple(text(v) for v in many(one.get("ts"))) for one in read],
    }
    for name, column in expected.items():
        np.testing.assert_equal(found[name], column)
    parts = [many(one.get("parts")) for one in read]
    np.testing.assert_equal(found["parts.x"], [[number(get(part, "x")) for part in some] for some in parts])
    assert found["parts.y"] == [tuple(text(get(part, "y")) for part in some) for some in parts]
    assert [len(times) for times in found["parts.at"]] == [len(some) for some in parts]


def test_half_a_letter_is_shown_flags_and_words_that_json_lacks_are_read() -> None:
    assert decoded(record(a={"type": "string"}), b'{"a": "\\ud800"}')["a"] == [r"\ud800"]
    assert decoded(record(a={"type": "boolean"}), {"a": True}, {"a": False}, {})["a"] == [True, False, False]
    found = decoded(record(a=NUMBER, b={"type": "array", "items": NUMBER}), b'{"a": NaN, "b": [Infinity, -1]}')
    assert math.isnan(found["a"][0])
    assert found["b"] == [[math.inf, -1.0]]


@pytest.mark.parametrize("value", [None, 7, "\N{ROBOT FACE}", "a", [1], base64.b64encode(b"abc").decode()])
def test_bytes_are_those_of_base64_or_none(value: Any) -> None:
    picture = {"type": "string", "contentEncoding": "base64"}
    assert decoded(record(a=picture), {"a": value})["a"] == [b"abc" if value == "YWJj" else b""]


@pytest.mark.parametrize("bad", [b"", b"[]", b"{", b"\xff", b"[" * 50_000, b'{"a": 1}' + b" " * 100])
def test_what_is_no_object_or_too_long_is_no_row(bad: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_messages, "MAX_MESSAGE", 100)
    assert decoded(record(a=NUMBER), bad, {"a": 2})["a"] == [2.0]


@pytest.mark.parametrize(
    ("value", "ns"),
    [
        ({"sec": 5, "nsec": 7}, 5_000_000_007),
        ({"sec": 5, "nanosec": 7}, 5_000_000_007),
        ({"sec": 5, "nsecs": 7}, 5_000_000_007),
        ({"sec": 5}, 5_000_000_000),
        ({"sec": -2, "nsec": 7}, -1_999_999_993),
        ({"sec": 2**32 - 1, "nsec": 0}, (2**32 - 1) * 10**9),
        ({"sec": 2**32, "nsec": 0}, 0),
        ({"sec": 1, "nsec": 2**32}, 0),
        ({"nsec": 7}, 7),
        ({"sec": "soon", "nsec": 7}, 0),
        ({"sec": None, "nsec": 7}, 0),
        ({"sec": 1, "nsec": float("inf")}, 0),
        ({"sec": 10**400}, 0),
        ({"sec": -(2**40)}, 0),
        ("now", 0),
        ([], 0),
        (7, 0),
        (None, 0),
    ],
)
def test_a_time_is_seconds_and_nanoseconds_or_none(value: Any, ns: int) -> None:
    for name in ("nsec", "nanosec", "nsecs"):
        time = {"type": "object", "properties": {"sec": {"type": "integer"}, name: {"type": "integer"}}}
        assert decoded(record(a=time), {"a": value})["a"] == [ns]


@pytest.mark.parametrize(
    ("properties", "time"),
    [
        (("sec", "nsec"), True),
        (("sec", "other"), False),
        (("other", "nsec"), False),
        (("sec", "nsec", "more"), False),
    ],
)
def test_a_time_has_two_properties_of_these_names(properties: tuple[str, ...], time: bool) -> None:
    node = record(a={"type": "object", "properties": dict.fromkeys(properties, NUMBER)}).fields["a"]
    assert isinstance(node, Structure)
    assert node.is_time is time


def test_what_nests_as_deep_as_the_cap_is_a_column(monkeypatch: pytest.MonkeyPatch) -> None:
    """The number in two arrays of a message is three deep."""
    monkeypatch.setattr(json_messages, "MAX_DEPTH", 3)
    schema: Any = NUMBER
    for arrays in range(4):
        assert ("a" in record(a=schema).fields) is (arrays <= 2), arrays
        schema = {"type": "array", "items": schema}


def test_structures_in_arrays_in_arrays_are_end_to_end() -> None:
    inner = {"type": "array", "items": {"type": "object", "properties": {"x": NUMBER, "s": {"type": "string"}}}}
    outer = {
        "type": "array",
        "items": {"type": "object", "properties": {"deep": inner, "row": {"type": "array", "items": NUMBER}}},
    }
    tree = record(a=outer)
    messages = [
        {"a": [{"deep": [{"x": 1}, {"x": 2, "s": "b"}], "row": [7, 8]}, {"deep": [{"s": "c"}]}, {"row": []}, 5]},
        {"a": "none"},
        {},
    ]
    fields = ("a.deep.x", "a.deep.s", "a.row", "a.row.length")
    found = decode(JsonDecoder(tree), [json.dumps(m).encode() for m in messages], fields).columns
    np.testing.assert_equal(plain(found["a.deep.x"]), [[1.0, 2.0, math.nan], [], []])
    assert found["a.deep.s"] == [("", "b", "c"), (), ()]
    assert plain(found["a.row"]) == [[7.0, 8.0], [], []]
    assert plain(found["a.row.length"]) == [[2, 0, 0, 0], [], []]


def test_what_is_no_object_is_counted() -> None:
    decoder = JsonDecoder(record(a=NUMBER))
    data = np.frombuffer(b'{"a": 1}[]{}', np.uint8)
    found = decoder.decode(data, np.array([0, 8, 10]), np.array([8, 2, 2]), ("a",))
    assert found.good.tolist() == [True, False, True]
    assert found.bad == {"not a JSON object": 1}
