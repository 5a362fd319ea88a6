"""Damage for fuzzing: bytes and records of an MCAP file, the messages in it, the text of a robot.toml.

Every function takes a random.Random and returns what a broken disk, a lost power supply, a bug or an enemy could
have made of its input. The structure is known here (records, lengths, stamps, numbers), so that damage reaches
deep into a reader instead of failing at the door.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from random import Random
from typing import NamedTuple

HEAD = 9  # bytes of an MCAP record before its content: opcode, length
MAGIC = 8
INTERESTING = (0, 1, 2, 0x7F, 0xFF, 0x7FFF, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
NUMBERS = (float("nan"), float("inf"), float("-inf"), 0.0, -0.0, 1e308, -1e308, 1e-310, 1e30, -1e30, 1e9, -1.0)
VALUES = (
    *("nan", "inf", "-inf", "0", "-1", "0.0", "1e308", "-1e308", "1e-308", "1e30", "9223372036854775807", "true"),
    *(
        '""',
        '"text"',
        "[]",
        "[nan]",
        "[1, 2, 3]",
        "[[1, 2], [3]]",
        "{}",
        "2020-01-01",
        "1e400",
        '"\\u0000"',
        "'/x'",
    ),
)


class Record(NamedTuple):
    """An outermost record of an MCAP file."""

    start: int
    stop: int


def records(data: bytes) -> Iterator[Record]:
    """Yield the outermost records of a healthy file."""
    at = MAGIC
    while at + HEAD <= len(data) - MAGIC:
        stop = at + HEAD + int(struct.unpack_from("<Q", data, at + 1)[0])
        yield Record(at, stop)
        at = stop


def span(rng: Random, n: int) -> slice:
    """Return some stretch of n places, short ones more often."""
    start = rng.randrange(n)
    return slice(start, min(n, start + 1 + int(n ** rng.random())))


def flipped(rng: Random, data: bytes) -> bytes:
    """Flip some bits."""
    bad = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 10))):
        bad[rng.randrange(len(bad))] ^= 1 << rng.randrange(8)
    return bytes(bad)


def truncated(rng: Random, data: bytes) -> bytes:
    """End too early."""
    return data[: rng.randrange(len(data))]


def zeroed(rng: Random, data: bytes) -> bytes:
    """Lose some sectors."""
    where = span(rng, len(data))
    return data[: where.start] + bytes(where.stop - where.start) + data[where.stop :]


def garbled(rng: Random, data: bytes) -> bytes:
    """Overwrite a stretch with noise."""
    where = span(rng, len(data))
    return data[: where.start] + rng.randbytes(where.stop - where.start) + data[where.stop :]


def cut_out(rng: Random, data: bytes) -> bytes:
    """Lose a stretch and close the gap."""
    where = span(rng, len(data))
    return data[: where.start] + data[where.stop :]


def repeated(rng: Random, data: bytes) -> bytes:
    """Write a stretch twice."""
    where = span(rng, len(data))
    return data[: where.stop] + data[where] + data[where.stop :]


def wrong_length(rng: Random, data: bytes) -> bytes:
    """Let a record claim another length."""
    record = rng.choice(list(records(data)))
    length = rng.choice((*INTERESTING, record.stop - record.start + rng.randrange(-20, 20))) % 2**64
    return data[: record.start + 1] + struct.pack("<Q", length) + data[record.start + HEAD :]


def wrong_opcode(rng: Random, data: bytes) -> bytes:
    """Let a record be of another kind."""
    record = rng.choice(list(records(data)))
    return data[: record.start] + bytes([rng.randrange(256)]) + data[record.start + 1 :]


def wrong_number(rng: Random, data: bytes) -> bytes:
    """Overwrite 2, 4 or 8 bytes near a record's start with a telling integer."""
    record = rng.choice(list(records(data)))
    size, code = rng.choice(((2, "<H"), (4, "<I"), (8, "<Q")))
    at = min(record.start + HEAD + rng.randrange(48), len(data) - size)
    return data[:at] + struct.pack(code, rng.choice(INTERESTING) % 256**size) + data[at + size :]


def shuffled_records(rng: Random, data: bytes) -> bytes:
    """Remove, repeat or exchange records."""
    parts = [data[r.start : r.stop] for r in records(data)]
    i, j = rng.randrange(len(parts)), rng.randrange(len(parts))
    deed = rng.randrange(3)
    if deed == 0:
        del parts[i]
    elif deed == 1:
        parts.insert(j, parts[i])
    else:
        parts[i], parts[j] = parts[j], parts[i]
    return data[:MAGIC] + b"".join(parts) + data[-MAGIC:]


ANY_FILE: tuple[Callable[[Random, bytes], bytes], ...] = (flipped, truncated, zeroed, garbled, cut_out, repeated)
MCAP = (*ANY_FILE, wrong_length, wrong_opcode, wrong_number, shuffled_records)


def odd_text(rng: Random, text: str) -> str:
    """Change a text line by line or letter by letter."""
    lines = text.split("\n")
    i = rng.randrange(len(lines))
    deed = rng.randrange(5)
    if deed == 0:
        del lines[i]
    elif deed == 1:
        lines.insert(rng.randrange(len(lines)), lines[i])
    elif deed == 2:
        lines[i] = lines[i][: rng.randrange(len(lines[i]) + 1)]
    elif deed == 3:
        letter = chr(rng.choice((0, 10, 34, 91, 123, 0xE9, 0x1F600)))
        lines[i] = lines[i].replace(rng.choice(lines[i] or " "), letter, 1)
    else:
        lines[i] = rng.choice(lines)
    return "\n".join(lines)


def odd_toml(rng: Random, text: str) -> bytes:
    """Change a robot.toml: mostly values of keys that exist, else letters."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        lines = text.split("\n")
        keys = [i for i, line in enumerate(lines) if " = " in line]
        if keys and rng.random() < 0.75:
            i = rng.choice(keys)
            lines[i] = f"{lines[i].split(' = ')[0]} = {rng.choice(VALUES)}"
            text = "\n".join(lines)
        else:
            text = odd_text(rng, text)
    data = text.encode(errors="replace")
    if rng.random() < 0.05:
        data += rng.choice((b"\xff\xfe", b"x = " + b"[" * 5000, b"\n[lrf]\nnonsense = 1\n", b"\0" * 100))
    return data
