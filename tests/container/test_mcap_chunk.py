"""The inside of a chunk, laid by hand byte by byte: what is found, where it ends, and what an index may say."""

import random
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from bags import LIGHT, T0, Said, cdr, delivered, drive, real_log, write
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType

from locfuse.formats.container.decompress import DamagedError, decompress
from locfuse.formats.container.file_bytes import FileBytes, Losses
from locfuse.formats.container.mcap_records import Index, records, scan
from locfuse.formats.container.mcap_source import McapSource
from locfuse.formats.container.source import Messages, Records, most_records
from locfuse.formats.logs.log import Log, open_log
from locfuse.fusion.data import LocfuseError

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
    assert [scan(array(record(MESSAGE, bytes(n)))).end for n in (22, 21)] == [31, 0]  # the shortest message
    assert rows_of(data, scan(array(data[:-1])).messages) == ROWS[:-1]


def test_as_many_records_as_the_cap_are_read_and_one_more_is_refused() -> None:
    data = message(ROWS[0]) * 6
    assert len(rows_of(data, scan(array(data), 6).messages)) == 6
    assert len(rows_of(data, scan(array(data + b"\x05" * 8), 6).messages)) == 6
    with pytest.raises(DamagedError, match="more than 6 records"):
        scan(array(data + message(ROWS[0])), 6)
    with pytest.raises(DamagedError, match="more than 6 records"):
        scan(array(data + bytes(9)), 6)


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


def test_whatever_the_index_says_of_a_sound_chunk_the_walk_counts() -> None:
    """It is whole, in another order, without one message or with one of them twice."""
    data, places = laid()
    whole = list(zip(ROWS, places, strict=True))
    indexes = [[], whole, whole[::-1], [*whole, whole[0]], *(whole[:i] + whole[i + 1 :] for i in range(4))]
    for pairs in indexes:
        found = found_in(data, index_of([row for row, _ in pairs], [place for _, place in pairs]))
        assert rows_of(data, found.messages) == ROWS
        assert contents(data, found) == [(SCHEMA, b"said"), (CHANNEL, b""), (CHANNEL, b"again")]
        assert found.end == len(data)


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


# --- whole files, by the public writer: damaged anywhere

PLAIN: dict[str, Any] = {"enable_crcs": False, "chunk_size": 4000}


def payloads(path: Path) -> list[tuple[str, int, bytes]]:
    """(topic, log time, bytes) of every message the source delivers."""
    return [(topic, t, data) for topic, t, _, data in delivered(McapSource(FileBytes(path, Losses())))]


def whole(said: list[Said]) -> list[tuple[str, int, bytes]]:
    return sorted((m.topic, m.log_time, m.data) for m in said)


def losses_of(path: Path) -> Losses:
    """What is lost when everything is read."""
    log = open_log([path])
    for topic in log.topics.values():
        assert topic.problem is None
    for name in log.topics:
        assert log.stream(name).t_ns is not None
    return log.losses


def test_chunks_come_in_the_order_of_their_times_and_where_log_times_jitter_in_that_of_the_file(
    tmp_path: Path,
) -> None:
    """Every tenth message was written 0.3 s before its neighbours; chunks overlap, and none is moved."""
    said = drive(60)
    order = np.random.default_rng(1).permutation(len(said))
    found = payloads(write(tmp_path / "x.mcap", [said[i] for i in order], chunk_size=1))
    assert [t for _, t, _ in found] == sorted(m.log_time for m in said)
    assert sorted(found) == whole(said)
    said = [m._replace(log_time=m.log_time - 300_000_000 * (i % 10 == 9)) for i, m in enumerate(said)]
    times = [t for topic, t, _ in payloads(write(tmp_path / "y.mcap", said, chunk_size=3000)) if topic == "/scan"]
    assert times == [m.log_time for m in said if m.topic == "/scan"]
    assert times != sorted(times)


@pytest.mark.parametrize(
    "layout",
    [PLAIN, {"use_chunking": False}, {"use_chunking": False, "enable_data_crcs": True}, {"chunk_size": 4000}],
)
def test_a_truncated_file_gives_every_message_that_is_wholly_there(tmp_path: Path, layout: dict[str, Any]) -> None:
    """Cut in steps, and anywhere from behind the last message on."""
    said = drive(40)
    content = write(tmp_path / "whole.mcap", said, **layout).read_bytes()
    ends = {content.index(m.data) + len(m.data): (m.topic, m.log_time, m.data) for m in said}
    path = tmp_path / "cut.mcap"
    for cut in (*range(300, len(content), 173), *range(max(ends), max(ends) + 40)):
        path.write_bytes(content[:cut])
        there = sorted(message for end, message in ends.items() if end <= cut)
        assert sorted(payloads(path)) == there, cut
        assert losses_of(path) or len(there) == len(said)


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_truncated_packed_file_gives_all_whole_chunks(tmp_path: Path, compression: CompressionType) -> None:
    said = drive(100)
    path = write(tmp_path / "whole.mcap", said, compression=compression, chunk_size=4000)
    content = path.read_bytes()
    in_order = [(m.topic, m.log_time, m.data) for m in said]
    chunks = []  # (end in the file, messages up to there)
    with path.open("rb") as file:
        n = 0
        record: Any
        for record in StreamReader(file, emit_chunks=True).records:
            if type(record).__name__ == "Chunk":
                plain = decompress(record.data, record.compression, record.uncompressed_size)
                n += sum(len(m.start) for m in scan(np.frombuffer(plain, np.uint8)).messages.values())
                chunks.append((content.index(record.data) + len(record.data), n))
    cut_path = tmp_path / "cut.mcap"
    for cut in range(200, len(content), 307):
        cut_path.write_bytes(content[:cut])
        found = sorted(payloads(cut_path), key=in_order.index)
        assert found == in_order[: len(found)]
        assert len(found) >= max([n for end, n in chunks if end <= cut], default=0)


