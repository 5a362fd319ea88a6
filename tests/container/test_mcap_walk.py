"""Damaged files: everything outside the damage is read, and what is lost is counted."""

from __future__ import annotations

import random
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import LIGHT, T0, Said, cdr, drive, real_log, write
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType

from locfuse.formats.container.decompress import decompress
from locfuse.formats.container.file_bytes import FileBytes
from locfuse.formats.container.losses import Losses
from locfuse.formats.container.mcap_records import scan
from locfuse.formats.container.mcap_source import McapSource
from locfuse.formats.logs.log import Log, open_log
from locfuse.fusion.data import LocfuseError

PLAIN: dict[str, Any] = {"enable_crcs": False, "chunk_size": 4000}


def payloads(path: Path) -> list[tuple[str, int, bytes]]:
    """(topic, log time, bytes) of every message the source delivers."""
    source = McapSource(FileBytes(path, Losses()))
    return [
        (
            source.channels[ident].topic,
            int(m.log_time[i]),
            batch.data[m.start[i] : m.start[i] + m.length[i]].tobytes(),
        )
        for batch in source.batches(source.channels.keys())
        for ident, m in batch.messages.items()
        for i in range(len(m.start))
    ]


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


def test_chunks_that_stand_in_any_order_come_in_that_of_their_times(tmp_path: Path) -> None:
    said = drive(60)
    shuffled = [said[i] for i in np.random.default_rng(1).permutation(len(said))]
    found = payloads(write(tmp_path / "x.mcap", shuffled, chunk_size=1))
    assert [t for _, t, _ in found] == sorted(m.log_time for m in said)
    assert sorted(found) == whole(said)


def test_the_order_of_the_file_is_kept_where_log_times_jitter(tmp_path: Path) -> None:
    """Every tenth message was written 0.3 s before its neighbours; chunks overlap, and none is moved."""
    said = [m._replace(log_time=m.log_time - 300_000_000 * (i % 10 == 9)) for i, m in enumerate(drive(60))]
    path = write(tmp_path / "x.mcap", said, chunk_size=3000)
    found = [t for topic, t, _ in payloads(path) if topic == "/scan"]
    assert found == [m.log_time for m in said if m.topic == "/scan"]
    assert found != sorted(found)


@pytest.mark.parametrize("layout", [PLAIN, {"use_chunking": False}, {"chunk_size": 4000}])
def test_a_truncated_file_gives_every_message_that_is_wholly_there(tmp_path: Path, layout: dict[str, Any]) -> None:
    said = drive(40)
    content = write(tmp_path / "whole.mcap", said, **layout).read_bytes()
    ends = {content.index(m.data) + len(m.data): (m.topic, m.log_time, m.data) for m in said}
    path = tmp_path / "cut.mcap"
    for cut in range(300, len(content), 173):
        path.write_bytes(content[:cut])
        there = sorted(message for end, message in ends.items() if end <= cut)
        assert sorted(payloads(path)) == there, cut
        assert losses_of(path) or len(there) == len(said)


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_truncated_compressed_file_gives_all_whole_chunks_at_least(
    tmp_path: Path, compression: CompressionType
) -> None:
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
    "layout", [{"chunk_size": 3000}, {"chunk_size": 3000, "compression": CompressionType.ZSTD}]
)
def test_a_flipped_bit_is_noticed_or_without_effect_where_the_file_has_checksums(
    tmp_path: Path, layout: dict[str, Any]
) -> None:
    said = drive(40)
    content = write(tmp_path / "whole.mcap", said, **layout).read_bytes()
    original = set(whole(said))
    rng = random.Random(0)
    path = tmp_path / "bad.mcap"
    n_lossy = 0
    for _ in range(60):
        bad = bytearray(content)
        bad[rng.randrange(len(bad))] ^= 1 << rng.randrange(8)
        path.write_bytes(bad)
        log = opened(path)
        if log is None:
            continue
        found = read_everything(log)
        assert found <= original
        assert found == original or log.losses
        n_lossy += bool(log.losses)
    assert n_lossy > 12


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


def test_flipped_bits_without_checksums_never_raise_and_never_lose_more_than_a_chunk_in_silence(
    tmp_path: Path,
) -> None:
    said = drive(40)
    content = write(tmp_path / "whole.mcap", said, **PLAIN).read_bytes()
    rng = random.Random(1)
    path = tmp_path / "bad.mcap"
    for _ in range(60):
        bad = bytearray(content)
        for _ in range(rng.choice([1, 1, 3])):
            bad[rng.randrange(8, len(bad))] ^= 1 << rng.randrange(8)
        path.write_bytes(bad)
        log = opened(path)
        if log is None:
            continue
        found = read_everything(log)
        assert len(found) >= len(said) - 3 or log.losses


@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize("layout", [PLAIN, {"chunk_size": 4000}, {"use_chunking": False}])
def test_a_hole_loses_what_lies_in_it_and_nothing_behind(
    tmp_path: Path, layout: dict[str, Any], summary: bool
) -> None:
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


def test_a_file_of_loose_messages_that_is_cut_in_its_end_keeps_every_message(tmp_path: Path) -> None:
    """Cut anywhere from behind the last message on, within the data section's own checksum too."""
    said = drive(4)
    path = write(tmp_path / "x.mcap", said, use_chunking=False, enable_data_crcs=True)
    content = path.read_bytes()
    behind = content.index(said[-1].data) + len(said[-1].data)
    for end in range(behind, min(behind + 40, len(content))):
        path.write_bytes(content[:end])
        assert whole(said) == sorted(payloads(path)), end


def test_a_lone_giant_message_is_refused_and_the_others_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("locfuse.formats.container.chunked.MAX_CHUNK", 1_200_000)
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
