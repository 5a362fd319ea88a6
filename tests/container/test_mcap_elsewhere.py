"""A file that is elsewhere: its summary is believed where it fits together, and the bytes are held against it."""

import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from bags import Said, delivered, drive, write
from mcap.writer import CompressionType
from present import present
from range_server import Shelf, serving

from locfuse.formats.container.file_bytes import FileBytes, Losses, Url
from locfuse.formats.container.mcap_source import McapSource
from locfuse.formats.container.mcap_survey import ChunkRef, promised, read_summary, sort_by_time, summary_section
from locfuse.formats.container.remote_objects import RemoteBytes
from locfuse.formats.container.source import Part

NONE, ZSTD = CompressionType.NONE, CompressionType.ZSTD
SCHEMA, CHANNEL, CHUNK_INDEX, ATTACHMENT_INDEX, STATISTICS = 3, 4, 8, 10, 11  # https://mcap.dev/spec
Record = tuple[int, bytearray]


@pytest.fixture
def shelf() -> Iterator[Shelf]:
    with serving() as found:
        yield found


def opened(shelf: Shelf, path: Path) -> tuple[McapSource, RemoteBytes, Losses]:
    data = RemoteBytes(Url(shelf.put(path.name, path.read_bytes())), losses := Losses())
    return McapSource(data), data, losses


def payloads(source: McapSource, *topics: str) -> list[tuple[str, int, int, bytes]]:
    return sorted(delivered(source, *topics))


def said_of(said: list[Said], *topics: str) -> list[tuple[str, int, int, bytes]]:
    return sorted((m.topic, m.log_time, m.sequence, m.data) for m in said if m.topic in topics)


def stored(path: Path, said: list[Said], **options: Any) -> Path:
    return write(path, said, chunk_size=4000, **options)


def by_topic(n: int) -> list[Said]:
    """A drive's messages topic after topic, so that few chunks hold two of them."""
    return sorted(drive(n), key=lambda said: said.topic)


@pytest.mark.parametrize("compression", [NONE, ZSTD])
@pytest.mark.parametrize("topics", [("/heading",), ("/heading", "/scan"), ("/joint_states", "/heading", "/scan")])
def test_the_messages_are_those_that_were_written(
    tmp_path: Path, shelf: Shelf, compression: CompressionType, topics: tuple[str, ...]
) -> None:
    said = by_topic(4000)
    source, data, losses = opened(shelf, stored(tmp_path / "x.mcap", said, compression=compression))
    assert data.fetched < data.size / 4  # opened by its summary
    assert payloads(source, *topics) == said_of(said, *topics)
    assert data.far == (topics == ("/heading",))  # else they are most of the file
    assert (data.fetched < data.size / 2) == data.far
    payloads(source, *topics)
    assert shelf.sent == data.fetched  # a second walk finds all of it at hand
    assert not losses
    assert [c.n for c in source.channels.values()] == [2000, 4000, 1000]


def test_where_the_checksums_are_is_asked_of_the_first_chunk(tmp_path: Path, shelf: Shelf) -> None:
    for crcs in (True, False):
        path = stored(tmp_path / f"{crcs}.mcap", drive(60), enable_crcs=crcs)
        assert opened(shelf, path)[0].checked is crcs


def records(section: bytes) -> list[Record]:
    found, at = [], 0
    while at < len(section):
        opcode, length = struct.unpack_from("<BQ", section, at)
        found.append((opcode, bytearray(section[at + 9 : at + 9 + length])))
        at += 9 + length
    return found


def lying(path: Path, change: Callable[[list[Record]], None]) -> Path:
    """Rewrite the summary of a file; its checksum fits."""
    data = path.read_bytes()
    section = present(summary_section(FileBytes(path, Losses())))
    start = len(data) - 29 - 8 - len(section)
    change(said := records(section))
    new = b"".join(struct.pack("<BQ", opcode, len(content)) + content for opcode, content in said)
    footer = struct.pack("<BQQQ", 2, 20, start, 0)
    path.write_bytes(data[:start] + new + footer + struct.pack("<I", zlib.crc32(new + footer)) + data[-8:])
    return path


