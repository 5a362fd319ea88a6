"""A log: its topics as streams of columns."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from typing import Self, cast

import numpy as np
from msgspec.structs import replace

from locfuse.formats.columns import Bytes
from locfuse.formats.container.file_bytes import Losses, Place
from locfuse.formats.container.source import ChannelInfo, Messages, Source, unpack
from locfuse.formats.inputs import MAX_TOPICS, refuse_above
from locfuse.formats.messages.schema import (
    NUMBER as A_NUMBER,
    NUMBERS,
    FieldError,
    SchemaError,
    check_kind,
    kind_of,
    resolve,
)
from locfuse.formats.robot import transforms
from locfuse.formats.text import did_you_mean
from locfuse.fusion.data import Ints, LocfuseError, UsageError
from locfuse.fusion.progress import report_progress

from . import clock as clocks
from .adapters import PRESENTED, presented_name
from .file_stream import RANGES, is_file_topic, read_file
from .files import Identity, Topic, by_topic, files_of, identity_of, log_name, open_source
from .stream import (
    NUMBER,
    LogStream,
    PresentedStream,
    Raw,
    TopicTable,
    digest,
    field_of,
    number_in,
    path_in,
    plausibly_recorded,
    ranges_in,
)
from .transform_stream import (
    OF_CAMERA,
    TAGS,
    TF_FIELDS,
    TRANSFORM,
    FrameEdge,
    edges_of,
    frame_in,
    loop_in,
    pair_of,
    tags_in,
    tags_of,
)


class UnreadableTopicError(LocfuseError):
    """Error: the messages of a topic cannot be decoded; `problem` is the reason, without log and topic name."""

    problem: str = ""

    @classmethod
    def of(cls, log: str, topic: str, problem: str) -> Self:
        """Return the error for a topic of a log."""
        error = cls(f"{log}: {topic} cannot be read: {problem}")
        error.problem = problem
        return error


# --- The log

AnyStream = LogStream | clocks.MadeStream
MIN_CHANGES = 10  # changes from channel to channel; with fewer, two publishers do not alternate
MIN_MOTION_M = 0.005  # m, and quaternion components (0.6 degrees): smaller changes come from a flexible mount
FOXGLOVE_TF = tuple(f"foxglove{dot}FrameTransform{s}" for dot in (".", "_msgs/msg/") for s in ("", "s"))
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage", *FOXGLOVE_TF)


def open_log(paths: Sequence[Place]) -> Log:
    """Open files and folders as one log; messages are merged by topic over all files."""
    files = files_of(paths)
    losses = Losses()
    return Log(files, [open_source(file, losses) for file in files], log_name(paths), losses, paths)


class Log:
    """A log of one or more files. Fields of several topics are read together in one pass."""

    def __init__(
        self, paths: Sequence[Place], sources: Sequence[Source], name: str, losses: Losses, given: Sequence[Place]
    ) -> None:
        self.paths = tuple(paths)
        self.given = tuple(given)  # files and folders as the user named them
        self.name = name
        self._sources = tuple(sources)
        self.losses = losses
        self._channels = by_topic(sources)
        refuse_above(f"{name}: too many topics", len(self._channels), MAX_TOPICS)
        self.topics = {topic: channels.topic for topic, channels in self._channels.items()}
        self._tables: dict[str, TopicTable] = {}
        self._frame_ids: dict[str, list[str]] = {}  # topic -> frame_ids of some messages
        self._streams: dict[tuple[str, str], AnyStream] = {}
        self._derived: dict[str, Callable[[str], AnyStream]] = {}  # topic -> function: order -> stream
        self._files: set[str] = set()
        self._edges: dict[tuple[str, str], dict[tuple[str, str], FrameEdge]] = {}

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the bytes of all files, in order of file name."""
        state = hashlib.sha256()
        for source in self._sources:
            source.data.feed(state.update)
        return state.hexdigest()

    @property
    def all_read(self) -> bool:
        """Whether every byte of the files has been read."""
        return all(source.data.all_read for source in self._sources)

    @cached_property
    def identity(self) -> Identity:
        """Size and hash that identify the content without reading all of it."""
        return identity_of(self.paths, [source.data.state for source in self._sources])

    @property
    def etags(self) -> list[str]:
        """The ETags of the remote files; [] for local ones."""
        return [source.data.state[1] for source in self._sources if source.data.state is not None]

    @property
    def transfer(self) -> tuple[int, int] | None:
        """Bytes transferred over the network so far, and total size of the remote files; None if all are local."""
        files = [source.data for source in self._sources]
        found = [(file.fetched, file.state[0]) for file in files if file.state is not None]
        return (sum(fetched for fetched, _ in found), sum(size for _, size in found)) if found else None

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Attachments of all files by name."""
        return {name: data for source in self._sources for name, data in source.attachments.items()}

    @property
    def message_count(self) -> int:
        """Number of messages on all topics, readable or not, according to the files."""
        return sum(one.channel.n or 0 for channels in self._channels.values() for one in channels.carriers)

    @property
    def unchecked(self) -> list[str]:
        """Names of the files without checksums; a changed value in these files cannot be detected."""
        return [p.name for p, s in zip(self.paths, self._sources, strict=True) if not s.checked]

    def stream(self, topic: str, order: str = "auto") -> AnyStream:
        """Return a topic's stream; its rows are read on first access.

        Derived topics: "/tf:odom:base_link" (pose of base_link in odom from /tf, as TransformStamped),
        "/tf:camera_optical:tags" (tags seen by this camera), "/status:yaw.value" (a number in any message),
        "/points:scan" (level slice of a cloud as LaserScan), "/path:poses" (poses of a Path), or a .tum or .csv
        file.
        """
        if order not in clocks.ORDERS:
            raise UsageError(f"order = {order!r} is unknown; it is one of {', '.join(clocks.ORDERS)}")
        if (topic, order) in self._streams:
            return self._streams[topic, order]
        self.find(topic)
        if topic in self._derived:
            try:
                stream = self._derived[topic](order)
            except LocfuseError as problem:
                unreadable = clocks.UnreadableStream(topic, self.topics[topic].msgtype, problem)
                stream = cast("clocks.MadeStream", unreadable)
        else:
            self._check(topic)
            stream = LogStream(self, topic, self.topics[topic].msgtype, order)
        return self._streams.setdefault((topic, order), stream)

    def streams(self, wants: Mapping[str, Sequence[str]], order: str = "auto") -> dict[str, AnyStream]:
        """Return the streams of several topics; reads the named fields of all in one pass over the log."""
        streams = {topic: self.stream(topic, order) for topic in wants}
        self.read({topic: fields for topic, fields in wants.items() if self.recorded(topic)})
        return streams

    def find(self, name: str) -> Topic | None:
        """Return a recorded or derived topic (frames of /tf, a number, a file) by its name; None if unknown."""
        if name not in self.topics and (made := self._derive(name)) is not None:
            self.topics[name], self._derived[name] = made
        return self.topics.get(name)

    def _derive(self, name: str) -> tuple[Topic, Callable[[str], AnyStream]] | None:
        """Return the derived topic `name`, and a function that returns its stream for an `order`.

        The source of the topic is another topic of the log, or a text file. None if there is no such topic.
        """
        pair, number, source = pair_of(name), field_of(name), name.rpartition(":")[0]
        if pair is not None and self._is_tf(pair[0]):
            return self._of_frames(name, pair)
        if source in self._channels and presented_name(source, self.topics[source].msgtype) == name:
            self._check(source)
            how = PRESENTED[self.topics[source].msgtype]
            adapted = replace(self.topics[source], msgtype=how.msgtype)
            shown: Callable[[str, LogStream], AnyStream] = path_in if how.make is None else PresentedStream
            return adapted, lambda order: shown(name, self._stream_of(source, order))
        if number is not None and number[0] in self._channels:
            topic, field = number
            self._check_numbers(topic, field.split(","))
            msgtype, taken = (RANGES, ranges_in) if "," in field else (NUMBER, number_in)
            made = replace(self.topics[topic], msgtype=msgtype)
            return made, lambda order: taken(name, self._stream_of(topic, order), field)
        if is_file_topic(name):
            file = read_file(name)
            self._files.add(name)
            return Topic(file.msgtype, len(file.t_ns), "", ""), lambda _: file
        return None

    def _stream_of(self, topic: str, order: str) -> LogStream:
        return LogStream(self, topic, self.topics[topic].msgtype, order)

    def _of_frames(self, name: str, pair: tuple[str, str, str]) -> tuple[Topic, Callable[[str], AnyStream]] | None:
        """Return a topic derived from /tf, and a function that returns its stream for an `order`.

        `pair` is the /tf topic, the parent frame and the child frame. The topic has the child's pose in the
        parent. If the child is OF_CAMERA, the topic has the tags seen by the camera `parent`; None if no tag was
        seen.
        """
        tf, parent, child = pair
        source, edges = self.topics[tf], self.frames(tf)
        if child != OF_CAMERA:
            count = len(edges[parent, child].stamp) if (parent, child) in edges else source.count
            made = Topic(TRANSFORM, count, source.encoding, source.schema_encoding)
            return made, lambda o: frame_in(name, tuple(self.frames(tf, o).values()), self.static_transforms())
        seen = sum(len(edge.stamp) for edge in tags_of(edges, parent))
        made = Topic(TAGS, seen, source.encoding, source.schema_encoding)
        if not seen:
            return None
        return made, lambda o: tags_in(name, o, tags_of(self.frames(tf, o), parent), self.all_mounts())

    def _check_numbers(self, topic: str, fields: Sequence[str]) -> None:
        """Raise LocfuseError unless `fields` are one or two numeric fields, or two lists of numbers."""
        self._check(topic)
        self._check_fields(topic, tuple(fields))
        kinds = [kind_of(resolve(self._channels[topic].decoder.message, field)) for field in fields]
        source = f"{topic} ({self.topics[topic].msgtype})"
        if len(fields) > 2:
            raise LocfuseError(f"{source}: one field, or those of id and range, can be read, not {len(fields)}")
        for field, kind in zip(fields, kinds, strict=True):
            if kind != A_NUMBER and kinds != [NUMBERS, NUMBERS]:
                raise LocfuseError(f"{source}: {field} is {kind}, not {A_NUMBER}")

    def recorded(self, name: str) -> bool:
        """Return whether a topic was recorded in the log (False for derived topics and files)."""
        return name in self._channels

    def is_file(self, name: str) -> bool:
        """Return whether a topic is a text file outside the log."""
        return name in self._files

    def _is_tf(self, name: str) -> bool:
        topic = self.topics.get(name)
        return topic is not None and topic.msgtype in TF_TYPES and not topic.problem

    @property
    def transform_topics(self) -> list[str]:
        """Names of the topics of changing transforms: /tf, with any namespace."""
        return [
            name
            for name, topic in sorted(self.topics.items())
            if self._is_tf(name)
            and (name.rpartition("/")[2] == "tf" or topic.msgtype in FOXGLOVE_TF)
            and not _is_static_tf(name, topic)
        ]

    def frames(self, topic: str, order: str = "auto") -> dict[tuple[str, str], FrameEdge]:
        """Return the transforms of a /tf topic by (parent, child). Raises LocfuseError if frames form a loop."""
        if (topic, order) not in self._edges:
            table = self.read({topic: TF_FIELDS})[topic]
            assert table.log_time is not None
            found = edges_of(table.log_time, table.columns, order, lambda: self.stamps_clock)
            if loop := loop_in(tuple(found.values())):
                raise LocfuseError(f"{topic}: frames form a loop: {' -> '.join(loop)}")
            self._edges[topic, order] = found
        return self._edges[topic, order]

    def static_transforms(self) -> transforms.StaticTransforms:
        """Return the transforms of all /tf_static topics (with any namespace)."""
        topics = [name for name, topic in self.topics.items() if _is_static_tf(name, topic)]
        self.read(dict.fromkeys(topics, transforms.FIELDS))
        return transforms.static_transforms(self.stream(topic).columns(*transforms.FIELDS) for topic in topics)

    def moving_transforms(self) -> list[transforms.Transform]:
        """Return each transform of /tf that changes by more than MIN_MOTION_M, with its first value."""
        return [
            _at_first(edge)
            for topic in self.transform_topics
            for edge in self.frames(topic).values()
            if np.ptp(edge.values, axis=0).max() > MIN_MOTION_M
        ]

    def all_mounts(self) -> transforms.StaticTransforms:
        """Return all fixed transforms: all of /tf_static, and for other child frames the constant ones of /tf."""
        static = self.static_transforms()
        known = {edge.child for edge in static.edges}
        edges = (edge for topic in self.transform_topics for edge in self.frames(topic).values())
        still = (_at_first(edge) for edge in edges if not edge.moves and edge.child not in known)
        return transforms.StaticTransforms((*static.edges, *still), static.conflicts)

    @cached_property
    def stamps_clock(self) -> tuple[Ints, Ints] | None:
        """Log times and stamps (n,) of a topic, if stamps and recording use different clocks; else None."""
        stamped = [
            name
            for msgtype in clocks.SMALL_TYPES
            for name, t in sorted(self.topics.items())
            if t.msgtype == msgtype and t.count >= clocks.MIN_MESSAGES and self.recorded(name) and not t.problem
        ]
        pairs = []
        for name in stamped[: clocks.MAX_TOPICS]:
            with suppress(LocfuseError):  # unreadable topics are reported elsewhere
                table = self.read({name: ()})[name]
                if table.stamp is not None and table.log_time is not None and len(table.log_time):
                    stamp = np.asarray(table.columns[table.stamp]).astype(np.int64)
                    stamp = clocks.whole_ns(table.log_time, stamp)
                    if clocks.settle(table.log_time, stamp).by_stamps:
                        pairs.append((table.log_time, stamp))
        return clocks.common_clock(pairs)

    @property
    def time_span_ns(self) -> tuple[int, int] | None:
        """First and last log time [ns] of the messages; None for an empty log."""
        spans = [span for source in self._sources if (span := source.time_span_ns) is not None]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    def _check(self, topic: str) -> None:
        if topic not in self.topics:
            hint = did_you_mean(topic, self.topics) or f"it has {', '.join(self.topics) or 'no topics'}"
            raise LocfuseError(f"{self.name} has no topic {topic}; {hint}")
        if problem := self.topics[topic].problem:
            raise UnreadableTopicError.of(self.name, topic, problem)

    def read(self, wants: Mapping[str, Sequence[str]]) -> dict[str, TopicTable]:
        """Return the topics' tables with these fields; those not yet in memory are read in one pass."""
        tables = {topic: self._table(topic) for topic in wants}
        reading = {t: table for t, table in tables.items() if not table.known or table.missing(wants[t])}
        for topic, table in reading.items():
            self._check_fields(topic, wants[topic])
            table.begin(wants[topic])
        for topic, raw in self._walk(reading) if reading else ():
            reading[topic].feed(raw)
        new = {topic: table for topic, table in reading.items() if not table.known}
        tied = {topic: table.tied() for topic, table in reading.items() if table.end()}
        digests: dict[str, list[Ints]] = {topic: [] for topic in tied}
        for topic, raw in self._walk(tied) if tied else ():
            digests[topic].append(digest(raw, tied[topic]))
        for topic, table in new.items():
            table.sort(np.concatenate(digests[topic]) if topic in tied else None)
        return tables

    def _table(self, topic: str) -> TopicTable:
        if topic not in self._tables:
            try:
                self._tables[topic] = TopicTable(topic, self._channels[topic].decoder, self.topics[topic].count)
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
        """Yield (topic, messages) of several topics, batch by batch over all files."""
        span = self.time_span_ns
        try:
            for source in self._sources:
                readers = ((topic, self._channels[topic].of(source)) for topic in topics)
                wanted = {ident: (topic, decoder) for topic, of in readers for ident, decoder in of.items()}
                for ident, data, messages in _unpacked(source, wanted.keys()):
                    topic, decoder = wanted[ident]
                    if span is not None and span[0] < span[1] and len(messages.log_time):
                        share = (int(messages.log_time[0]) - span[0]) / (span[1] - span[0])
                        report_progress(min(1.0, max(0.0, share)))
                    yield topic, plausibly_recorded(Raw(data, messages, decoder))
        finally:  # also if the caller stops early
            report_progress(None)

    def messages(self) -> Iterator[tuple[ChannelInfo, Bytes, Messages]]:
        """Yield all messages, readable or not: channel by channel in each batch, batches in file order."""
        for source in self._sources:
            for ident, data, messages in _unpacked(source, source.channels.keys()):
                yield source.channels[ident], data, messages

    def raw(self, topic: str, fields: Sequence[str]) -> Iterator[Raw]:
        """Yield the messages of one topic batch by batch. Raises LocfuseError if it lacks one of `fields`."""
        self._check_fields(topic, fields)
        for _, raw in self._walk({topic}):
            yield raw

    def in_turn(self, topic: str) -> list[int]:
        """Return the message counts of two channels of one file that write to a topic alternately; else [].

        A recorder gives each publisher of a topic its own channel. A publisher that was restarted, or whose
        messages were recorded twice, does not count as a second publisher.
        """
        for source in self._sources:
            carriers = self._channels[topic].of_type if topic in self._channels else []
            idents = [carrier.ident for carrier in carriers if carrier.source is source]
            if len(idents) > 1 and (counts := _alternating(source, idents)):
                return counts
        return []

    def forget(self) -> None:
        """Free all columns in memory; later requests read them again."""
        self._frame_ids |= {topic: table.frames for topic, table in self._tables.items() if table.known}
        self._tables.clear()
        self._streams.clear()
        self._edges.clear()

    def frame_ids(self, topic: str) -> list[str]:
        """Return the frame_ids of some messages of a topic, in file order; `forget` does not delete them."""
        if topic not in self._frame_ids:
            self._frame_ids[topic] = self.read({topic: ()})[topic].frames
        return self._frame_ids[topic]

    def left_out(self, topic: str) -> Mapping[str, int]:
        """Return reason -> number of messages left out because the topic has another type or definition."""
        return self._channels[topic].left_out()


