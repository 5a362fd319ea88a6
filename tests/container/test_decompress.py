"""Decompression gives what was packed, its true beginning, or one reason; held to the libraries that packed it."""

from __future__ import annotations

import bz2
import random
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard

from locfuse.formats.caps import MAX_CHUNK
from locfuse.formats.container import decompress as unpacking
from locfuse.formats.container.decompress import DamagedError, decompress, decompress_prefix, unpack, unpack_file
from locfuse.formats.container.file_bytes import FileBytes
from locfuse.formats.container.losses import Losses
from locfuse.formats.container.source import Messages
from locfuse.fusion.data import LocfuseError

NOISE = random.Random(1).randbytes(300_000)  # several blocks of every codec
PACK: dict[str, Callable[[bytes], bytes]] = {
    "zstd": zstandard.compress,
    "lz4": lambda data: lz4.frame.compress(data, content_checksum=True),
    "bz2": bz2.compress,
    "": lambda data: data,
}
NO_SIZE = zstandard.ZstdCompressor(write_content_size=False)


@pytest.mark.parametrize("codec", PACK)
@pytest.mark.parametrize("plain", [b"", b"a", bytes(100_000), NOISE], ids=["nothing", "a byte", "zeros", "noise"])
def test_what_was_packed_comes_out(codec: str, plain: bytes) -> None:
    assert decompress(PACK[codec](plain), codec, len(plain)) == plain
    assert decompress_prefix(PACK[codec](plain), codec, len(plain)) == plain


def test_two_frames_and_a_frame_that_does_not_say_its_size_are_read() -> None:
    assert decompress(zstandard.compress(b"a") + zstandard.compress(b"b"), "zstd", 2) == b"ab"
    assert decompress(NO_SIZE.compress(NOISE), "zstd", len(NOISE)) == NOISE


@pytest.mark.parametrize("codec", PACK)
@pytest.mark.parametrize("wrong", [-1, 1])
def test_another_size_than_declared_is_damage(codec: str, wrong: int) -> None:
    with pytest.raises(DamagedError, match="size is not the declared one"):
        decompress(PACK[codec](b"abc"), codec, 3 + wrong)


def test_a_claim_beyond_the_cap_is_refused_before_a_byte_is_made() -> None:
    with pytest.raises(DamagedError, match="more than 256 MiB"):
        decompress(zstandard.compress(b"a"), "zstd", MAX_CHUNK + 1)


@pytest.mark.parametrize("read", [decompress, decompress_prefix])
def test_an_unknown_codec_is_named(read: Callable[[bytes, str, int], bytes]) -> None:
    with pytest.raises(DamagedError, match=r"unknown compression 'brotli\\x1b"):
        read(b"a", "brotli\x1b[2J" + "x" * 90, 1)


@pytest.mark.parametrize("codec", ["zstd", "lz4", "bz2"])
def test_noise_is_damage_of_its_codec(codec: str) -> None:
    with pytest.raises(DamagedError, match=f"does not decompress \\({codec}\\)"):
        decompress(b"no frame at all", codec, 9)


@pytest.mark.parametrize("codec", ["zstd", "lz4"])
def test_of_a_cut_off_stream_the_true_beginning_is_kept(codec: str) -> None:
    packed = PACK[codec](NOISE)
    for share in (0.0, 0.01, 0.5, 0.9, 1.0):
        found = decompress_prefix(packed[: int(share * len(packed))], codec, len(NOISE))
        assert NOISE.startswith(found)
        assert len(found) >= int(share * len(packed)) - (1 << 18)  # but for the last block
    assert decompress_prefix(packed[:-9] + b"\xff" * 9, codec, len(NOISE))[:1000] == NOISE[:1000]
    assert decompress_prefix(b"no frame at all", codec, 100) == b""
    assert decompress_prefix(packed, codec, 70_000) == NOISE[:70_000]


