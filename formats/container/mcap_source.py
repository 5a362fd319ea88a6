"""Reading an MCAP file chunk by chunk, with checksums and bounded memory."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from functools import cached_property

from locfuse.formats.columns import Bytes
from locfuse.formats.inputs import MAX_ATTACHMENT

from . import mcap_records as rec
from .decompress import DamagedError
from .file_bytes import FileBytes
from .mcap_survey import ChunkRef, Survey, confirm, promised, survey
from .source import Batch, ChannelInfo, ChunkedSource, Part, Records

MAX_DOWNLOAD_SHARE = 0.5  # of a remote file; if more is wanted, the whole file is downloaded


class McapSource(ChunkedSource):
    """One .mcap file. Opening it reads record headers only; `batches` reads the messages."""

    channels: dict[int, ChannelInfo]

    def __init__(self, data: FileBytes) -> None:
        super().__init__(data)
        found = promised(data) if data.far else None
        if found is None:
            data.copy_here()
            found = survey(data)
        self._use(found)
        counts, self.channels = self.counted(), {}
        for ident, c in self._survey.channels.items():
            schema = self._survey.schemas.get(c.schema_id, rec.Schema(0, "", "", b""))
            how = c.message_encoding, schema.encoding, schema.data
            self.channels[ident] = ChannelInfo(c.topic, schema.name, *how, counts[ident])
        for ident in counts.keys() - self.channels.keys():
            data.lose("messages of an undefined channel", ident, 0, counts[ident])

    def _use(self, found: Survey) -> None:
        """Keep the parts of the file found by a survey; read parts whose channels or message counts are unknown.

        Messages in the file's statistics that are in no part are recorded as a loss.
        """
        self._survey, self.parts = found, found.parts
        for part in found.parts:
            complete = part.counts is not None and part.counts.keys() <= found.channels.keys()
            if complete and all(found.channels[i].schema_id in {0, *found.schemas} for i in part.counts or ()):
                continue
            data, inside = self.load(part)
            for opcode, start, length in inside.definitions:
                with suppress(DamagedError):  # the channel then has no definition
                    found.define(opcode, data[start : start + length].tobytes())
        if missing := Counter(found.expected or {}) - self.counted():
            reason = "messages the file's statistics promise are missing"
            self.data.lose(reason, 0, 0, missing.total())

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Attachments up to MAX_ATTACHMENT bytes, by name; one with a wrong checksum is recorded as a loss."""
        found: dict[str, bytes] = {}
        for at, length in self._survey.attachments:
            if length > MAX_ATTACHMENT:
                continue
            content = self.data.read(at, length)
            try:
                name, data, crc = rec.attachment(content)
                if crc and zlib.crc32(content[:-4]) != crc:
                    raise DamagedError(f"attachment {name!r} fails its checksum")
                found[name] = data
            except DamagedError as problem:
                self.data.lose(str(problem), at, length)
        return found

    @property
    def checked(self) -> bool:
        """Whether every chunk has a checksum and no message is outside a chunk.

        For a remote file, only the first chunk and those already read are examined.
        """
        chunks = [part for part in self._survey.parts if isinstance(part, ChunkRef)]
        with suppress(DamagedError):
            for chunk in chunks[:1]:
                confirm(self.data, chunk)
            same = len(chunks) == len(self._survey.parts)
            return same and all(chunk.crc for chunk in chunks if not chunk.promised)
        return False

    @property
    def time_span_ns(self) -> tuple[int, int] | None:
        """First and last log time [ns] of the parts with messages; None if no part has messages."""
        spans = [part.span for part in self._survey.parts if part.counts and any(part.counts.values())]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    def batches(self, wanted: Collection[int]) -> Iterator[Batch]:
        """Yield the messages of the wanted channels in file order.

        Of a remote file, the chunks with these messages are downloaded first. If they are more than
        MAX_DOWNLOAD_SHARE of the file, the whole file is downloaded.
        """
        if self.data.far:
            chunks = [part for part in self._survey.parts if isinstance(part, ChunkRef)]
            spans = [chunk.place for chunk in chunks if (chunk.counts or {}).keys() & wanted]
            if sum(stop - start for start, stop in spans) <= MAX_DOWNLOAD_SHARE * self.data.size:
                self.data.fetch(spans)
            else:
                self.data.copy_here()
                self._use(survey(self.data))
        yield from super().batches(wanted)

    def search(self, part: Part, data: Bytes) -> Records:
        """Find the records in the uncompressed bytes of a part.

        Message indexes are read even without damage, so that all bytes of the file are read and can be hashed.
        """
        index: rec.Index = {}
        if isinstance(part, ChunkRef) and not part.cut_off:
            with suppress(DamagedError):
                index = dict(rec.message_index(self.data.read(at, length)) for at, length in part.index.values())
        return rec.records(data, part.size, index)

    def unpacked(self, part: Part) -> bytes:
        """Return the uncompressed bytes of a part. Raises DamagedError, also for a wrong checksum."""
        if isinstance(part, ChunkRef):
            confirm(self.data, part)
        plain = super().unpacked(part)
        if isinstance(part, ChunkRef) and part.crc and not part.cut_off and zlib.crc32(plain) != part.crc:
            raise DamagedError("a chunk fails its checksum")
        return plain