def _unpacked(source: Source, wanted: Collection[int]) -> Iterator[tuple[int, Bytes, Messages]]:
    """Yield (channel id, buffer, messages) for each wanted channel of each batch in a file.

    Messages that were compressed one by one come in several portions, since 300 kB of them can unpack to
    gigabytes.
    """
    for batch in source.batches(wanted):
        for ident, messages in batch.messages.items():
            for data, unpacked in unpack(batch.data, messages):
                yield ident, data, unpacked


def _alternating(source: Source, idents: Sequence[int]) -> list[int]:
    """Return the message counts of the two largest channels of `idents` if they take turns in time; else [].

    Two channels with mostly equal messages do not count.
    """
    times: dict[int, list[Ints]] = {ident: [] for ident in idents}
    seen: dict[int, set[int]] = {ident: set() for ident in idents}
    for ident, data, messages in _unpacked(source, idents):
        times[ident].append(messages.log_time)
        ends = (messages.start + messages.length).tolist()
        seen[ident] |= {hash(data[a:b].tobytes()) for a, b in zip(messages.start.tolist(), ends, strict=True)}
    counts = {ident: sum(map(len, times[ident])) for ident in idents}
    most, second = sorted(idents, key=lambda ident: -counts[ident])[:2]
    who = np.repeat([most, second], [counts[most], counts[second]])
    when = np.concatenate([*times[most], *times[second]]) if counts[second] else np.empty(0, np.int64)
    changes = int((np.diff(who[np.argsort(when, kind="stable")]) != 0).sum())
    alone = 2 * len(seen[most] & seen[second]) < len(seen[second])
    return [counts[most], counts[second]] if alone and changes >= max(counts[second], MIN_CHANGES) else []


def _at_first(edge: FrameEdge) -> transforms.Transform:
    """Return the transform of `edge` with its first recorded value."""
    return transforms.Transform(edge.parent, edge.child, transforms.matrices_of(edge.values[:1])[0])


def _is_static_tf(name: str, topic: Topic) -> bool:
    return name.rpartition("/")[2] == "tf_static" and topic.msgtype in TF_TYPES and not topic.problem
