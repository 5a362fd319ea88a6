"""Damage for fuzzing: what a broken disk, a power cut, a bug or an attacker makes of bytes and settings."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from random import Random

HEAD = 9  # bytes of an MCAP record before its content: opcode, length
MAGIC = 8
NEAR_BYTES = 48  # how far behind the start of a record its fields lie
INTERESTING = (0, 1, 2, 0x7F, 0xFF, 0x7FFF, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
WHOLE_NUMBERS = tuple(
    struct.pack(f"<{c}", n % 256**s) for n in INTERESTING for s, c in ((2, "H"), (4, "I"), (8, "Q"))
)
NUMBERS = (float("nan"), float("inf"), float("-inf"), 0.0, -0.0, 1e308, -1e308, 1e-310, 1e30, -1e30, 1e9, -1.0)
VALUES = (
    "nan", "inf", "-inf", "0", "-1", "0.0", "1e308", "-1e308", "1e-308", "1e30", "9223372036854775807", "true",
    '""', '"text"', "[]", "[nan]", "[1, 2, 3]", "[[1, 2], [3]]", "{}", "2020-01-01", "1e400", '"\\u0000"', "'/x'",
)  # fmt: skip
TOML_WORDS = (
    b"\0",
    b'"',
    b"[",
    b"{",
    b"\n",
    "é😀".encode(),
    b"\xff\xfe",
    b"x = " + b"[" * 5000,
    b"\n[lrf]\nx = 1\n",
)


def record_starts(data: bytes) -> Iterator[int]:
    """Yield where the outermost records of a healthy .mcap begin."""
    at = MAGIC
    while at + HEAD <= len(data) - MAGIC:
        yield at
        at += HEAD + int(struct.unpack_from("<Q", data, at + 1)[0])


def span(rng: Random, n: int) -> slice:
    """Return some stretch of n places, short ones more often."""
    start = rng.randrange(n)
    return slice(start, min(n, start + 1 + int(n ** rng.random())))


def damaged(
    rng: Random,
    data: bytes,
    words: Sequence[bytes] = WHOLE_NUMBERS,
    others: Sequence[bytes] = (),
    starts: Sequence[int] = (),
) -> tuple[bytes, str]:
    """Return bytes with one change, and its name.

    Args:
        rng: decides what is changed.
        data: at least one byte.
        words: written over the bytes, or between them: numbers or words of the language.
        others: pieces of them are spliced in.
        starts: of records; half of the changes begin in their first bytes.
    """
    where = span(rng, len(data))
    at, end = where.start, where.stop
    if starts and rng.random() < 0.5:
        at = min(rng.choice(starts) + rng.randrange(NEAR_BYTES), len(data) - 1)
        end = max(end, at + 1)
    flipped = bytes([data[at] ^ 1 << rng.randrange(8)])
    word, other = rng.choice(words), rng.choice(others or (data,))
    name, piece, end = rng.choice(
        (
            ("flipped", flipped, at + 1),
            ("truncated", b"", len(data)),
            ("zeroed", bytes(end - at), end),
            ("garbled", rng.randbytes(end - at), end),
            ("cut out", b"", end),
            ("repeated", data[at:end] * rng.choice((2, 2, 30, 1000) if end - at < 1000 else (2,)), end),
            ("a word instead", word, at + len(word)),
            ("a word between", word, at),
            ("spliced", other[: rng.randrange(1, 400)], at),
        )
    )
    return data[:at] + piece + data[end:], name


def odd_toml(rng: Random, text: str) -> bytes:
    """Return a robot.toml with one to three changes: mostly of a value, else of the text."""
    data = text.encode()
    for _ in range(rng.choice((1, 1, 2, 3))):
        lines = data.split(b"\n")
        keys = [i for i, line in enumerate(lines) if b" = " in line]
        if keys and rng.random() < 0.75:
            i = rng.choice(keys)
            lines[i] = lines[i].split(b" = ")[0] + b" = " + rng.choice(VALUES).encode()
            data = b"\n".join(lines)
        elif data:
            data, _ = damaged(rng, data, TOML_WORDS)
    return data
