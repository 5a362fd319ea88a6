"""The summary section at the end of an MCAP file, believed only when footer, checksum and records are whole."""

from __future__ import annotations

import zlib

import msgspec
from msgspec import field

from locfuse.formats.caps import MAX_CHUNK

from . import mcap_records as rec
from .decompress import DamagedError
from .file_bytes import FileBytes


class Summary(msgspec.Struct):
    """What the writer said about the whole file."""

    start: int  # file offset of the section
    schemas: dict[int, rec.Schema] = field(default_factory=dict)
    channels: dict[int, rec.Channel] = field(default_factory=dict)
    chunks: dict[int, rec.ChunkIndex] = field(default_factory=dict)  # by file offset
    attachments: list[rec.AttachmentIndex] = field(default_factory=list)
    statistics: rec.Statistics | None = None

    @property
    def counts(self) -> dict[int, int] | None:
        """Channel -> messages; None where the writer counted none."""
        return None if self.statistics is None else self.statistics.counts


TAIL = rec.RECORD.size + rec.FOOTER_LENGTH + len(rec.MAGIC)  # bytes of footer and magic


def lost_summary(data: FileBytes) -> bool:
    """Tell whether a file without a summary to believe should have one: its footer is damaged or points at it."""
    foot = _footer(data)
    return not foot or rec.Cursor(foot, rec.RECORD.size).integers("QQI")[0] != 0


def _footer(data: FileBytes) -> bytes:
    """Return the footer's record and the magic behind it, nothing where either is not there."""
    foot = data.read(max(data.size - TAIL, 0), TAIL)
    whole = len(foot) == TAIL and foot[-len(rec.MAGIC) :] == rec.MAGIC and foot[0] == rec.FOOTER
    return foot if whole else b""


def summary_section(data: FileBytes) -> bytes | None:
    """Return the bytes of the summary section, None where there are none or their checksum is wrong."""
    foot = _footer(data)
    if not foot:
        return None
    start, _, crc = rec.Cursor(foot, rec.RECORD.size).integers("QQI")
    end = data.size - TAIL
    if not len(rec.MAGIC) <= start <= end or end - start > MAX_CHUNK:
        return None
    section = data.read(start, end - start)
    if crc and zlib.crc32(section + foot[: rec.RECORD.size + rec.FOOTER_LENGTH - 4]) != crc:
        return None
    return section


def read_summary(data: FileBytes) -> Summary | None:
    """Return the summary, None where there is none to believe."""
    section = summary_section(data)
    if section is None:
        return None
    try:
        return _parse(section, data.size - TAIL - len(section))
    except DamagedError:
        return None


def _parse(section: bytes, start: int) -> Summary:
    summary = Summary(start)
    at = 0
    while at < len(section):
        cursor = rec.Cursor(section, at)
        opcode, length = cursor.integers("BQ")
        content = cursor.take(length)
        at = cursor.at
        if opcode == rec.SCHEMA:
            schema = rec.schema(content)
            summary.schemas[schema.id] = schema
        elif opcode == rec.CHANNEL:
            channel = rec.channel(content)
            summary.channels[channel.id] = channel
        elif opcode == rec.CHUNK_INDEX:
            chunk = rec.chunk_index(content)
            summary.chunks[chunk.offset] = chunk
        elif opcode == rec.STATISTICS:
            summary.statistics = rec.statistics(content)
        elif opcode == rec.ATTACHMENT_INDEX:
            summary.attachments.append(rec.attachment_index(content))
    return summary
