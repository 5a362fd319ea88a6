"""The walk over a file laid by hand: where it goes on after damage, and what it counts as lost."""

import struct
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from locfuse.formats.container.file_bytes import FileBytes, Losses
from locfuse.formats.container.mcap_source import McapSource
from locfuse.formats.container.mcap_survey import ChunkRef, Survey, read_summary, survey
from locfuse.fusion.data import LocfuseError

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT = range(1, 10)
ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(10, 16)


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def message(channel: int, log_time: int, payload: bytes) -> bytes:
    return record(MESSAGE, struct.pack("<HIQQ", channel, log_time % 1000, log_time, log_time) + payload)


START = MAGIC + record(HEADER, text("") + text(""))
SCHEMAS = record(SCHEMA, struct.pack("<H", 1) + text("pkg/A") + text("ros2msg") + text("int8 a"))
CHANNELS = b"".join(
    record(CHANNEL, struct.pack("<HH", i, 1) + text(f"/{i}") + text("cdr") + bytes(4)) for i in (1, 2)
)
END = record(DATA_END, bytes(4))
NO_SUMMARY = record(FOOTER, bytes(20)) + MAGIC
GARBAGE = b"\x00" + bytes(range(200, 231)) + b"\x00"


class Chunk(NamedTuple):
    """A stored chunk, of three messages of channel 1 and one of channel 2, with its indexes."""

    record: bytes
    indexes: tuple[bytes, ...]
    first: int
    channels: tuple[int, ...] = (1, 2)  # of the indexes

    @property
    def all(self) -> bytes:
        return self.record + b"".join(self.indexes)