def put(opcode: int, layout: str, at: int, value: int, which: int = 0) -> Callable[[list[Record]], None]:
    """Set a number of the `which`-th record of a kind."""

    def change(said: list[Record]) -> None:
        struct.pack_into("<" + layout, [content for code, content in said if code == opcode][which], at, value)

    return change


def add(opcode: int, layout: str, at: int, more: int, which: int = 0) -> Callable[[list[Record]], None]:
    def change(said: list[Record]) -> None:
        content = [content for code, content in said if code == opcode][which]
        (old,) = struct.unpack_from("<" + layout, content, at)
        struct.pack_into("<" + layout, content, at, old + more)

    return change


def without(opcode: int, which: int = 0) -> Callable[[list[Record]], None]:
    def change(said: list[Record]) -> None:
        said.remove([one for one in said if one[0] == opcode][which])

    return change


def overlapping(said: list[Record]) -> None:
    """Put the second chunk, with its indexes, into the first one."""
    content = [content for code, content in said if code == CHUNK_INDEX][1]
    (size,) = struct.unpack_from("<I", content, 32)
    for at in (16, *range(MAP + 2, MAP + size, 10)):
        struct.pack_into("<Q", content, at, struct.unpack_from("<Q", content, at)[0] - 2000)


def nothing(said: list[Record]) -> None:
    """A summary that says all there is."""


# Of a ChunkIndex: first, last, offset, length (8 bytes each); size of the map (4); channel and offset of each
# index (10); length of all indexes (8); name of the compression (4 + n); packed and unpacked size (8 each).
MAP = 32 + 4
INDEX_LENGTH = MAP + 3 * 10  # of three channels
PACKED = INDEX_LENGTH + 8 + 4  # of a stored chunk


@pytest.mark.parametrize(
    ("change", "believed"),
    [
        (nothing, True),
        (without(STATISTICS), False),
        (without(CHUNK_INDEX), False),
        (without(CHANNEL), False),
        (without(SCHEMA), False),
        (without(ATTACHMENT_INDEX), False),
        (add(STATISTICS, "Q", 0, 1), False),  # all messages
        (add(STATISTICS, "I", 14, 1), False),  # attachments
        (add(STATISTICS, "I", 22, 1), False),  # chunks
        (add(STATISTICS, "Q", 48, 1), False),  # messages of the first channel
        (add(CHUNK_INDEX, "Q", 24, 1), False),  # length of the chunk
        (add(CHUNK_INDEX, "Q", 24, -1), False),
        (add(CHUNK_INDEX, "Q", 16, 1), False),  # where it begins
        (add(CHUNK_INDEX, "Q", INDEX_LENGTH, 1), False),
        (add(CHUNK_INDEX, "Q", INDEX_LENGTH, 16), False),  # as of one message more
        (add(CHUNK_INDEX, "Q", MAP + 2, 1), False),  # where its first index begins
        (add(CHUNK_INDEX, "Q", MAP + 2, -16), False),
        (add(CHUNK_INDEX, "Q", MAP + 12, 1), False),  # where its second one begins
        (add(CHUNK_INDEX, "Q", MAP + 12, 16), False),  # 16 bytes are a message: the counts are others
        (put(CHUNK_INDEX, "I", 32, 0), False),  # no indexes, and what follows is shifted
        (add(CHUNK_INDEX, "Q", PACKED, 1), False),
        (put(ATTACHMENT_INDEX, "Q", 8, 9), False),  # an attachment as long as the front of a record
        (put(ATTACHMENT_INDEX, "Q", 8, 10), True),
        (overlapping, False),
        (put(CHANNEL, "H", 2, 77), False),  # its schema
        (put(CHANNEL, "H", 2, 0), True),  # 0 = it has none
    ],
)
def test_a_summary_is_believed_where_all_it_says_fits_together(
    tmp_path: Path, change: Callable[[list[Record]], None], believed: bool
) -> None:
    path = stored(tmp_path / "x.mcap", drive(60), compression=NONE, attachments={"note": b"hello"})
    assert read_summary(FileBytes(lying(path, change), Losses())) is not None or change is not nothing
    assert (promised(FileBytes(path, Losses())) is not None) == believed