def test_a_real_truncated_file_gives_the_messages_of_its_whole_twin() -> None:
    cut, twin = (real_log(f"bags/tiryoh/test_sample{suffix}.mcap") for suffix in ("_truncated", ""))
    assert payloads(cut) == payloads(twin)
    assert any("cut off" in line for line in losses_of(cut).lines())


@pytest.mark.parametrize(
    "layout", [{"chunk_size": 3000}, {"chunk_size": 3000, "compression": CompressionType.ZSTD}, PLAIN]
)
def test_a_flipped_bit_is_noticed_or_without_effect_and_costs_a_chunk_where_there_are_no_checksums(
    tmp_path: Path, layout: dict[str, Any]
) -> None:
    said, checked = drive(40), layout is not PLAIN
    content = write(tmp_path / "whole.mcap", said, **layout).read_bytes()
    original, rng, n_lossy = set(whole(said)), random.Random(0), 0
    path = tmp_path / "bad.mcap"
    for _ in range(60):
        bad = bytearray(content)
        for _ in range(1 if checked else rng.choice([1, 1, 3])):
            bad[rng.randrange(8, len(bad))] ^= 1 << rng.randrange(8)
        path.write_bytes(bad)
        log = opened(path)
        if log is None:
            continue
        found = read_everything(log)
        if checked:
            assert found <= original
            assert found == original or log.losses
        else:
            assert len(found) >= len(said) - 3 or log.losses
        n_lossy += bool(log.losses)
    assert n_lossy > 12 or not checked


def opened(path: Path) -> Log | None:
    """The log, or None where it is refused with one line."""
    try:
        return open_log([path])
    except LocfuseError as problem:
        line = str(problem)
    assert "\n" not in line
    return None


def read_everything(log: Log) -> set[tuple[str, int, bytes]]:
    """Read every stream, as the product does, then every payload."""
    found: set[tuple[str, int, bytes]] = set()
    for name, topic in log.topics.items():
        if topic.problem is None:
            with suppress(LocfuseError):  # a damaged definition
                assert (np.diff(log.stream(name).t_ns) >= 0).all()
    for path in log.paths:
        assert isinstance(path, Path)
        found.update(payloads(path))
    return found


@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize("layout", [PLAIN, {"chunk_size": 4000}, {"use_chunking": False}])
def test_a_hole_loses_its_own_and_nothing_behind(tmp_path: Path, layout: dict[str, Any], summary: bool) -> None:
    said = drive(200)
    content = bytearray(write(tmp_path / "whole.mcap", said, **layout).read_bytes())
    places = {(m.topic, m.log_time, m.data): content.index(m.data) for m in said}
    if not summary:
        content[-40:] = b""
    start, stop = len(content) // 3, len(content) // 3 + 700
    content[start:stop] = bytes(stop - start)
    path = tmp_path / "hole.mcap"
    path.write_bytes(content)
    found = set(payloads(path))
    reach = 0 if layout.get("enable_crcs") is False else 4000  # with checksums a chunk goes as a whole
    outside = {m for m, at in places.items() if at + len(m[2]) < start - 200 - reach or at > stop + 800 + reach}
    assert outside <= found <= set(places)
    assert len(outside) > len(said) // 2
    assert losses_of(path)


def test_a_loss_met_by_two_walks_counts_once(tmp_path: Path) -> None:
    content = bytearray(write(tmp_path / "whole.mcap", drive(60), chunk_size=4000).read_bytes())
    content[len(content) // 2] ^= 1
    path = tmp_path / "bad.mcap"
    path.write_bytes(content)
    log = open_log([path])
    streams = log.streams(LIGHT)
    before = log.losses.lines()
    assert before == [
        f"{path}: a chunk fails its checksum ({log.losses.bytes} bytes, {log.losses.messages} messages)"
    ]
    for stream in streams.values():
        list(stream.blocks())
    assert log.losses.lines() == before


def test_a_file_of_loose_messages_fails_its_data_checksum(tmp_path: Path) -> None:
    said = drive(40)
    path = write(tmp_path / "x.mcap", said, use_chunking=False, enable_data_crcs=True)
    assert not losses_of(path)
    content = bytearray(path.read_bytes())
    content[content.index(said[20].data) + 30] ^= 1
    path.write_bytes(content)
    assert losses_of(path).lines() == [f"{path}: the file fails its checksum: values may be wrong"]


def test_a_lone_giant_message_is_refused_and_others_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("locfuse.formats.container.source.MAX_CHUNK", 1_200_000)
    said = drive(20)
    giant = Said(
        "/scan", "sensor_msgs/msg/LaserScan", cdr("sensor_msgs/msg/LaserScan", ranges=[1.0] * 400_000), T0
    )
    path = write(tmp_path / "x.mcap", [*said[:10], giant, *said[10:]], use_chunking=False)
    assert len(payloads(path)) == len(said)


def test_a_message_outside_chunks_has_no_checksum(tmp_path: Path) -> None:
    path = write(tmp_path / "x.mcap", drive(), enable_crcs=True)
    data = path.read_bytes()
    assert McapSource(FileBytes(path, Losses())).checked
    start = struct.unpack_from("<Q", data, len(data) - 8 - 20)[0]
    alone = struct.pack("<BQHIQQ", 5, 26, 1, 0, T0, T0) + bytes(4)
    front = data[: start - 13]  # without the record that ends the data
    path.write_bytes(
        front + alone + struct.pack("<BQI", 15, 4, 0) + struct.pack("<BQQQI", 2, 20, 0, 0, 0) + data[-8:]
    )
    assert not McapSource(FileBytes(path, Losses())).checked