def chunk(first: int, crc: bool = True, plain: bytes | None = None) -> Chunk:
    inside = [message(1 + i // 3, first + i, bytes([i]) * 40) for i in range(4)]
    data = b"".join(inside) if plain is None else plain
    places = np.cumsum([0, *map(len, inside)]).tolist()
    entries = [struct.pack("<QQ", first + i, places[i]) for i in range(4)]
    checksum = zlib.crc32(data) if crc else 0
    head = struct.pack("<QQQI", first, first + 3, len(data), checksum) + text("") + struct.pack("<Q", len(data))
    indexes = tuple(
        record(MESSAGE_INDEX, struct.pack("<HI", i, 16 * len(some)) + b"".join(some))
        for i, some in ((1, entries[:3]), (2, entries[3:]))
    )
    return Chunk(record(CHUNK, head + data), indexes, first)


A, B, C = chunk(100), chunk(200), chunk(300)


def summarised(data: bytes, chunks: list[Chunk], counted: bool = True) -> bytes:
    """Add a summary of these chunks, as they lie in the data, with definitions and counts."""
    content = SCHEMAS + CHANNELS
    n = len(chunks)
    if counted:
        counts = struct.pack("<IHQHQ", 20, 1, 3 * n, 2, n)
        content += record(STATISTICS, struct.pack("<QHIIIIQQ", 4 * n, 1, 2, 0, 0, n, 0, 0) + counts)
    for one in chunks:
        at = data.index(one.record)
        places, end = b"", at + len(one.record)
        for channel, index in zip(one.channels, one.indexes, strict=True):
            places, end = places + struct.pack("<HQ", channel, end), end + len(index)
        size, length = len(one.record) - 9 - 40, sum(map(len, one.indexes))
        front = struct.pack("<QQQQI", one.first, one.first + 3, at, len(one.record), len(places))
        content += record(
            CHUNK_INDEX, front + places + struct.pack("<Q", length) + text("") + struct.pack("<QQ", size, size)
        )
    footer = struct.pack("<BQQQ", FOOTER, 20, len(data), 0)
    return data + content + footer + struct.pack("<I", zlib.crc32(content + footer)) + MAGIC


Loss = tuple[str, int, int, int | None]  # reason, place, bytes, messages


def laid(folder: Path, content: bytes) -> tuple[FileBytes, Losses]:
    (folder / "f.mcap").write_bytes(content)
    return FileBytes(folder / "f.mcap", losses := Losses()), losses


def told(losses: Losses) -> list[Loss]:
    return [(reason, at, one.bytes, one.messages) for (_, reason, at), one in losses.places.items()]


def walked(folder: Path, content: bytes) -> tuple[Survey, list[Loss]]:
    """What the walk finds, and what it lost."""
    data, losses = laid(folder, content)
    return survey(data), told(losses)


def lost_by(folder: Path, content: bytes, wanted: set[int]) -> tuple[list[int], list[Loss]]:
    """The log times of some channels' messages in the order in which they come, and all losses."""
    data, losses = laid(folder, content)
    batches = McapSource(data).batches(wanted)
    found = [sorted(t for m in batch.messages.values() for t in m.log_time.tolist()) for batch in batches]
    return [t for some in found for t in some], told(losses)


def times(folder: Path, content: bytes) -> tuple[list[int], list[str]]:
    """The log times of all messages, and the reasons of losses."""
    found, lost = lost_by(folder, content, {1, 2})
    return found, [reason for reason, *_ in lost]


def of(*chunks: Chunk) -> list[int]:
    return [one.first + i for one in chunks for i in range(4)]


FRONT = START + SCHEMAS + CHANNELS
WHOLE = FRONT + A.all + B.all + C.all + END


def test_a_whole_file_is_walked_without_loss(tmp_path: Path) -> None:
    notes = record(ATTACHMENT, bytes(60)) + record(METADATA, bytes(8)) + record(0x80, b"own") + record(255, b"")
    data = FRONT + A.all + notes + B.all + END
    for content in (data + NO_SUMMARY, summarised(data, [A, B])):
        found, lost = walked(tmp_path, content)
        assert not lost
        parts = [part for part in found.parts if isinstance(part, ChunkRef)]
        assert len(parts) == len(found.parts)
        assert [part.offset for part in parts] == [data.index(A.record), data.index(B.record)]
        assert [(part.size, part.cut_off) for part in parts] == 2 * [(4 * 71, False)]
        assert found.attachments == [(data.index(notes) + 9, 60)]
        assert list(found.channels) == [1, 2]
        assert times(tmp_path, content) == (of(A, B), [])


def test_only_a_summary_that_confirms_the_indexes_lets_chunks_be_skipped(tmp_path: Path) -> None:
    assert [part.counts for part in walked(tmp_path, WHOLE + NO_SUMMARY)[0].parts] == [None] * 3
    confirmed = walked(tmp_path, summarised(WHOLE, [A, B, C]))[0]
    assert [part.counts for part in confirmed.parts] == [{1: 3, 2: 1}] * 3
    other = bytearray(summarised(WHOLE, [A, B, C]))
    other[WHOLE.index(A.indexes[1]) + 9] = 7  # an index of another channel than the summary says
    assert [part.counts for part in walked(tmp_path, bytes(other))[0].parts] == [None, *[{1: 3, 2: 1}] * 2]


NO_RECORD = "bytes that are no record"
CUT_OFF = "the file ends without an end mark: the recording was cut off"
HERE = len(FRONT + A.all)


def amid(middle: bytes) -> bytes:
    """A file with something between its two chunks."""
    return FRONT + A.all + middle + B.all + END + NO_SUMMARY


def longer(more: int) -> bytes:
    """A chunk whose two lengths, of the record and of its content, are too large."""
    long = bytearray(B.record)
    for at in (1, 9 + 32):
        struct.pack_into("<Q", long, at, struct.unpack_from("<Q", long, at)[0] + more)
    return bytes(long)


def changed(data: bytes, at: int, by: int) -> bytes:
    return data[:at] + bytes([data[at] + by]) + data[at + 1 :]


BEHIND = C.all + END + NO_SUMMARY
TWO = FRONT + A.all + B.all + END
AFTER = TWO.index(A.indexes[1])
INDEX_48, INDEX_40 = (struct.pack("<HI", 1, n) + bytes(size) for n, size in ((47, 48), (40, 40)))
DAMAGED = FRONT + A.all + GARBAGE + B.all + C.all + END
LAID: dict[str, tuple[bytes, list[Loss], list[int]]] = {
    "bytes that are no record": (DAMAGED + NO_SUMMARY, [(NO_RECORD, HERE, len(GARBAGE), None)], of(A, B, C)),
    "bytes that are no record beside a summary": (
        summarised(DAMAGED, [A, B, C]),
        [(NO_RECORD, HERE, len(GARBAGE), None)],
        of(A, B, C),
    ),
    "bytes that are no record before the end": (
        summarised(FRONT + A.all + GARBAGE + END, [A]),
        [(NO_RECORD, HERE, len(GARBAGE + END), None)],
        of(A),
    ),
    **{
        f"record {code} is none of the data": (
            amid(record(code, bytes(20))),
            [(NO_RECORD, HERE, 29, None)],
            of(A, B),
        )
        for code in (0, FOOTER, 16, 127)
    },
    **{
        f"record {code} is passed over": (amid(record(code, b"anything")), [], of(A, B))
        for code in (HEADER, METADATA, SUMMARY_OFFSET, 128, 255)
    },
    "an end mark amid chunks is a flipped bit": (
        summarised(FRONT + A.all + END + B.all + END, [A, B]),
        [(NO_RECORD, HERE, len(END), None)],
        of(A, B),
    ),
    "an end mark has four bytes": (
        amid(record(DATA_END, bytes(5))),
        [(NO_RECORD, HERE, len(END) + 1, None)],
        of(A, B),
    ),
    "a footer before the last magic is the end": (FRONT + A.all + NO_SUMMARY, [], of(A)),
    "a record is longer than the file": (
        amid(struct.pack("<BQ", METADATA, 1 << 40)),
        [("a record reaches beyond the end of the file", HERE, 9, None)],
        of(A, B),
    ),
    "a record ends with the file": (FRONT + A.all + record(METADATA, b"note"), [(CUT_OFF, 0, 0, None)], of(A)),
    "a chunk is longer than the file, and another follows": (
        FRONT + A.all + longer(10_000) + BEHIND,
        [("a chunk reaches beyond the end of the file", HERE, len(B.record), None)],
        of(A, C),
    ),
    "a chunk is longer than the file, and none follows": (
        FRONT + A.all + longer(10_000) + END + NO_SUMMARY,
        [(CUT_OFF, 0, 0, None)],
        of(A, B),
    ),
    **{
        f"byte {at} of a chunk contradicts the others": (
            FRONT + A.all + changed(B.record, at, 1) + BEHIND,
            [("a chunk header that contradicts itself", HERE, len(B.record), None)],
            of(A, C),
        )
        for at in (1, 41)
    },
    **{
        f"a message index of {len(index)} bytes contradicts itself": (
            FRONT + A.record + record(MESSAGE_INDEX, index) + B.all + END + NO_SUMMARY,
            [("a message index that contradicts itself", len(FRONT + A.record), 9 + len(index), None)],
            of(A, B),
        )
        for index in (INDEX_48, INDEX_40)
    },
    "what the index calls a chunk is none": (
        changed(summarised(WHOLE, [A, B, C]), HERE, METADATA - CHUNK),
        [("no chunk where the index promises one", HERE, len(B.all), None)],
        of(A, C),
    ),
    "behind a chunk stands no index": (
        changed(summarised(TWO, [A, B]), AFTER, METADATA - MESSAGE_INDEX),
        [("no message index where the chunk index promises one", AFTER, len(A.indexes[1]), None)],
        of(A, B),
    ),
    **{
        f"behind damage a chunk with another byte {at} is passed over": (
            FRONT + A.all + GARBAGE + changed(B.record, at, 1) + BEHIND,
            [(NO_RECORD, HERE, len(GARBAGE) + len(B.record), None)],
            of(A, C),
        )
        for at in (1, 9 + 32, 8, 9 + 28)
    },
    "behind damage a chunk that reaches beyond the file is passed over": (
        FRONT + A.all + GARBAGE + longer(len(BEHIND) + 1) + BEHIND,
        [(NO_RECORD, HERE, len(GARBAGE) + len(B.record), None)],
        of(A, C),
    ),
    "behind damage a chunk that ends with the file is what is left of it": (
        FRONT + A.all + GARBAGE + longer(len(BEHIND)) + BEHIND,
        [(NO_RECORD, HERE, len(GARBAGE), None), (CUT_OFF, 0, 0, None)],
        of(A),
    ),
}


@pytest.mark.parametrize("what", LAID)
def test_damage_ends_where_the_next_record_is_believed(tmp_path: Path, what: str) -> None:
    content, losses, kept = LAID[what]
    assert walked(tmp_path, content)[1] == losses
    assert times(tmp_path, content)[0] == kept


@pytest.mark.parametrize(("behind", "is_end"), [(b"", True), (b"\x00", False), (b"\x10", False), (b"\x0f", True)])
def test_without_a_summary_an_end_mark_is_one_that_a_record_or_nothing_follows(
    tmp_path: Path, behind: bytes, is_end: bool
) -> None:
    _, lost = walked(tmp_path, FRONT + A.all + END + behind)
    cut_off = any("without an end mark" in reason for reason, *_ in lost)
    assert cut_off is not is_end


def test_a_summary_that_is_damaged_is_counted_and_one_that_was_never_written_is_not(tmp_path: Path) -> None:
    content = bytearray(summarised(WHOLE, [A, B, C]))
    content[len(WHOLE) + 12] ^= 1
    found, lost = walked(tmp_path, bytes(content))
    assert lost == [
        (
            "the summary is damaged: messages may be missing, their number is unknown",
            len(WHOLE) - len(END),
            len(content) - len(WHOLE) + len(END),
            None,
        )
    ]
    assert len(found.parts) == 3
    assert walked(tmp_path, WHOLE + NO_SUMMARY)[1] == []
    for place in (-1, -9 - 20 - 8):  # the last magic, and the footer's opcode
        broken = bytearray(WHOLE + NO_SUMMARY)
        broken[place] ^= METADATA ^ FOOTER
        assert [reason for reason, *_ in walked(tmp_path, bytes(broken))[1]] == [lost[0][0]]


def test_messages_that_the_statistics_count_and_nobody_finds_are_lost(tmp_path: Path) -> None:
    content = bytearray(summarised(WHOLE, [A, B, C]))
    counts = struct.pack("<HQHQ", 1, 9, 2, 3)
    at = content.rindex(counts)
    for claimed, missing in ((9, 0), (14, 5), (8, 0)):
        struct.pack_into("<Q", content, at + 2, claimed)
        struct.pack_into("<I", content, len(content) - 12, 0)  # the summary is without a checksum
        data, losses = laid(tmp_path, bytes(content))
        McapSource(data)
        assert [(loss.reason, loss.messages) for loss in losses.places.values()] == (
            [("messages the file's statistics promise are missing", missing)] if missing else []
        )


def test_a_file_that_begins_otherwise_is_refused_unless_its_summary_is_whole(tmp_path: Path) -> None:
    content = bytearray(summarised(WHOLE, [A, B, C]))
    content[0] ^= 1
    assert times(tmp_path, bytes(content))[0] == of(A, B, C)
    with pytest.raises(LocfuseError, match="not an MCAP file: it is"):
        walked(tmp_path, bytes(content[:-1]))


@pytest.mark.parametrize("extra", [0, 1])
def test_an_uncompressed_chunk_up_to_the_cap_is_one_part_and_a_larger_one_is_walked_into(
    tmp_path: Path, extra: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = FRONT + A.all + END + NO_SUMMARY
    monkeypatch.setattr("locfuse.formats.container.mcap_survey.LARGE_CHUNK_BYTES", 4 * 71 - extra)
    found, lost = walked(tmp_path, content)
    assert (isinstance(found.parts[0], ChunkRef), lost) == (extra == 0, [])
    assert times(tmp_path, content)[0] == of(A)
    if extra:
        found, lost = walked(tmp_path, changed(content, len(FRONT) + 9 + 40 + 50, 1))
        assert (found.parts, lost) == ([], [("a chunk fails its checksum", len(FRONT) + 49, 4 * 71, None)])
    monkeypatch.undo()
    monkeypatch.setattr("locfuse.formats.container.source.MAX_CHUNK", 4 * 71 - extra)
    too_large = (["a chunk is larger than 0 MiB"]) * extra
    assert times(tmp_path, content) == (of(A) * (1 - extra), too_large)


def test_in_a_file_without_chunks_damage_ends_where_three_records_follow_each_other(tmp_path: Path) -> None:
    before = [message(1, t, b"p" * 10) for t in (1, 2, 3)]
    after = [message(2, t, b"q" * 20) for t in (4, 5, 6, 7)]
    data = FRONT + b"".join(before) + GARBAGE + b"".join(after) + END + NO_SUMMARY
    _, lost = walked(tmp_path, data)
    at = data.index(GARBAGE)
    # the message before the damage may be part of it
    assert lost == [("bytes that are no record", at - len(before[-1]), len(before[-1]) + len(GARBAGE), None)]
    assert times(tmp_path, data)[0] == [1, 2, 4, 5, 6, 7]
    stranger = record(MESSAGE, struct.pack("<HIQQ", 9, 0, 0, 0)) * 3  # of a channel nobody defined
    data = FRONT + b"".join(before) + GARBAGE + stranger + b"".join(after) + END + NO_SUMMARY
    assert times(tmp_path, data)[0] == [1, 2, 4, 5, 6, 7]


BEYOND_THE_END = struct.pack("<BQH", MESSAGE, 1 << 20, 1)


@pytest.mark.parametrize("behind", [bytes(9), struct.pack("<BQ", DATA_END + 1, 0), BEYOND_THE_END])
def test_bytes_that_look_like_two_messages_are_none_if_no_record_follows(tmp_path: Path, behind: bytes) -> None:
    before, after = (b"".join(message(1, t, b"p" * 10) for t in some) for some in ((1, 2, 3), (4, 5, 6, 7)))
    data = FRONT + before + GARBAGE + message(1, 99, b"") * 2 + behind + after + END + NO_SUMMARY
    assert times(tmp_path, data)[0] == [1, 2, 4, 5, 6, 7]


@pytest.mark.parametrize("n", [1, 2, 3])
def test_damage_may_end_at_the_last_messages_before_the_end(tmp_path: Path, n: int) -> None:
    """Three records in a row, or fewer and the end mark."""
    first = b"".join(message(1, t, b"p" * 10) for t in (1, 2))
    rest = b"".join(message(2, t, b"") for t in range(10, 10 + n))
    assert times(tmp_path, FRONT + first + GARBAGE + rest + END + NO_SUMMARY)[0] == [1, *range(10, 10 + n)]
    cut_off = times(tmp_path, FRONT + first + GARBAGE + rest)[0]
    assert cut_off == ([1, 10, 11, 12] if n == 3 else [1])


def test_places_are_found_in_every_window_of_a_long_hole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next chunk may lie in the first window that is searched, in a later one, and across two."""
    for size in range(40, 140):
        monkeypatch.setattr("locfuse.formats.container.mcap_survey.SEARCH_BYTES", size)
        data = FRONT + A.all + GARBAGE * 3 + B.all + GARBAGE + C.all + END + NO_SUMMARY
        found, lost = walked(tmp_path, data)
        assert [part.offset for part in found.parts] == [data.index(one.record) for one in (A, B, C)]
        assert [n_bytes for _, _, n_bytes, _ in lost] == [3 * len(GARBAGE), len(GARBAGE)]


# --- what a source gives of such files


def other_channel(first: int, indexed: bool) -> Chunk:
    """A chunk of two messages of channel 2, perhaps with its index."""
    inside = [message(2, first + i, b"x") for i in range(2)]
    data = b"".join(inside)
    head = struct.pack("<QQQI", first, first + 1, len(data), zlib.crc32(data)) + text("")
    entries = struct.pack("<4Q", first, 0, first + 1, len(inside[0]))
    index = record(MESSAGE_INDEX, struct.pack("<HI", 2, 32) + entries)
    indexes, channels = ((index,), (2,)) if indexed else ((), ())
    return Chunk(record(CHUNK, head + struct.pack("<Q", len(data)) + data), indexes, first, channels)


@pytest.mark.parametrize("summary", [True, False])
def test_damage_in_a_chunk_loses_it_by_its_checksum_and_without_one_what_lies_in_the_damage(
    tmp_path: Path, summary: bool
) -> None:
    loose = chunk(200, crc=False)
    for middle, at, there, loss in (
        (B, 9 + 40 + 35, [], ("a chunk fails its checksum", 4)),
        (loose, 49 + 71, [202, 203], ("a chunk holds bytes that are no record", 2)),  # the second message's opcode
    ):
        data = FRONT + A.all + middle.all + C.all + END
        content = bytearray(summarised(data, [A, middle, C]) if summary else data + NO_SUMMARY)
        place = data.index(middle.record)
        content[place + at] = 0 if middle is loose else content[place + at] ^ 1
        found, lost = lost_by(tmp_path, bytes(content), {1, 2})
        assert found == [*of(A), *there, *of(C)]
        assert lost == [(loss[0], place, 4 * 71, loss[1] if summary else None)]


def test_a_chunk_that_holds_nothing_wanted_is_not_opened(tmp_path: Path) -> None:
    """So that damage to it is nobody's loss; where nothing says what it holds it is opened."""
    for indexed in (True, False):
        other = other_channel(200, indexed)
        data = FRONT + A.all + other.all + END
        content = bytearray(summarised(data, [A, other], counted=False))
        content[data.index(other.record) + 60] ^= 1
        found, lost = lost_by(tmp_path, bytes(content), {1})
        assert found == of(A)[:3]
        assert [reason for reason, *_ in lost] == ([] if indexed else ["a chunk fails its checksum"])


def test_messages_of_a_channel_that_nobody_defines_are_counted(tmp_path: Path) -> None:
    alone = CHANNELS[: len(CHANNELS) // 2]
    found, lost = lost_by(tmp_path, START + SCHEMAS + alone + A.all + B.all + END + NO_SUMMARY, {1})
    assert found == [t for t in of(A, B) if t % 100 < 3]
    assert lost == [("messages of an undefined channel", 2, 0, 2)]


@pytest.mark.parametrize(("length", "found"), [(40, True), (41, False)])
def test_attachments_have_a_cap(tmp_path: Path, length: int, found: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("locfuse.formats.container.mcap_source.MAX_ATTACHMENT", 40)
    front = struct.pack("<QQ", 1, 1) + text("a") + text("t")
    front += struct.pack("<Q", length - len(front) - 8 - 4)
    content = front + bytes(length - len(front) - 4)
    for crc in (zlib.crc32(content), 0, 1):
        attached = record(ATTACHMENT, content + struct.pack("<I", crc))
        assert len(attached) == 9 + length
        data, losses = laid(tmp_path, FRONT + attached + A.all + END + NO_SUMMARY)
        source = McapSource(data)
        assert list(source.attachments) == (["a"] if found and crc != 1 else [])
        assert [(r, at, one.bytes) for (_, r, at), one in losses.places.items()] == (
            [("attachment 'a' fails its checksum", len(FRONT) + 9, length)] if found and crc == 1 else []
        )


def test_when_a_message_was_published_stands_before_its_payload(tmp_path: Path) -> None:
    one = record(MESSAGE, struct.pack("<HIQQ", 1, 0, 500, 77) + b"x")
    data, _ = laid(tmp_path, FRONT + one + message(1, 501, b"") + END + NO_SUMMARY)
    source = McapSource(data)
    (batch,) = source.batches({1})
    assert batch.messages[1].published.tolist() == [77, 501]
    assert source.time_span_ns == (500, 501)


def test_messages_outside_chunks_are_taken_in_runs_with_their_times(tmp_path: Path) -> None:
    loose = message(1, 50, b"a") + message(2, 40, b"bc") + message(1, 60, b"")
    found, lost = walked(tmp_path, FRONT + loose + A.all + message(2, 210, b"z") + END + NO_SUMMARY)
    assert not lost
    assert [
        (part.offset, part.size, part.counts, part.span) for part in found.parts if not isinstance(part, ChunkRef)
    ] == [(len(FRONT), len(loose), {1: 2, 2: 1}, (40, 60)), (len(FRONT + loose + A.all), 32, {2: 1}, (210, 210))]
    assert sorted(times(tmp_path, FRONT + loose + A.all + END + NO_SUMMARY)[0]) == [40, 50, 60, *of(A)]


def test_a_summary_section_may_be_as_short_as_nothing(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    for start, whole in ((len(WHOLE), True), (len(WHOLE) + 1, False), (8, False), (7, False)):
        footer = struct.pack("<BQQQ", FOOTER, 20, start, 0)
        content = WHOLE + footer + struct.pack("<I", zlib.crc32(footer)) + MAGIC
        path.write_bytes(content)
        assert (read_summary(FileBytes(path, Losses())) is not None) == whole