def test_the_indexes_of_a_chunk_take_the_bytes_behind_it_to_the_last(tmp_path: Path) -> None:
    path = stored(tmp_path / "x.mcap", drive(60), compression=NONE, attachments={"note": b"hello"})
    survey = present(promised(FileBytes(path, Losses())))
    content = path.read_bytes()
    for part in survey.parts:
        assert isinstance(part, ChunkRef)
        assert part.counts is not None
        for ident, (at, length) in part.index.items():
            assert content[at - 9] == 7
            assert struct.unpack_from("<QHI", content, at - 8) == (length, ident, length - 6)
            assert part.counts[ident] == (length - 6) // 16
    assert [content[at - 9 : at] for at, _ in survey.attachments] == [struct.pack("<BQ", 9, 55)]
    assert survey.attachments[0][1] == 55
    assert survey.expected == {1: 60, 2: 30, 3: 15}


def test_a_stored_chunk_as_large_as_can_be_held_is_read_by_the_summary_and_a_larger_one_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = drive(60)
    for compression in (NONE, ZSTD):
        path = stored(tmp_path / f"{compression}.mcap", said, compression=compression)
        summary = present(read_summary(FileBytes(path, Losses())))
        largest = max(chunk.packed for chunk in summary.chunks.values())
        for cap, believed in ((largest, True), (largest - 1, compression == ZSTD)):
            monkeypatch.setattr("locfuse.formats.container.mcap_survey.LARGE_CHUNK_BYTES", cap)
            assert (promised(FileBytes(path, Losses())) is not None) == believed


def damaged(path: Path, at: int, value: bytes) -> None:
    content = bytearray(path.read_bytes())
    content[at : at + len(value)] = value
    path.write_bytes(content)


def first_chunk(path: Path) -> ChunkRef:
    survey = present(promised(FileBytes(path, Losses())))
    return min((part for part in survey.parts if isinstance(part, ChunkRef)), key=lambda chunk: chunk.offset)


@pytest.mark.parametrize("field", ["opcode", "first", "last", "plain", "content"])
def test_a_chunk_that_is_not_what_the_summary_or_its_checksum_says_is_lost_and_the_others_are_read(
    tmp_path: Path, shelf: Shelf, field: str
) -> None:
    said = by_topic(400)
    path = stored(tmp_path / "x.mcap", said, compression=NONE)
    chunk = first_chunk(path)  # of /heading
    at = chunk.offset + {"opcode": 0, "first": 9, "last": 17, "plain": 25, "content": 100}[field]
    damaged(path, at, bytes([path.read_bytes()[at] ^ 1]))
    source, data, losses = opened(shelf, path)
    found = payloads(source, "/heading")
    assert data.far
    assert chunk.counts is not None
    lost = sum(chunk.counts.values())
    assert set(found) < set(said_of(said, "/heading"))
    assert len(found) == 200 - lost
    reason = "a chunk fails its checksum" if field == "content" else "a chunk is not what the summary says"
    assert [(reason, rows["messages"]) for reason, rows in losses.by_reason().items()] == [(reason, lost)]


def test_a_damaged_index_loses_no_message(tmp_path: Path, shelf: Shelf) -> None:
    said = by_topic(400)
    path = stored(tmp_path / "x.mcap", said, compression=NONE)
    ((at, _),) = first_chunk(path).index.values()
    damaged(path, at + 6 + 8, struct.pack("<Q", 2**63))  # the first message begins beyond all numbers
    source, data, losses = opened(shelf, path)
    assert payloads(source, "/heading") == said_of(said, "/heading")
    assert data.far
    assert not losses


@pytest.mark.parametrize(
    ("spans", "expected"),
    [
        ([(20, 29), (0, 9), (10, 19)], [1, 2, 0]),
        ([(10, 19), (0, 10)], [0, 1]),  # they touch: none ends before the other begins
        ([(0, 30), (5, 9), (6, 8)], [0, 1, 2]),  # they overlap
        ([(10, 19), (5, 12), (6, 8)], [2, 1, 0]),
        ([(40, 49), (0, 30), (10, 20)], [2, 1, 0]),  # by their ends
    ],
)
def test_parts_are_sorted_only_where_one_ends_before_an_earlier_one_begins(
    spans: list[tuple[int, int]], expected: list[int]
) -> None:
    sort_by_time(parts := [Part(0, 0, 0, span=one) for one in spans])
    assert [spans.index(part.span) for part in parts] == expected
