"""A log: its topics, delivered as streams of columns."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from locfuse.formats.caps import MAX_TOPICS, names_its_cap
from locfuse.formats.container.compressed_messages import unpack
from locfuse.formats.container.losses import Losses
from locfuse.formats.container.source import Recorded, Source
from locfuse.formats.messages.fields import FieldError, resolve
from locfuse.formats.messages.kinds import check_kind
from locfuse.formats.messages.schema import SchemaError
from locfuse.formats.robot import transforms
from locfuse.fusion.data import Ints, LocfuseError, UsageError

from . import clock as clocks
from .files import log_name, open_source
from .identity import Identity, files_of, identity_of
from .stream import LogStream
from .table import Raw, Table, dated, digest
from .topics import Topic, UnreadableTopicError, by_topic

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


def open_log(paths: Sequence[Path]) -> Log:
    """Open one log made of the given files and folders; messages are merged by topic over all files."""
    files = files_of(paths)
    losses = Losses()
    return Log(files, [open_source(file, losses) for file in files], log_name(paths), losses)


class Log:
    """A log of one or more files. Streams with light columns are read together, in one walk over the files."""

    def __init__(self, paths: Sequence[Path], sources: Sequence[Source], name: str, losses: Losses) -> None:
        self.paths = tuple(paths)
        self.name = name
        self._sources = tuple(sources)
        self.losses = losses
        self._channels = by_topic(sources)
        if len(self._channels) > MAX_TOPICS:
            raise LocfuseError(names_its_cap(f"{name}: too many topics", len(self._channels), MAX_TOPICS))
        self.topics = {topic: channels.topic for topic, channels in self._channels.items()}
        self._tables: dict[str, Table] = {}
        self._streams: dict[tuple[str, str], LogStream] = {}

    @cached_property
    def sha256(self) -> str:
        """Hash of the input's bytes, file after file by name."""
        state = hashlib.sha256()
        for source in self._sources:
            source.data.feed(state.update)
        return state.hexdigest()

    @property
    def all_read(self) -> bool:
        """Whether every byte of the files was read, so that their hash costs no reading."""
        return all(source.data.all_read for source in self._sources)

    @cached_property
    def identity(self) -> Identity:
        """What the content is known by without reading all of it."""
        return identity_of(self.paths)

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Attachments of all files by name."""
        return {name: data for source in self._sources for name, data in source.attachments.items()}

    @property
    def unchecked(self) -> list[str]:
        """Names of the files in which a changed value cannot be noticed: without checksums, or not of MCAP."""
        return [p.name for p, s in zip(self.paths, self._sources, strict=True) if not getattr(s, "checked", False)]

    @property
    def decoded_fast(self) -> int:
        """Messages gathered by a layout that another message gave."""
        return sum(table.decoder.fast for table in self._tables.values())

    @property
    def decoded_general(self) -> int:
        """Messages walked by themselves."""
        return sum(table.decoder.general for table in self._tables.values())

    def stream(self, topic: str, order: str = "auto") -> LogStream:
        """Return a topic's stream; nothing is read before its rows are asked for."""
        if order not in clocks.ORDERS:
            raise UsageError(f"order = {order!r} is unknown; it is one of {', '.join(clocks.ORDERS)}")
        self._check(topic)
        return self._streams.setdefault((topic, order), LogStream(self, topic, self.topics[topic].msgtype, order))

    def streams(self, wants: Mapping[str, Sequence[str]], order: str = "auto") -> dict[str, LogStream]:
        """Return the streams of several topics, their named fields read in one walk over the log."""
        streams = {topic: self.stream(topic, order) for topic in wants}
        self.read(wants)
        return streams

    def static_transforms(self) -> transforms.StaticTransforms:
        """Return the transforms of /tf_static, namespaced ones too, by all its publishers."""
        topics = [name for name, topic in self.topics.items() if _is_static_tf(name, topic)]
        self.read(dict.fromkeys(topics, transforms.FIELDS))
        return transforms.static_transforms(self.stream(topic).columns(*transforms.FIELDS) for topic in topics)

    @property
    def time_span_ns(self) -> tuple[int, int] | None:
        """First and last log time of the messages, None for an empty log."""
        spans = [span for source in self._sources if (span := source.time_span_ns) is not None]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    def _check(self, topic: str) -> None:
        if topic not in self.topics:
            near = difflib.get_close_matches(topic, self.topics, 1)
            hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(self.topics) or 'no topics'}"
            raise LocfuseError(f"{self.name} has no topic {topic}; {hint}")
        if problem := self.topics[topic].problem:
            raise UnreadableTopicError.of(self.name, topic, problem)

    def read(self, wants: Mapping[str, Sequence[str]]) -> dict[str, Table]:
        """Make sure that the fields are in memory; what is missing is read in one walk."""
        tables = {topic: self._table(topic) for topic in wants}
        reading = {t: table for t, table in tables.items() if not table.known or table.missing(wants[t])}
        for topic, table in reading.items():
            self._check_fields(topic, wants[topic])
            table.begin(wants[topic])
        for topic, raw in self._walk(reading) if reading else ():
            reading[topic].feed(raw)
        new = {topic: table for topic, table in reading.items() if not table.known}
        tied = {topic: table for topic, table in reading.items() if table.end()}
        digests = self._digests(tied)
        for topic, table in new.items():
            table.sort(digests.get(topic))
        return tables

    def _digests(self, tied: Mapping[str, Table]) -> dict[str, Ints]:
        found: dict[str, list[Ints]] = {topic: [] for topic in tied}
        times = {topic: table.tied() for topic, table in tied.items()}
        for topic, raw in self._walk(tied) if tied else ():
            found[topic].append(digest(raw, times[topic]))
        return {topic: np.concatenate(parts) for topic, parts in found.items()}

    def _table(self, topic: str) -> Table:
        if topic not in self._tables:
            try:
                self._tables[topic] = Table(topic, self._channels[topic].decoder, self.topics[topic].count)
            except SchemaError as problem:
                raise UnreadableTopicError.of(self.name, topic, str(problem)) from None
        return self._tables[topic]

    def _check_fields(self, topic: str, fields: Sequence[str]) -> None:
        for path in fields:
            try:
                parts = resolve(self._channels[topic].decoder.message, path)
                check_kind(self.topics[topic].msgtype, path, parts)
            except FieldError as problem:
                raise LocfuseError(f"{topic} ({self.topics[topic].msgtype}): {problem.args[0]}") from None

    def _walk(self, topics: Collection[str]) -> Iterator[tuple[str, Raw]]:
        """Yield the messages of several topics, batch by batch over all files."""
        for source in self._sources:
            wanted = {
                ident: (topic, decoder)
                for topic in topics
                for ident, decoder in self._channels[topic].of(source).items()
            }
            for batch in source.batches(wanted.keys()):
                for ident, messages in batch.messages.items():
                    topic, decoder = wanted[ident]
                    for data, unpacked in unpack(batch.data, messages):
                        yield topic, dated(Raw(data, unpacked, decoder))

    def messages(self) -> Iterator[list[Recorded]]:
        """Yield all messages as they lie in the files, whether or not they can be read, batch by batch."""
        for source in self._sources:
            for batch in source.batches(source.channels.keys()):
                yield [
                    Recorded(
                        source.channels[ident],
                        data,
                        unpacked,
                        source.published(data, unpacked) if data is batch.data else unpacked.log_time,
                    )
                    for ident, messages in batch.messages.items()
                    for data, unpacked in unpack(batch.data, messages)
                ]

    def raw(self, topic: str, fields: Sequence[str]) -> Iterator[Raw]:
        """Yield the messages of one topic, of which `fields` will be asked, batch by batch."""
        self._check_fields(topic, fields)
        for _, raw in self._walk({topic}):
            yield raw

    def forget(self) -> None:
        """Let go of what was read; what is asked for again is read again."""
        self._tables.clear()
        self._streams.clear()

    def left_out(self, topic: str) -> Mapping[str, int]:
        """Count the messages on a topic that are of another type than the rest of it."""
        return self._channels[topic].left_out()


def _is_static_tf(name: str, topic: Topic) -> bool:
    return name.rpartition("/")[2] == "tf_static" and topic.msgtype in TF_TYPES and not topic.problem
