"""Columns are what rosbags and mcap-ros2-support read, in every real log and in types nobody wrote."""

import random
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from bags import STORE, cdr, header, real_log, real_logs, recorded, rows
from invented import assert_same, at_path, decode, invented, walks, written
from mcap_ros2.decoder import DecoderFactory
from present import present
from rosbags.serde.errors import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.field_paths import paths
from locfuse.formats.container.source import message_type
from locfuse.formats.messages.cdr import ROS1, Decoder
from locfuse.formats.messages.schema import SchemaError, parse

SCAN = "sensor_msgs/msg/LaserScan"


def by_rosbags(schema: Any) -> Callable[[bytes], Any]:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.data.decode(), schema.name))
    return lambda data: store.deserialize_cdr(data, message_type(schema.name))


def by_mcap_ros2(schema: Any) -> Callable[[bytes], Any]:
    return present(DecoderFactory().decoder_for("cdr", schema))


@pytest.mark.parametrize("name", [n for n in real_logs() if "truncated" not in n and "json" not in n] or [None])
def test_every_field_of_a_message_is_what_public_readers_say(name: str | None) -> None:
    for topic, messages in recorded(real_log(name or "none")).items():
        schema = messages[0][0]
        if "_service_event" in topic:
            continue  # no public parser reads them either
        decoder = Decoder(parse(schema.name, "ros2msg", schema.data.decode()))
        fields = paths(decoder.message)
        some = messages[:: max(len(messages) // 150, 1)]
        decoded = decode(decoder, [m.data for _, m in some], fields)
        assert decoded.good.all(), (topic, decoded.bad)
        for oracle in (by_rosbags, by_mcap_ros2):
            reference = oracle(schema)
            expected = [reference(m.data) for _, m in some]
            for field in fields:
                column = decoded.columns[field]
                assert len(column) == len(some)
                for i, message in enumerate(expected):
                    assert_same(column[i], at_path(message, field))


@pytest.mark.parametrize("seed", range(80))
@pytest.mark.parametrize("kind", ["little", "big", "ros1"])
def test_invented_types_read_the_same_as_by_rosbags(seed: int, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    walked = walks(monkeypatch)
    text, store, messages = invented(seed, 8)
    raw = [written(store, m, kind) for m in messages]
    decoder = Decoder(parse("t/Top", "ros2msg", text))
    if kind == "ros1":
        decoder = Decoder(parse("t/Top", "ros1msg", text, filler=False), ROS1)
    fields = paths(decoder.message)
    for _ in range(2):  # the second time all layouts are known
        decoded = decode(decoder, raw, fields)
        assert decoded.good.all(), decoded.bad
        for field in fields:
            for i, message in enumerate(messages):
                assert_same(decoded.columns[field][i], at_path(message, field))
    assert len(walked) <= 8


def scan(i: int, beams: int = 20, little: bool = True) -> bytes:
    ranges = np.linspace(1, 2 + i, beams).astype(np.float32)
    return cdr(SCAN, little, header=header(i, "laser"), ranges=ranges, intensities=ranges[:3])


def scan_decoder() -> Decoder:
    return Decoder(parse(SCAN, "ros2msg", STORE.generate_msgdef(SCAN, ros_version=2)[0]))


@pytest.mark.parametrize("little", [True, False])
def test_images_of_many_sizes_are_gathered_after_one_walk(little: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    walked = walks(monkeypatch)
    kind = "sensor_msgs/msg/CompressedImage"
    decoder = Decoder(parse(kind, "ros2msg", STORE.generate_msgdef(kind, ros_version=2)[0]))
    pictures = [bytes(range(n)) for n in (5, 0, 17, 200, 17, 1)]
    messages = [cdr(kind, little, header=header(i), format="jpeg", data=list(p)) for i, p in enumerate(pictures)]
    decoded = decode(decoder, messages, ["data", "format"])
    assert decoded.columns["data"] == pictures
    assert len(walked) == 1
    cut = decode(decoder, [messages[3][:-1], messages[3] + bytes(4)], ["data"])
    assert cut.bad == {"shorter than its type": 1, "longer than its type": 1}


def test_a_layout_that_was_used_lately_is_not_walked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("locfuse.formats.messages.cdr.MAX_LAYOUTS", 2)
    walked = walks(monkeypatch)
    kind = "sensor_msgs/msg/CompressedImage"
    decoder = Decoder(parse(kind, "ros2msg", STORE.generate_msgdef(kind, ros_version=2)[0]))
    counts = []
    for name in ("jpeg", "jpeg", "a long name", "jpeg", "a longer name, 24 bytes", "jpeg", "a long name"):
        decoded = decode(decoder, [cdr(kind, header=header(0), format=name, data=[1, 2])] * 2, ["format", "data"])
        assert decoded.columns["data"] == [b"\1\2"] * 2
        counts.append(len(walked))
    assert counts == [1, 1, 2, 2, 3, 3, 4]  # the last one was put out by a layout that is used more often


def test_numbers_at_the_end_of_a_message_may_differ_in_length(monkeypatch: pytest.MonkeyPatch) -> None:
    walked = walks(monkeypatch)
    kind = "std_msgs/msg/Float64MultiArray"
    decoder = Decoder(parse(kind, "ros2msg", STORE.generate_msgdef(kind, ros_version=2)[0]))
    rows_said = [np.arange(n, dtype=float) for n in (0, 3, 1, 0, 40)]
    decoded = decode(decoder, [cdr(kind, data=row) for row in rows_said], ["data", "layout.data_offset"])
    for got, said in zip(rows(decoded.columns["data"]), rows_said, strict=True):
        np.testing.assert_array_equal(got, said)
    assert len(walked) == 1


@pytest.mark.parametrize(("spare", "good"), [(3, True), (4, False), (8, False), (16, False)])
def test_behind_numbers_at_the_end_no_more_than_padding_may_follow(spare: int, good: bool) -> None:
    kind = "std_msgs/msg/UInt16MultiArray"
    decoder = Decoder(parse(kind, "ros2msg", STORE.generate_msgdef(kind, ros_version=2)[0]))
    messages = [cdr(kind, data=np.arange(n, dtype=np.uint16)) for n in (2, 4, 6)]
    decoded = decode(decoder, [*messages, messages[1] + bytes(spare)], ["data"])
    assert decoded.bad == ({} if good else {"longer than its type": 1})
    assert [row.tolist() for row in rows(decoded.columns["data"])][:3] == [list(range(n)) for n in (2, 4, 6)]


ECHOES = [[[1, 2], [3]], [[4], [5, 6]], [[7, 8], [9]], [[1], [2, 3]], [[], [1, 2, 3]]]  # equally many bytes
ENDING = [[[1, 2], [3]], [[4, 5], [6, 7]], [[8, 9], []], [[1], [2]], [[1, 2], [3]]]


def echoes(said: list[list[int]]) -> bytes:
    """Arrays amid a message, by rosbags."""
    ranges = [{"echoes": np.array(one, np.float32)} for one in said]
    return cdr("sensor_msgs/msg/MultiEchoLaserScan", header=header(1, "a"), ranges=ranges)


def ending(said: list[list[int]]) -> bytes:
    """Arrays at the end of a message, by hand."""
    items = b"".join(struct.pack(f"<I{len(one)}f", len(one), *one) for one in said)
    return b"\0\1\0\0" + struct.pack("<I", len(said)) + items


@pytest.mark.parametrize(
    ("kind", "field", "said", "message"),
    [
        ("sensor_msgs/msg/MultiEchoLaserScan", "ranges.echoes", ECHOES, echoes),
        ("pkg/msg/Items", "items.v", ENDING, ending),
    ],
)
def test_arrays_inside_arrays_are_gathered_by_the_lengths_of_their_own_message(
    kind: str, field: str, said: list[list[list[int]]], message: Callable[[list[list[int]]], bytes]
) -> None:
    own = "Item[] items\n" + "=" * 80 + "\nMSG: pkg/Item\nfloat32[] v\n"
    text = own if kind.startswith("pkg") else STORE.generate_msgdef(kind, ros_version=2)[0]
    decoded = decode(Decoder(parse(kind, "ros2msg", text)), [*map(message, said)], [field, f"{field}.length"])
    values, lengths = (rows(column) for column in decoded.columns.values())
    assert [row.tolist() for row in lengths] == [[len(e) for e in m] for m in said]
    assert [row.tolist() for row in values] == [[x for e in m for x in e] for m in said]


def test_both_byte_orders_in_one_stream() -> None:
    decoded = decode(scan_decoder(), [scan(i, little=i % 2 == 0) for i in range(10)], ["header.stamp", "ranges"])
    stamp, ranges = decoded.columns["header.stamp"], decoded.columns["ranges"]
    np.testing.assert_array_equal(np.asarray(stamp), range(10))
    assert [float(ranges[i][-1]) for i in range(10)] == [2.0 + i for i in range(10)]


def test_garbage_never_raises_and_never_differs_from_rosbags_where_both_read_it() -> None:
    rng = random.Random(0)
    definition = STORE.generate_msgdef("sensor_msgs/msg/JointState", ros_version=2)[0]
    decoder = Decoder(parse("sensor_msgs/msg/JointState", "ros2msg", definition))
    good = cdr(
        "sensor_msgs/msg/JointState", header=header(5, "b"), name=["l", "r"], position=[1, 2], velocity=[3, 4]
    )
    n_read = 0
    for _ in range(3000):
        bad = bytearray(good)
        for _ in range(rng.randint(1, 3)):
            bad[rng.randrange(len(bad))] = rng.choice([0, 1, 255, rng.randrange(256)])
        decoded = decode(decoder, [bytes(bad)], ["name", "position", "effort"])
        try:
            reference: Any = STORE.deserialize_cdr(bytes(bad), "sensor_msgs/msg/JointState")
        except (SerdeError, UnicodeDecodeError):
            continue
        if decoded.good[0]:
            n_read += 1
            assert_same(decoded.columns["position"][0], reference.position)
            assert_same(decoded.columns["name"][0], reference.name)
    assert n_read > 500


IDL = """================================================================================
IDL: t/msg/Pair
#include "builtin_interfaces/msg/Time.idl"
module t {
  module msg {
    typedef double double__2[2];
    struct Pair {
      @verbatim (language="comment", text="when")
      builtin_interfaces::msg::Time stamp;
      string frame;
      double__2 xy;
      sequence<float> ranges;
      sequence<t::msg::Tag> tags;
    };
  };
};
================================================================================
IDL: t/msg/Tag
module t {
  module msg {
    struct Tag { string name; uint8 id; };
  };
};
================================================================================
IDL: builtin_interfaces/msg/Time
module builtin_interfaces {
  module msg {
    struct Time { long sec; unsigned long nanosec; };
  };
};
"""
TWIN = """builtin_interfaces/Time stamp
string frame
float64[2] xy
float32[] ranges
Tag[] tags
================================================================================
MSG: t/Tag
string name
uint8 id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def test_an_idl_definition_reads_like_its_msg_twin() -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(TWIN, "t/msg/Pair"))
    types = store.types
    message = types["t/msg/Pair"](
        stamp=types["builtin_interfaces/msg/Time"](sec=5, nanosec=7),
        frame="map",
        xy=np.array([1.0, 2.0]),
        ranges=np.array([3, 4], np.float32),
        tags=[types["t/msg/Tag"](name="a", id=1), types["t/msg/Tag"](name="bc", id=2)],
    )
    raw = bytes(store.serialize_cdr(message, "t/msg/Pair"))
    by_idl, by_msg = (
        Decoder(parse("t/msg/Pair", encoding, text)) for encoding, text in (("ros2idl", IDL), ("ros2msg", TWIN))
    )
    fields = paths(by_msg.message)
    assert paths(by_idl.message) == fields
    one, other = (decode(decoder, [raw], fields).columns for decoder in (by_idl, by_msg))
    for field in fields:
        assert_same(one[field][0], other[field][0])
    assert one["stamp"][0] == 5_000_000_007
    assert one["tags.name"] == [("a", "bc")]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("float64 x\nnonsense !!", "cannot be parsed"),
        ("t/Missing part", "names t/msg/Missing and does not define it"),
        ("t/Top again", "contains itself"),
        ("wstring w", "wstring"),
    ],
)
def test_a_definition_that_cannot_be_used_says_why_in_one_line(text: str, says: str) -> None:
    with pytest.raises(SchemaError, match=says) as raised:
        parse("t/Top", "ros2msg", text)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 120


@pytest.mark.parametrize("spelling", ["sensor_msgs/msg/Imu", "sensor_msgs/Imu", "sensor_msgs::msg::Imu"])
def test_type_names_are_spelt_one_way(spelling: str) -> None:
    assert message_type(spelling) == "sensor_msgs/msg/Imu"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("little", [True, False])
def test_a_signalling_nan_becomes_a_quiet_one(little: bool) -> None:
    """Bits 7fa00001: without the highest bit of the fraction, a conversion to double raises the invalid flag."""
    end = "<" if little else ">"
    floats = struct.pack(f"{end}3I", 0x7FA00001, *np.array([2.5, np.inf], np.float32).view(np.uint32).tolist())
    doubles = struct.pack(f"{end}Q", 0x7FF4000000000001)
    payload = bytes((0, little, 0, 0)) + floats + bytes(4) + doubles
    decoder = Decoder(parse("a/msg/B", "ros2msg", "float32[3] f\nfloat64 d"))
    columns = decode(decoder, [payload], ("f", "d")).columns
    np.testing.assert_array_equal(np.asarray(columns["f"]).astype(np.float64), [[np.nan, 2.5, np.inf]])
    assert np.isnan(np.asarray(columns["d"]) * 2.0).all()
