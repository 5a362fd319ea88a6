"""Logs written from columns, read back by the public mcap reader and by rosbags."""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter
from typing import Any

import numpy as np
import pytest
from bags import T0, cdr, header
from mcap.reader import McapReader, NonSeekingReader, make_reader
from mcap.stream_reader import StreamReader

from locfuse.formats.container.mcap_write import ColumnWriter, MessageBlock
from locfuse.formats.results.mcap_export import Template, stamp_columns

PAYLOADS = np.arange(12, dtype=np.uint8).reshape(4, 3)
TIMES = np.array([T0 + 30, T0 + 10, T0 + 20, T0 + 40])
RAGGED = [memoryview(b"one"), memoryview(b""), memoryview(b"three")]


def written(file: io.BytesIO) -> None:
    """Two schemas, three channels (one of them empty), three chunks, an attachment, and words about the file."""
    writer = ColumnWriter(file, "ros2")
    first, second = writer.schema("pkg/A", "ros2msg", b"uint8 a"), writer.schema("pkg/B", "ros2msg", b"uint8 b")
    a = writer.channel("/a", "cdr", first, {"key": "value"})
    b, _ = writer.channel("/b", "cdr", second, {}), writer.channel("/c", "cdr", second, {})
    writer.attach("robot.toml", b"radius = 1", "application/toml", T0)
    writer.chunk([MessageBlock(a, TIMES, np.array([7, 8, 9, 10]), PAYLOADS)])
    writer.chunk([])
    writer.chunk([MessageBlock(b, TIMES[:0], TIMES[:0], [])])
    writer.metadata("about", {"made": "by hand"})
    later = TIMES[:3] + 100
    writer.chunk(
        [
            MessageBlock(b, later, np.array([1, 2, 3]), RAGGED, later + 5),
            MessageBlock(a, later + 50, np.array([11, 12, 13]), PAYLOADS[:3]),
            MessageBlock(b, later + 1000, np.array([4, 5, 6]), RAGGED),
        ]
    )
    writer.finish()


@pytest.fixture(scope="module")
def log() -> io.BytesIO:
    file = io.BytesIO()
    written(file)
    return file


Message = tuple[str, int, int, int, bytes]
SAID: list[Message] = [
    *(("/a", int(t), int(t), 7 + i, bytes(PAYLOADS[i])) for i, t in enumerate(TIMES)),
    *(("/b", int(t) + 100, int(t) + 105, 1 + i, bytes(RAGGED[i])) for i, t in enumerate(TIMES[:3])),
    *(("/a", int(t) + 150, int(t) + 150, 11 + i, bytes(PAYLOADS[i])) for i, t in enumerate(TIMES[:3])),
    *(("/b", int(t) + 1100, int(t) + 1100, 4 + i, bytes(RAGGED[i])) for i, t in enumerate(TIMES[:3])),
]


def opened(log: io.BytesIO) -> McapReader:
    log.seek(0)
    return make_reader(log, validate_crcs=True)


def messages(reader: Any) -> list[Message]:
    return sorted((c.topic, m.log_time, m.publish_time, m.sequence, m.data) for _, c, m in reader.iter_messages())


def test_every_message_is_read_back_by_the_index_and_by_a_walk(log: io.BytesIO) -> None:
    assert messages(opened(log)) == sorted(SAID)
    log.seek(0)
    assert messages(NonSeekingReader(log, validate_crcs=True)) == sorted(SAID)


def test_in_the_order_of_their_times_and_of_one_topic_alone(log: io.BytesIO) -> None:
    found = list(opened(log).iter_messages())
    assert [m.log_time for _, _, m in found] == sorted(t for _, t, *_ in SAID)
    of_b = list(opened(log).iter_messages("/b"))
    assert {s.name for s, _, _ in of_b if s} == {"pkg/B"}
    assert [m.sequence for _, _, m in of_b] == [2, 3, 1, 5, 6, 4]


def test_the_summary_says_how_much_there_is(log: io.BytesIO) -> None:
    summary = opened(log).get_summary()
    assert summary is not None
    found = summary.statistics
    assert found is not None
    counts = Counter(topic for topic, *_ in SAID)
    assert found.message_count == len(SAID)
    assert found.channel_message_counts == {1: counts["/a"], 2: counts["/b"]}
    assert (found.schema_count, found.channel_count, found.chunk_count) == (2, 3, 2)
    assert (found.attachment_count, found.metadata_count) == (1, 1)
    times = [t for _, t, *_ in SAID]
    assert (found.message_start_time, found.message_end_time) == (min(times), max(times))
    spans = [(c.message_start_time, c.message_end_time) for c in summary.chunk_indexes]
    assert spans == [(T0 + 10, T0 + 40), (T0 + 110, T0 + 1130)]
    assert {c.topic: c.metadata for c in summary.channels.values()} == {"/a": {"key": "value"}, "/b": {}, "/c": {}}
    assert [s.data for s in summary.schemas.values()] == [b"uint8 a", b"uint8 b"]


