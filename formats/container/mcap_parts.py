"""The parts of an MCAP file that hold messages, as the survey finds them."""

from __future__ import annotations

import msgspec
from msgspec import field

from . import mcap_records as rec


class ChunkRef(msgspec.Struct):
    """One chunk of the file."""

    offset: int  # of its record
    header: rec.ChunkHeader
    index: dict[int, tuple[int, int]] = field(default_factory=dict)  # channel -> (file offset, content length)
    available: int = 0  # compressed bytes present: less than header.length where the file is cut off
    counts: dict[int, int] | None = None  # channel -> messages, once known
    promised: bool = False  # whether only the summary says all this: its checksum is then not known yet

    @property
    def start(self) -> int:
        """File offset of the compressed bytes."""
        return self.offset + rec.RECORD.size + self.header.start

    @property
    def span(self) -> tuple[int, int]:
        """Log times of its first and last message, ns."""
        return self.header.first, self.header.last

    @property
    def size(self) -> int:
        """Bytes to read: fewer than the header says where the file is cut off."""
        return self.available

    @property
    def cut_off(self) -> bool:
        """Whether the file ends inside this chunk."""
        return self.available < self.header.length


class LooseRun(msgspec.Struct):
    """Consecutive messages outside any chunk."""

    offset: int
    size: int
    counts: dict[int, int] | None = field(default_factory=dict)
    span: tuple[int, int] = (0, 0)  # log times, ns
    cut_off: bool = False

    @property
    def start(self) -> int:
        """File offset of the bytes."""
        return self.offset


Part = ChunkRef | LooseRun


def put_in_order(parts: list[Part]) -> None:
    """Sort parts by time where one of them ends before an earlier one begins: chunks may stand in any order.

    Those whose times overlap stay as they are: stamps jitter, the order of a file does not.
    """
    latest = 0
    for first, last in (part.span for part in parts):
        if last < latest:
            parts.sort(key=lambda part: part.span[1])
            return
        latest = max(latest, first)


class Survey(msgspec.Struct):
    """What the walk found."""

    parts: list[Part] = field(default_factory=list)
    schemas: dict[int, rec.Schema] = field(default_factory=dict)
    channels: dict[int, rec.Channel] = field(default_factory=dict)
    attachments: list[tuple[int, int]] = field(default_factory=list)  # (content offset, length)
    expected: dict[int, int] | None = None  # channel -> messages, by the statistics

    def define(self, opcode: int, content: bytes) -> None:
        """Take a Schema or Channel record; what was said first (by the summary, where there is one) counts."""
        if opcode == rec.SCHEMA:
            schema = rec.schema(content)
            self.schemas.setdefault(schema.id, schema)
        elif opcode == rec.CHANNEL:
            channel = rec.channel(content)
            self.channels.setdefault(channel.id, channel)
