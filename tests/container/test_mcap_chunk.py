"""The inside of a chunk, laid by hand byte by byte: what is found, where it ends, and what an index may say."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
import pytest

from locfuse.formats.container.chunked import Records, most_records
from locfuse.formats.container.decompress import DamagedError
from locfuse.formats.container.mcap_records import Index, records, scan
from locfuse.formats.container.source import Messages

SCHEMA, CHANNEL, MESSAGE, DATA_END, PRIVATE = 3, 4, 5, 15, 0x80  # opcodes of https://mcap.dev/spec


class Row(NamedTuple):
    """A message as it is written."""

    channel: int
    sequence: int
    log_time: int
    payload: bytes


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def message(row: Row) -> bytes:
    return record(MESSAGE, struct.pack("<HIQQ", row.channel, row.sequence, row.log_time, 99) + row.payload)


ROWS = [
    Row(1, 70, 1000, b"first"),
    Row(2, 71, 1001, b""),
    Row(1, 72, 1002, b"third"),
    Row(300, 73, 2**40, b"x" * 300),
]
FRONT = record(SCHEMA, b"said") + record(CHANNEL, b"")
BETWEEN = record(PRIVATE, b"private") + record(CHANNEL, b"again") + record(255, b"")


def laid(rows: list[Row] = ROWS) -> tuple[bytes, list[int]]:
    """Definitions, two messages, other records, and the other messages; with the place of each message."""
    data, places = FRONT, []
    for i, row in enumerate(rows):
        data += BETWEEN if i == 2 else b""
        places.append(len(data))
        data += message(row)
    return data, places


def array(data: bytes) -> np.ndarray:
    return np.frombuffer(data, np.uint8)


def index_of(rows: list[Row], places: list[int]) -> Index:
    entries: dict[int, list[tuple[int, int]]] = {}
    for row, place in zip(rows, places, strict=True):
        entries.setdefault(row.channel, []).append((row.log_time, place))
    return {channel: np.array(pairs, "<u8") for channel, pairs in entries.items()}


def rows_of(data: bytes, found: dict[int, Messages]) -> list[Row]:
    """The messages that were found, in the order of their places."""
    rows = [
        (start, Row(channel, sequence, log_time, data[start : start + length]))
        for channel, m in found.items()
        for start, length, log_time, sequence, _ in zip(*(column.tolist() for column in m), strict=True)
    ]
    return [row for _, row in sorted(rows)]


def contents(data: bytes, found: Records) -> list[tuple[int, bytes]]:
    return [(opcode, data[at : at + length]) for opcode, at, length in found.definitions]


def test_a_walk_finds_every_message_and_definition_and_passes_over_private_records() -> None:
    data, _ = laid()
    found = scan(array(data))
    assert rows_of(data, found.messages) == ROWS
    assert contents(data, found) == [(SCHEMA, b"said"), (CHANNEL, b""), (CHANNEL, b"again")]
    assert found.end == len(data)


@pytest.mark.parametrize("rest", range(1, 9))
def test_bytes_too_few_for_a_record_are_where_the_records_end(rest: int) -> None:
    """A message before them is kept only if they begin like a record: 3 is the opcode of a schema."""
    data, places = laid()
    for begin, kept in ((3, 4), (0, 3)):
        found = scan(array(data + bytes([begin]) * rest))
        assert found.end == (len(data) if kept == 4 else places[-1])
        assert rows_of(data, found.messages) == ROWS[:kept]


@pytest.mark.parametrize("opcode", [0, 1, 2, 5, 6, 7, 15, 16, 127])
def test_the_records_end_at_one_that_does_not_belong_in_a_chunk(opcode: int) -> None:
    """Where the bytes behind a message are no record of any file, the damage may have begun within the message."""
    data, places = laid()
    found = scan(array(data + record(opcode, bytes(21)) + message(ROWS[0])))
    begins_a_record = 0 < opcode <= DATA_END
    assert found.end == (len(data) if begins_a_record else places[-1])
    assert rows_of(data, found.messages) == (ROWS if begins_a_record else ROWS[:-1])


def test_records_end_where_one_is_too_short_or_reaches_too_far() -> None:
    assert scan(array(record(MESSAGE, bytes(22)))).end == 31
    assert scan(array(record(MESSAGE, bytes(21)))).end == 0
    data, places = laid()
    found = scan(array(data[:-1]))
    assert found.end == places[-1]
    assert rows_of(data, found.messages) == ROWS[:-1]


def test_as_many_records_as_the_cap_are_read_and_one_more_is_refused() -> None:
    data = message(ROWS[0]) * 6
    assert len(rows_of(data, scan(array(data), 6).messages)) == 6
    assert len(rows_of(data, scan(array(data + b"\x05" * 8), 6).messages)) == 6
    with pytest.raises(DamagedError, match="more than 6 records"):
        scan(array(data + message(ROWS[0])), 6)
    with pytest.raises(DamagedError, match="more than 6 records"):
        scan(array(data + bytes(9)), 6)


def test_every_byte_of_a_file_may_hold_a_record_beside_those_that_are_free() -> None:
    assert most_records(1000) - most_records(0) == 1000


def found_in(data: bytes, index: Index) -> Records:
    return records(array(data), len(data), index)


BROKEN = bytes(9)  # no record: only the index tells of the messages behind it


def test_an_entry_points_at_a_message_of_its_channel_and_time_or_does_not_count() -> None:
    data, places = laid()
    data, places = BROKEN + data, [len(BROKEN) + place for place in places]
    assert rows_of(data, found_in(data, index_of(ROWS, places)).messages) == ROWS
    for rows, at in (
        ([row._replace(channel=row.channel + 1) for row in ROWS], places),
        ([row._replace(log_time=row.log_time + 1) for row in ROWS], places),
        (ROWS, [place + 1 for place in places]),
        (ROWS, [place - 1 for place in places]),
        (ROWS, [len(data) - 30] * 4),
        (ROWS, [2**64 - 1] * 4),
    ):
        assert not found_in(data, index_of(rows, at)).messages
    assert rows_of(data, found_in(data[:-1], index_of(ROWS, places)).messages) == ROWS[:3]
    assert not found_in(data[:30], index_of(ROWS, places)).messages


@pytest.mark.parametrize("change", ["none", "opcode", "short"])
def test_an_entry_that_points_at_what_is_no_whole_message_does_not_count(change: str) -> None:
    data = bytearray(BROKEN + message(ROWS[1]))
    data[len(BROKEN) + (change == "short")] -= change != "none"
    found = found_in(bytes(data), index_of([ROWS[1]], [len(BROKEN)]))
    assert rows_of(bytes(data), found.messages) == ([ROWS[1]] if change == "none" else [])


def test_a_message_may_lie_at_the_start_and_at_the_end_of_a_chunk() -> None:
    data = message(ROWS[1])
    found = found_in(data, index_of([ROWS[1]], [0]))
    assert rows_of(data, found.messages) == [ROWS[1]]
    assert found.end == len(data) == 31


def test_the_index_finds_what_the_walk_finds() -> None:
    data, places = laid()
    shuffled = dict(reversed(index_of(ROWS, places).items()))
    for index in ({}, index_of(ROWS, places), shuffled):
        found = found_in(data, index)
        assert rows_of(data, found.messages) == ROWS
        assert contents(data, found) == [(SCHEMA, b"said"), (CHANNEL, b""), (CHANNEL, b"again")]
        assert found.end == len(data)


@pytest.mark.parametrize("left_out", range(4))
def test_an_index_that_leaves_out_one_message_is_not_believed(left_out: int) -> None:
    data, places = laid()
    some = [i for i in range(4) if i != left_out]
    found = found_in(data, index_of([ROWS[i] for i in some], [places[i] for i in some]))
    assert rows_of(data, found.messages) == ROWS


def test_an_index_that_names_a_message_twice_is_not_believed() -> None:
    data, places = laid()
    found = found_in(data, index_of([*ROWS, ROWS[0]], [*places, places[0]]))
    assert rows_of(data, found.messages) == ROWS


def test_a_message_inside_another_is_not_believed() -> None:
    """The payload of the outer one is a message itself, and the index names both."""
    inner = message(ROWS[0])
    outer = Row(1, 0, 5, inner)
    data = message(outer) + message(ROWS[2])
    index = index_of([outer, ROWS[0], ROWS[2]], [0, 31, len(message(outer))])
    assert rows_of(data, found_in(data, index).messages) == [outer, ROWS[2]]
    broken = data + bytes(40)  # then nothing but the index tells of the last one, and the outer one counts
    end = len(message(outer)) + len(message(ROWS[2]))
    found = found_in(broken, index)
    assert rows_of(data, found.messages) == [outer]
    assert found.end == end - len(message(ROWS[2]))


def test_in_a_damaged_chunk_the_index_finds_what_lies_before_and_behind_the_damage() -> None:
    data, places = laid()
    broken = bytearray(data)
    broken[places[1] : places[1] + 9] = bytes(9)
    found = found_in(bytes(broken), index_of(ROWS, places))
    assert rows_of(data, found.messages) == [ROWS[2], ROWS[3]]  # in the first one the damage may have begun
    assert found.end == places[0]
    assert contents(data, found) == [(SCHEMA, b"said"), (CHANNEL, b"")]
    assert rows_of(data, found_in(bytes(broken), {}).messages) == []


@pytest.mark.parametrize(("opcode", "kept"), [(0, 1), (1, 2), (15, 2), (16, 1), (127, 1), (128, 2)])
def test_in_a_damaged_chunk_a_message_counts_if_a_record_or_the_end_follows(opcode: int, kept: int) -> None:
    rows = [ROWS[0], ROWS[2]]
    first, second = map(message, rows)
    data = first + record(opcode, b"?") + bytes(50) + second
    found = found_in(data, index_of(rows, [0, len(data) - len(second)]))
    assert rows_of(data, found.messages) == rows[2 - kept :]


def test_few_bytes_that_unpack_to_many_records_are_refused_by_the_index_too() -> None:
    free = most_records(0)
    data = FRONT * (free // 2 + 1) + message(ROWS[0])
    index = index_of([ROWS[0]], [len(data) - len(message(ROWS[0]))])
    assert rows_of(data, found_in(data, index).messages) == [ROWS[0]]
    with pytest.raises(DamagedError, match="the cap for its size"):
        records(array(data), 1, index)
