"""A log: its topics, delivered as streams of columns."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..fusion.data import Ints, LocfuseError, UsageError
from . import clock as clocks
from . import transforms
from .cdr import Decoder, FieldError
from .layout import CDR
from .log_files import log_files, log_name
from .losses import Losses
from .mcap_walk import McapSource
from .schema import SchemaError, message_type, parse
from .source import ChannelInfo, Source
from .stream import LogStream
from .table import Raw, Table, digest

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass(frozen=True)
class Topic:
    """One topic of a log, over all its files."""

    msgtype: str  # pkg/msg/Name
    count: int
    encoding: str  # of the messages
    schema_encoding: str
    problem: str | None = None  # why it cannot be read, None = it can


def open_log(paths: Sequence[Path]) -> Log:
    """Open one log made of the given files and folders; messages are merged by topic over all files."""
    files = sorted({file for path in paths for file in log_files(path)}, key=lambda file: (file.name, str(file)))
    losses = Losses()
    sources: list[Source] = [_open(file, losses) for file in files]
    return Log(files, sources, log_name(paths))


def _open(file: Path, losses: Losses) -> Source:
    try:
        return McapSource(file, losses)
    except OSError as problem:
        raise LocfuseError(f"{file}: cannot be read: {problem.strerror}") from None


class Log:
    """A log of one or more files. Streams with light columns are read together, in one walk over the files."""

    def __init__(self, paths: Sequence[Path], sources: Sequence[Source], name: str) -> None:
        self.paths = tuple(paths)
        self.name = name
        self._sources = tuple(sources)
        self.losses = sources[0].losses if sources else Losses()
        self._channels = _by_topic(sources)
        self.topics = {topic: _describe(channels) for topic, channels in sorted(self._channels.items())}
        self._decoders: dict[tuple[str, str, bytes], Decoder] = {}
        self._tables: dict[str, Table] = {}
        self._streams: dict[tuple[str, str], LogStream] = {}

    @cached_property
    def sha256(self) -> str:
        """Hash of the input's bytes, file after file by name."""
        state = hashlib.sha256()
        for path in self.paths:
            with path.open("rb") as file:
                while piece := file.read(1 << 20):
                    state.update(piece)
        return state.hexdigest()

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Attachments of all files by name."""
        return {name: data for source in self._sources for name, data in source.attachments.items()}

    @property
    def decoded_fast(self) -> int:
        """Messages gathered by a layout that another message gave."""
        return sum(decoder.fast for decoder in self._decoders.values())

    @property
    def decoded_general(self) -> int:
        """Messages walked by themselves."""
        return sum(decoder.general for decoder in self._decoders.values())

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
            raise LocfuseError(f"{self.name}: {topic} cannot be read: {problem}")

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
            decoder = self._decoder(self._channels[topic][0][2], topic)
            self._tables[topic] = Table(topic, decoder)
        return self._tables[topic]

    def _check_fields(self, topic: str, fields: Sequence[str]) -> None:
        decoder = self._decoder(self._channels[topic][0][2], topic)
        for path in fields:
            try:
                decoder.check(path)
            except FieldError as problem:
                raise LocfuseError(f"{topic} ({self.topics[topic].msgtype}): {problem.args[0]}") from None

    def _walk(self, topics: Collection[str]) -> Iterator[tuple[str, Raw]]:
        """Yield the messages of several topics, batch by batch over all files."""
        for source in self._sources:
            wanted = {
                ident: (topic, self._decoder(channel, topic))
                for topic in topics
                for where, ident, channel in self._channels[topic]
                if where is source and same_kind(channel, self.topics[topic])
            }
            for batch in source.batches(wanted.keys()):
                for ident, messages in batch.messages.items():
                    topic, decoder = wanted[ident]
                    yield topic, Raw(batch.data, messages, decoder)

    def raw(self, topic: str, rows: int) -> Iterator[Raw]:
        """Yield the messages of one topic, at most `rows` at a time."""
        for _, raw in self._walk({topic}):
            for at in range(0, len(raw.messages.start), rows):
                yield raw._replace(messages=raw.messages.take(slice(at, at + rows)))

    def _decoder(self, channel: ChannelInfo, topic: str) -> Decoder:
        key = (channel.msgtype, channel.schema_encoding, channel.schema)
        if key not in self._decoders:
            try:
                message = parse(
                    channel.msgtype, channel.schema_encoding, channel.schema.decode("utf-8", "replace")
                )
            except SchemaError as problem:
                raise LocfuseError(f"{self.name}: {topic} cannot be read: {problem}") from None
            self._decoders[key] = Decoder(message, CDR)
        return self._decoders[key]

    def unreadable(self, topic: str) -> dict[str, int]:
        """Count the messages on a topic that are of another type than the rest of it."""
        others = [c for _, _, c in self._channels[topic] if not same_kind(c, self.topics[topic])]
        count = sum(c.n or 0 for c in others)
        return {f"of type {others[0].msgtype}": count} if count else {}


def _is_static_tf(name: str, topic: Topic) -> bool:
    return name.rpartition("/")[2] == "tf_static" and topic.msgtype in TF_TYPES and not topic.problem


def same_kind(channel: ChannelInfo, topic: Topic) -> bool:
    """Tell whether a channel's messages are of the topic's type and encoding."""
    return message_type(channel.msgtype) == topic.msgtype and channel.encoding == topic.encoding


def _by_topic(sources: Sequence[Source]) -> dict[str, list[tuple[Source, int, ChannelInfo]]]:
    found: dict[str, list[tuple[Source, int, ChannelInfo]]] = {}
    for source in sources:
        for ident, channel in source.channels.items():
            found.setdefault(channel.topic, []).append((source, ident, channel))
    for channels in found.values():
        channels.sort(key=lambda entry: -(entry[2].n or 0))
    return found


def _describe(channels: Sequence[tuple[Source, int, ChannelInfo]]) -> Topic:
    """Describe a topic by its busiest channel; what is of another type is left out and counted."""
    main = channels[0][2]
    topic = Topic(message_type(main.msgtype), 0, main.encoding, main.schema_encoding, _problem(main))
    count = sum(channel.n or 0 for _, _, channel in channels if same_kind(channel, topic))
    return replace(topic, count=count)


def _problem(channel: ChannelInfo) -> str | None:
    if channel.encoding != "cdr":
        return f"its messages are encoded as {channel.encoding!r}; cdr is read"
    if channel.schema_encoding not in {"ros2msg", "ros2idl"}:
        return f"its type is described in {channel.schema_encoding!r}; ros2msg and ros2idl are read"
    return None