def test_attachments_and_words_are_found_by_their_indexes(log: io.BytesIO) -> None:
    reader = opened(log)
    assert [(a.name, a.media_type, a.data, a.log_time) for a in reader.iter_attachments()] == [
        ("robot.toml", "application/toml", b"radius = 1", T0)
    ]
    assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [("about", {"made": "by hand"})]
    assert reader.get_header().profile == "ros2"
    data, summary = log.getvalue(), reader.get_summary()
    assert summary is not None
    for one, opcode in ((summary.attachment_indexes[0], 9), (summary.metadata_indexes[0], 12)):
        front = struct.unpack_from("<BQ", data, one.offset)
        assert front == (opcode, one.length - 9)
    assert summary.attachment_indexes[0].data_size == len(b"radius = 1")


def test_places_sizes_and_checksums_are_those_of_the_specification(log: io.BytesIO) -> None:
    """https://mcap.dev/spec: every index points at its record; three checksums; groups of the summary."""
    data = log.getvalue()
    summary = opened(log).get_summary()
    assert summary is not None
    for chunk in summary.chunk_indexes:
        opcode, length = struct.unpack_from("<BQ", data, chunk.chunk_start_offset)
        assert (opcode, length) == (6, chunk.chunk_length - 9)
        first = chunk.chunk_start_offset + chunk.chunk_length
        assert min(chunk.message_index_offsets.values()) == first
        end = 0
        for channel, at in chunk.message_index_offsets.items():
            opcode, length, ident, size = struct.unpack_from("<BQHI", data, at)
            assert (opcode, ident, length) == (7, channel, size + 6)
            times = np.frombuffer(data, "<u8", size // 8, at + 15)[::2]
            assert (np.diff(times.astype(np.int64)) >= 0).all()
            end = max(end, at + 9 + length)
        assert chunk.message_index_length == end - first
    start, offset_start, crc = struct.unpack_from("<QQI", data, len(data) - 28)
    assert crc == zlib.crc32(data[start:-12])
    at = data.rindex(struct.pack("<BQ", 15, 4), 0, start)
    assert struct.unpack_from("<I", data, at + 9)[0] == zlib.crc32(data[:at])
    assert at + 13 == start
    groups = []
    while data[offset_start] == 14:
        _, length, opcode, begin, size = struct.unpack_from("<BQBQQ", data, offset_start)
        groups.append((opcode, begin, begin + size))
        assert data[begin] == opcode
        offset_start += 9 + length
    assert [opcode for opcode, *_ in groups] == [3, 4, 11, 8, 10, 13]
    assert [end for *_, end in groups[:-1]] == [begin for _, begin, _ in groups[1:]]
    log.seek(0)
    kinds = [type(record).__name__ for record in StreamReader(log, validate_crcs=True).records]
    assert kinds[0] == "Header"
    assert kinds[-1] == "Footer"


def test_an_empty_log_is_one_too() -> None:
    file = io.BytesIO()
    ColumnWriter(file).finish()
    summary = opened(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert (summary.statistics.message_count, summary.statistics.message_end_time) == (0, 0)


# --- many messages of one type


def test_columns_are_laid_over_the_bytes_of_one_message() -> None:
    """Numbers of every size and place, an array of numbers, and all that is constant; against rosbags."""
    constant = {"header.frame_id": "laser", "ranges": np.zeros(3, np.float32), "angle_min": -1.5}
    n = 5
    t = T0 + 1_999_999_999 * np.arange(n)
    columns = {
        **stamp_columns("header.stamp", t),
        "ranges": np.arange(3.0 * n).reshape(n, 3),
        "scan_time": np.linspace(0.0, 1.0, n),
    }
    template = Template("sensor_msgs/msg/LaserScan", constant, columns.keys())
    found = template.filled(columns)
    for i in range(n):
        expected = cdr(
            "sensor_msgs/msg/LaserScan", header=header(int(t[i]), "laser"), angle_min=-1.5,
            ranges=columns["ranges"][i].astype(np.float32), scan_time=columns["scan_time"][i],
        )  # fmt: skip
        assert found[i].tobytes() == expected
    whole = Template("std_msgs/msg/Int16", {}, ["data"]).filled({"data": np.array([3, -4])})
    assert [row.tobytes() for row in whole] == [cdr("std_msgs/msg/Int16", data=v) for v in (3, -4)]


def test_a_template_takes_numbers_and_time_stamps_at_the_second() -> None:
    found = stamp_columns("a", np.array([0, 999_999_999, 1_000_000_000, 2_500_000_000]))
    assert {name: column.tolist() for name, column in found.items()} == {
        "a.sec": [0, 0, 1, 2],
        "a.nanosec": [0, 999_999_999, 0, 500_000_000],
    }