def messages(*contents: bytes) -> tuple[np.ndarray, Messages]:
    length = np.array([len(one) for one in contents], np.int64)
    times = np.arange(len(contents), dtype=np.int64)
    found = Messages(np.cumsum(length) - length, length, times, times, times)
    return np.frombuffer(b"".join(contents), np.uint8), found


def unpacked(*contents: bytes) -> list[list[tuple[int, bytes]]]:
    return [
        [
            (int(t), data[a : a + n].tobytes())
            for t, a, n in zip(found.log_time, found.start, found.length, strict=True)
        ]
        for data, found in unpack(*messages(*contents))
    ]


def test_messages_that_were_packed_one_by_one_come_out_in_portions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unpacking, "MAX_PORTION_BYTES", 250)
    plain = [bytes([i]) * 100 for i in range(7)]
    found = unpacked(*map(zstandard.compress, plain))
    assert [entry for portion in found for entry in portion] == list(enumerate(plain))
    assert [len(portion) for portion in found] == [3, 3, 1]


def test_messages_that_are_not_packed_are_handed_on_untouched() -> None:
    data, found = messages(b"abcdef", b"x")
    ((same, others),) = unpack(data, found)
    assert same is data
    assert others is found


def test_a_message_that_does_not_unpack_or_is_too_long_comes_out_empty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unpacking, "MAX_MESSAGE", 1000)
    packed = zstandard.compress(NOISE[:900])
    bad = (packed[:9] + b"\xff" * 90, zstandard.compress(bytes(1001)), packed[:-1], packed[:500])
    found = unpacked(b"plain", packed, *bad)
    assert found == [[(0, b"plain"), (1, NOISE[:900]), *((i, b"") for i in (2, 3, 4, 5))]]


def plain(file: Path, losses: Losses) -> bytes:
    unpack_file(unpacked_file := FileBytes(file, losses))  # its bytes go with it
    return unpacked_file.where.read_bytes()


SKIPPED = b"\x50\x2a\x4d\x18\x05\0\0\0abcde"  # a frame that says nothing
WHOLE = {
    "says its size": zstandard.compress(NOISE),
    "does not say its size": NO_SIZE.compress(NOISE),
    "has a checksum": zstandard.ZstdCompressor(write_checksum=True, write_content_size=False).compress(NOISE),
    "repeats": NO_SIZE.compress(bytes(300_000)),
    "two frames": NO_SIZE.compress(NOISE) + SKIPPED + zstandard.compress(NOISE[:70_000]),
}


@pytest.mark.parametrize("kind", WHOLE)
def test_wherever_a_file_is_cut_off_that_is_noticed(tmp_path: Path, kind: str) -> None:
    file, packed = tmp_path / "a.mcap.zstd", WHOLE[kind]
    file.write_bytes(packed)
    losses = Losses()
    whole = plain(file, losses)
    assert whole == zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True).read()
    assert not losses
    for missing in (1, 2, 3, 5, 1000, len(packed) // 2):
        if len(packed) - missing < 20 or (kind == "two frames" and missing > 80_000):
            continue
        file.write_bytes(packed[:-missing])
        beginning = plain(file, losses := Losses())
        assert losses.bytes == (len(whole) - len(beginning) if kind == "says its size" else 0)
        assert losses, missing
        assert whole.startswith(beginning)


def test_a_file_that_is_damaged_from_the_beginning_says_so(tmp_path: Path) -> None:
    file = tmp_path / "a.mcap.zstd"
    file.write_bytes(b"\x28\xb5\x2f\xfd" + b"\xff" * 40)
    with pytest.raises(LocfuseError, match="damaged from the beginning"):
        unpack_file(FileBytes(file, Losses()))


def test_a_full_disk_of_temporary_files_is_one_line_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    file = tmp_path / "a.mcap.zstd"
    file.write_bytes(zstandard.compress(NOISE))

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(unpacking, "_unpack", full)
    with pytest.raises(LocfuseError, match=r"cannot be unpacked to .*: No space left on device"):
        unpack_file(FileBytes(file, Losses()))
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.zstd"]
