"""The journal (-wal) of a sqlite database: what sqlite uses of it, and what sqlite ignores silently.

A recorder that dies leaves its last messages in the journal. sqlite reads it up to the last commit before the
first frame whose checksum is wrong, and calls that normal. The frames behind that place bear the salts of the
journal's header, so that they can be told from those of an older journal.
Format: https://sqlite.org/fileformat2.html#walformat
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

HEADER = struct.Struct(">8I")  # magic, version, page size, sequence, two salts, two checksums
FRAME = struct.Struct(">6I")  # page number, database size after a commit (0: none), two salts, two checksums
BYTE_ORDER = {0x377F0682: "<", 0x377F0683: ">"}  # of the words that are summed, by the magic number
TOGETHER = 1 << 22  # bytes read at once
WORD = 0xFFFFFFFF
DAMAGED = "its journal (-wal) is damaged: what was committed behind that place is lost"
UNFINISHED = "its journal (-wal) ends in a transaction that was not finished"

Pair = tuple[int, int]


class Tail(NamedTuple):
    """The end of a journal that sqlite does not use."""

    reason: str
    offset: int  # where it begins
    bytes: int


class Journal(NamedTuple):
    """What sqlite makes of a journal."""

    used: bool  # whether it holds a commit that sqlite reads
    tail: Tail | None  # what sqlite leaves out although it was written


class _Frame(NamedTuple):
    salts: Pair
    commits: bool
    share: Pair  # what its words add to the running checksum
    checksum: Pair  # the running checksum as written


def journal_of(path: Path) -> Journal:
    """Return whether sqlite uses a journal, and what it leaves out."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEADER.size)
        summed = _header(head)
        if summed is None:
            return Journal(used=False, tail=Tail(DAMAGED, 0, size))
        page, salts = HEADER.unpack(head)[2], HEADER.unpack(head)[4:6]
        weights = _Weights(8 + page)
        at = used = last = HEADER.size
        whole, state = True, summed
        for frame in _frames(file, page, weights, _order(head)):
            if whole:
                state = weights.after(state, frame.share)
                whole = frame.salts == salts and frame.checksum == state
            at += FRAME.size + page
            if frame.salts == salts:
                last = at
            if whole and frame.commits:
                used = at
        file.seek(at)
        if file.read(FRAME.size)[8:16] == struct.pack(">2I", *salts):  # cut off inside a frame
            whole, last = False, size
    tail = Tail(UNFINISHED if whole else DAMAGED, used, last - used) if last > used else None
    return Journal(used > HEADER.size, tail)


def _header(head: bytes) -> Pair | None:
    """Return the checksum that a journal's header ends with; None where it is no header."""
    if len(head) < HEADER.size:
        return None
    magic, _, page, *_, first, second = HEADER.unpack(head)
    if magic not in BYTE_ORDER or not 512 <= page <= 65536 or page & (page - 1):
        return None
    weights = _Weights(24)
    words = np.frombuffer(head, f"{_order(head)}u4", 6)[None]
    found = weights.after((0, 0), weights.shares(words)[0])
    return found if found == (first, second) else None


def _order(head: bytes) -> str:
    return BYTE_ORDER[HEADER.unpack(head)[0]]


def _frames(file: BinaryIO, page: int, weights: _Weights, order: str) -> Iterator[_Frame]:
    """Yield the whole frames of a journal, whatever their checksums."""
    length = FRAME.size + page
    while whole := len(data := file.read(TOGETHER // length * length)) // length:
        rows = np.frombuffer(data, np.uint8, whole * length).reshape(whole, length)
        summed = np.concatenate((rows[:, :8], rows[:, FRAME.size :]), axis=1)
        for row, share in zip(rows, weights.shares(summed.view(f"{order}u4")), strict=True):
            _, size, salt_1, salt_2, sum_1, sum_2 = FRAME.unpack_from(row.data)
            yield _Frame((salt_1, salt_2), size > 0, share, (sum_1, sum_2))


class _Weights:
    """The running checksum over blocks of one size, for many blocks at once.

    Two words x, y turn the sums (a, b) into (a + b + x, a + 2 b + x + y) mod 2^32: a linear map M of the sums plus
    the words' share. After n pairs the sums are M^n (a, b) plus the pairs' shares, each times a power of M.
    """

    def __init__(self, n_bytes: int) -> None:
        powers = [(1, 0, 0, 1)]
        for _ in range(n_bytes // 8):
            a, b, c, d = powers[-1]
            powers.append(((a + b) & WORD, (a + 2 * b) & WORD, (c + d) & WORD, (c + 2 * d) & WORD))
        self._all = powers.pop()
        self._each = np.array(powers[::-1], np.uint64).T  # (4, pairs), that of the last pair is the identity

    def shares(self, words: NDArray[np.uint32]) -> list[Pair]:
        """Return what blocks (n, words) add to the running checksum."""
        x = words[:, 0::2].astype(np.uint64)
        xy = x + words[:, 1::2]
        a, b, c, d = self._each
        first, second = (x @ a + xy @ b) & WORD, (x @ c + xy @ d) & WORD
        return list(zip(first.tolist(), second.tolist(), strict=True))

    def after(self, state: Pair, share: Pair) -> Pair:
        """Return the running checksum behind a block."""
        a, b, c, d = self._all
        return (a * state[0] + b * state[1] + share[0]) & WORD, (c * state[0] + d * state[1] + share[1]) & WORD
