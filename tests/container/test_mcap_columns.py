"""Logs written from columns, read back by the public mcap reader and by rosbags."""

from __future__ import annotations

import io

import numpy as np
from bags import T0, cdr, header
from mcap.reader import make_reader

from locfuse.formats.container.mcap_write import MessageBlock, open_writer
from locfuse.formats.results.mcap_export import Template, stamp_columns


def test_blocks_of_equal_and_of_any_lengths_are_read_back() -> None:
    payloads, times = np.arange(6, dtype=np.uint8).reshape(2, 3), np.array([T0 + 30, T0 + 10])
    file = io.BytesIO()
    writer = open_writer(file)
    a, b = (writer.register_channel(topic, "cdr", 0, {}) for topic in ("/a", "/b"))
    MessageBlock(a, times, np.array([7, 8]), payloads).write(writer)
    MessageBlock(b, times, np.array([1, 2]), [memoryview(b""), memoryview(b"three")], times + 5).write(writer)
    MessageBlock(b, times[:0], times[:0], []).write(writer)
    writer.finish()
    found = make_reader(io.BytesIO(file.getvalue()), validate_crcs=True).iter_messages(log_time_order=False)
    assert [(c.topic, m.log_time, m.publish_time, m.sequence, m.data) for _, c, m in found] == [
        ("/a", T0 + 30, T0 + 30, 7, b"\x00\x01\x02"),
        ("/a", T0 + 10, T0 + 10, 8, b"\x03\x04\x05"),
        ("/b", T0 + 30, T0 + 35, 1, b""),
        ("/b", T0 + 10, T0 + 15, 2, b"three"),
    ]


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
