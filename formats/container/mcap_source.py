"""An MCAP file as a source of message batches: chunk by chunk, checked, with bounded memory."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.caps import MAX_ATTACHMENT, MAX_CHUNK
from locfuse.formats.columns import view
from locfuse.fusion.data import Ints

from . import mcap_records as rec
from .decompress import DamagedError, decompress, decompress_prefix
from .file_bytes import FileBytes
from .losses import Losses
from .mcap_chunk import Index, Records, counted, records
from .mcap_survey import ChunkRef, LooseRun, Part, confirm, promised, survey
from .source import Batch, ChannelInfo, Messages

MAX_SHARE = 0.5  # of a file that is elsewhere: where more is wanted all of it is copied at once

Bytes = NDArray[np.uint8]


class McapSource:
    """One .mcap file. Opening it walks the outermost records only; messages are read by `batches`."""

    def __init__(self, data: FileBytes, losses: Losses) -> None:
        self.path = data.path
        self.losses = losses
        self.data = data
        found = promised(data) if data.far else None
        if found is None:
            data.copy_here()
            found = survey(data, losses)
        self._survey = found
        self._discover()
        self.channels = self._channels()
        self._compare_with_statistics()

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Attachments up to a size by name; one that fails its checksum is lost."""
        found: dict[str, bytes] = {}
        for at, length in self._survey.attachments:
            if length > MAX_ATTACHMENT:
                continue
            content = self.data.read(at, length)
            try:
                name, data, crc = rec.attachment(content)
                if crc and zlib.crc32(content[:-4]) != crc:
                    raise DamagedError("an attachment fails its checksum")
                found[name] = data
            except DamagedError as problem:
                self.losses.add(str(self.path), str(problem), at, length)
        return found

    @property
    def checked(self) -> bool:
        """Whether a changed value would be noticed: every chunk has a checksum, and no message is outside.

        Of a file that is elsewhere, the first chunk speaks for those that were not read.
        """
        chunks = [part for part in self._survey.parts if isinstance(part, ChunkRef)]
        with suppress(DamagedError):
            for chunk in chunks[:1]:
                confirm(self.data, chunk)
            same = len(chunks) == len(self._survey.parts)
            return same and all(chunk.header.crc for chunk in chunks if not chunk.promised)
        return False

    @property
    def time_span_ns(self) -> tuple[int, int] | None:
        """First and last log time of the parts that hold messages, None without any."""
        spans = [part.span for part in self._survey.parts if part.counts and any(part.counts.values())]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    def published(self, data: NDArray[np.uint8], messages: Messages) -> Ints:
        """Return the publish times of the messages, ns, which lie in front of their payloads."""
        return view(data, "<u8", messages.start - 8).astype(np.int64)

    def batches(self, wanted: Collection[int]) -> Iterator[Batch]:
        """Yield the messages of the wanted channels in file order."""
        if self.data.far:
            self._fetch(wanted)
        for part in self._survey.parts:
            if part.counts is not None and not part.counts.keys() & wanted:
                continue
            data, found = self._load(part)
            if messages := {ident: m for ident, m in found.messages.items() if ident in wanted}:
                yield Batch(data, messages)

    def _fetch(self, wanted: Collection[int]) -> None:
        """Load the chunks with wanted messages; where they are most of the file, copy all of it and walk it."""
        chunks = [part for part in self._survey.parts if isinstance(part, ChunkRef)]
        spans = [chunk.place for chunk in chunks if (chunk.counts or {}).keys() & wanted]
        if sum(stop - start for start, stop in spans) <= MAX_SHARE * self.data.size:
            self.data.fetch(spans)
            return
        self.data.copy_here()
        self._survey = survey(self.data, self.losses)
        self._discover()
        self._compare_with_statistics()

    def _load(self, part: Part) -> tuple[Bytes, Records]:
        """Read one part; damage is counted and left out."""
        try:
            data = self._bytes(part)
            found = records(data, self._index(part) if isinstance(part, ChunkRef) else None, part.size)
        except DamagedError as problem:
            known = None if part.counts is None else sum(part.counts.values())
            self.losses.add(str(self.path), str(problem), part.offset, part.size, known)
            return np.empty(0, np.uint8), Records({}, [], 0)
        if found.end < len(data) or part.cut_off:
            self._count_gap(part, len(data), found)
        return data, found

    def _bytes(self, part: Part) -> Bytes:
        if part.size > MAX_CHUNK:
            raise DamagedError(f"a chunk is larger than {MAX_CHUNK >> 20} MiB")
        if isinstance(part, ChunkRef):
            confirm(self.data, part)
        packed = self.data.read(part.start, part.size)
        if isinstance(part, LooseRun):
            return np.frombuffer(packed, np.uint8)
        header = part.header
        if part.cut_off:
            plain = decompress_prefix(packed, header.compression, header.uncompressed_size)
        else:
            plain = decompress(packed, header.compression, header.uncompressed_size)
            if header.crc and zlib.crc32(plain) != header.crc:
                raise DamagedError("a chunk fails its checksum")
        return np.frombuffer(plain, np.uint8)

    def _index(self, chunk: ChunkRef) -> Index | None:
        """Return the message indexes after a chunk, None without any."""
        try:
            found = [rec.message_index(self.data.read(at, length)) for at, length in chunk.index.values()]
        except DamagedError:
            return None
        return dict(found) if found and not chunk.cut_off else None

    def _count_gap(self, part: Part, size: int, found: Records) -> None:
        reason = "the file is cut off inside a chunk" if part.cut_off else "a chunk holds bytes that are no record"
        missing = None
        if part.counts is not None:
            missing = max(sum(part.counts.values()) - counted(found.messages.values()), 0)
        self.losses.add(str(self.path), reason, part.offset, size - found.end, missing)

    def _discover(self) -> None:
        """Read the parts whose channels and message counts are only known from their content."""
        known = self._survey
        for part in known.parts:
            complete = part.counts is not None and part.counts.keys() <= known.channels.keys()
            if complete and all(known.channels[i].schema_id in {0, *known.schemas} for i in part.counts or ()):
                continue
            data, found = self._load(part)
            if part.counts is None:
                part.counts = {ident: len(m.start) for ident, m in found.messages.items()}
            for opcode, start, length in found.definitions:
                with suppress(DamagedError):  # then the channel has no definition
                    known.define(opcode, data[start : start + length].tobytes())

    def _counts(self) -> Counter[int]:
        total: Counter[int] = Counter()
        for part in self._survey.parts:
            total.update(part.counts or {})
        return total

    def _channels(self) -> dict[int, ChannelInfo]:
        nothing = rec.Schema(0, "", "", b"")
        counts = self._counts()
        found: dict[int, ChannelInfo] = {}
        for ident, c in self._survey.channels.items():
            schema = self._survey.schemas.get(c.schema_id, nothing)
            found[ident] = ChannelInfo(
                c.topic, schema.name, c.message_encoding, schema.encoding, schema.data, counts[ident]
            )
        for ident in counts.keys() - found.keys():
            self.losses.add(str(self.path), "messages of a channel nobody defines", ident, 0, counts[ident])
        return found

    def _compare_with_statistics(self) -> None:
        missing = Counter(self._survey.expected or {}) - self._counts()
        if missing:
            reason = "messages the file's statistics promise are missing"
            self.losses.add(str(self.path), reason, 0, 0, missing.total())
