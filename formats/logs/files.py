"""The files of a log (one .mcap, several, or a rosbag2 directory), and the channels of its topics."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatch
from functools import cached_property
from itertools import takewhile, zip_longest
from pathlib import Path
from typing import NamedTuple

import msgspec

from locfuse.formats.container.decompress import ZSTD_MAGIC, unpack_file
from locfuse.formats.container.file_bytes import FileBytes, Losses, Place, Url
from locfuse.formats.container.mcap_records import MAGIC
from locfuse.formats.container.mcap_source import McapSource
from locfuse.formats.container.mcap_survey import summary_section
from locfuse.formats.container.source import ChannelInfo, Source, message_type
from locfuse.formats.inputs import MAX_METADATA, read_small, reading
from locfuse.formats.messages.cdr import CDR, ROS1, Decoder
from locfuse.formats.messages.schema import MessageDecoder, SchemaError, parse, signature
from locfuse.formats.text import writable
from locfuse.fusion.data import LocfuseError, UsageError

# of log files in a folder without metadata.yaml
ENDINGS = ("*.mcap", "*.mcap.zstd", "*.db3", "*.db3.zstd", "*.bag")
REPORTS = ("report.json", "run.json")  # files of a result folder
UNNAMED = "log"  # name for a file like "...mcap", whose stem ".." would be another folder


def log_files(path: Place) -> list[Place]:
    """Return the files of a log; `path` is a file, a rosbag2 folder or its metadata.yaml, or a URL."""
    if isinstance(path, Url):
        if not path.is_folder:
            return [path]
        from locfuse.formats.container.remote_objects import below

        if files := _by_ending(f for f in below(path) if f.parent.key.rstrip("/") == path.key.rstrip("/")):
            return files
        raise LocfuseError(f"{path}: no log in this folder (.mcap, .db3, .bag); all logs below it: --each {path}")
    with reading(path):
        if not path.exists():
            raise UsageError(f"{path}: no such file or folder")
        if path.is_dir():
            return _folder(path)
        return _folder(path.parent) if path.name == "metadata.yaml" else [path]


def _folder(folder: Path) -> list[Place]:
    listed = [folder / name for name in _listed(folder / "metadata.yaml")]
    files: list[Place] = [file for file in listed if file.is_file()]
    if files := files or _by_ending(sorted(file for file in folder.iterdir() if file.is_file())):
        return files
    if any((folder / name).exists() for name in REPORTS):
        raise LocfuseError(f"{folder} is a locfuse result, not a log; see: locfuse view {folder}")
    raise LocfuseError(f"{folder}: no log in this folder (.mcap, .db3, .bag)")


def _by_ending(files: Iterable[Place]) -> list[Place]:
    """Return the files with the first ending in ENDINGS that occurs; [] if none occurs."""
    files = list(files)
    found = ([file for file in files if fnmatch(file.name, ending)] for ending in ENDINGS)
    return next(filter(None, found), [])


def _listed(metadata: Path) -> list[str]:
    """Return the file names listed in a rosbag2 metadata.yaml; [] if it is missing, as after a crash."""
    if not metadata.is_file():  # a pipe would never end
        return []
    text = read_small(metadata, MAX_METADATA).decode("utf-8", "replace")
    lines = iter(text.splitlines())
    if not any(line.strip() == "relative_file_paths:" for line in lines):
        return []
    entries = takewhile(lambda line: line.startswith("- "), map(str.strip, lines))
    listed = [Path(entry[2:].strip().strip("'\"")).name for entry in entries]
    return [name for given in listed for name in (given, f"{given}.zstd")]  # some versions omit .zstd


def log_name(paths: Sequence[Place]) -> str:
    """Return the name of a log: its file name without ending, or its folder's name."""
    first = paths[0].parent if paths[0].name == "metadata.yaml" else paths[0]
    folder = first.is_folder if isinstance(first, Url) else first.is_dir()
    whole = first.name if isinstance(first, Url) else first.resolve().name
    name = whole if folder else Path(first.name.removesuffix(".zstd")).stem
    return writable(name) if name.strip(".") else UNNAMED


def open_source(file: Place, losses: Losses) -> Source:
    """Open one file of a log; its first bytes determine its format."""
    with reading(file):
        if isinstance(file, Path):
            data = FileBytes(file, losses)
        else:
            from locfuse.formats.container.remote_objects import RemoteBytes

            data = RemoteBytes(file, losses)
        if data.far and data.read(max(data.size - len(MAGIC), 0), len(MAGIC)) != MAGIC:
            data.copy_here()  # not a complete MCAP, so it has no index
        if not data.far and data.read(0, len(ZSTD_MAGIC)) == ZSTD_MAGIC:
            unpack_file(data)
        head = b"" if data.far else data.read(0, 64)
        if head.startswith(b"SQLite format 3\x00"):
            from locfuse.formats.container.rosbag2_sqlite import SqliteSource

            return SqliteSource(data)
        if head.startswith(b"#ROSBAG V2.0\n"):
            from locfuse.formats.container.ros1_bag import BagSource

            return BagSource(data)
        return McapSource(data)  # raises for another kind of file


# --- Identity of a log's content without reading all of it: sizes, and a hash of the summary of each file
# The summary section of an MCAP lists every chunk with its offset, size and times, so two recordings with equal
# summaries are copies. A file without a summary is identified by its size and the bytes at both ends. A change of
# other bytes is detected only with `--hash`, or by the file's time (`locfuse compare` over many logs).

END_BYTES = 1 << 16  # hashed at the beginning and at the end of a file without a summary


class Identity(NamedTuple):
    """Content hash and size that identify a log."""

    size: int  # bytes of all files
    digest: str  # hexadecimal


def files_of(paths: Sequence[Place]) -> list[Place]:
    """Return the files of all paths, sorted by file name."""
    return sorted({file for path in paths for file in log_files(path)}, key=lambda file: (file.name, str(file)))


def identity_of(files: Sequence[Place], states: Sequence[tuple[int, str] | None] = ()) -> Identity:
    """Return the identity of a log from its files. Raises LocfuseError for an unreadable file.

    `states` are size and ETag of each remote file; missing ones are requested from the server.
    """
    digest, total = hashlib.sha256(), 0
    for file, state in zip_longest(files, states):
        if isinstance(file, Url):
            from locfuse.formats.container.remote_objects import state_of

            size, tag = state or state_of(file)
            kind, content = "etag", tag.encode()
        else:
            data = FileBytes(file, Losses())
            kind, size, section = "summary", data.size, summary_section(data)
            if section is None:
                kind, section = "ends", data.read(0, END_BYTES) + data.read(max(size - END_BYTES, 0), END_BYTES)
            content = section
        digest.update(f"{kind} {size} {len(content)}\n".encode() + content)
        total += size
    return Identity(total, digest.hexdigest())


# --- The channels of a log's topics, and the decoders of their messages

LANGUAGES = {  # encoding of messages -> languages of their definitions
    "cdr": ("ros2msg", "ros2idl"),
    "ros1": ("ros1msg",),
    "json": ("jsonschema",),
    "protobuf": ("protobuf",),
}


def encoding_problem(channel: ChannelInfo) -> str | None:
    """Return the reason why a channel's encoding cannot be read; None if it can."""
    if channel.encoding not in LANGUAGES:
        return f"its messages are encoded as {channel.encoding!r}; {', '.join(LANGUAGES)} are read"
    languages = LANGUAGES[channel.encoding]
    if channel.schema_encoding not in languages:
        found = f"described in {channel.schema_encoding!r}" if channel.schema_encoding else "not described"
        return f"its type is {found}; for {channel.encoding} {' and '.join(languages)} are read"
    return None


def make_decoder(channel: ChannelInfo) -> MessageDecoder:
    """Return the decoder of a channel's messages. Raises SchemaError if encoding or definition is unsupported."""
    if problem := encoding_problem(channel):
        raise SchemaError(problem)
    if channel.encoding == "protobuf":
        from locfuse.formats.messages.protobuf_messages import ProtobufDecoder, parse_descriptors

        return ProtobufDecoder(*parse_descriptors(channel.msgtype, channel.schema))
    text = channel.schema.decode("utf-8", "replace")
    if channel.encoding == "json":
        from locfuse.formats.messages.json_messages import JsonDecoder, parse_jsonschema

        return JsonDecoder(parse_jsonschema(channel.msgtype, text))
    rules = ROS1 if channel.encoding == "ros1" else CDR
    return Decoder(parse(channel.msgtype, channel.schema_encoding, text, filler=rules is CDR), rules)


# --- The channels of one topic, over all files


class Topic(msgspec.Struct, frozen=True):
    """One topic of a log, over all its files."""

    msgtype: str  # pkg/msg/Name
    count: int
    encoding: str  # of the messages
    schema_encoding: str
    problem: str | None = None  # reason why the messages cannot be decoded; None if they can


class Carrier(NamedTuple):
    """One channel of one file that carries a topic."""

    source: Source
    ident: int  # channel id in this file
    channel: ChannelInfo


class TopicChannels:
    """All channels of a topic.

    The type of the topic is that of the channel with most messages. Channels of other types are left out.
    """

    def __init__(self, carriers: Sequence[Carrier]) -> None:
        self.carriers = sorted(carriers, key=lambda carrier: -(carrier.channel.n or 0))
        main = self.carriers[0].channel
        self.of_type = [carrier for carrier in self.carriers if _same_kind(carrier.channel, main)]
        count = sum(carrier.channel.n or 0 for carrier in self.of_type)
        problem = encoding_problem(main)
        self.topic = Topic(message_type(main.msgtype), count, main.encoding, main.schema_encoding, problem)

    @property
    def decoder(self) -> MessageDecoder:
        """The decoder of the topic. Raises SchemaError if its definition cannot be used."""
        return self._decoders[0][1]

    @cached_property
    def _decoders(self) -> list[tuple[Carrier, MessageDecoder]]:
        """The channels with the type and message structure of the topic, with their decoders."""
        made: dict[ChannelInfo, MessageDecoder] = {}
        found: list[tuple[Carrier, MessageDecoder]] = []
        for carrier in self.of_type:
            key = carrier.channel._replace(n=None)
            if key not in made:
                try:
                    made[key] = make_decoder(carrier.channel)
                except SchemaError:
                    if not found:
                        raise
                    continue
            if not found or signature(made[key].message) == signature(found[0][1].message):
                found.append((carrier, made[key]))
        return found

    def of(self, source: Source) -> dict[int, MessageDecoder]:
        """Return channel id -> decoder for the readable channels of one file."""
        return {carrier.ident: decoder for carrier, decoder in self._decoders if carrier.source is source}

    def left_out(self) -> Counter[str]:
        """Return reason -> number of messages left out because the topic has another type or definition."""
        read = [carrier for carrier, _ in self._decoders]
        counts: Counter[str] = Counter()
        for carrier in self.carriers:
            if not any(carrier is one for one in read) and carrier.channel.n:
                other = message_type(carrier.channel.msgtype)
                what = other if other != self.topic.msgtype else "another definition"
                counts[f"of {what}"] += carrier.channel.n
        return counts


def by_topic(sources: Sequence[Source]) -> Mapping[str, TopicChannels]:
    """Return the channels of each topic in all files, by topic name."""
    carriers: dict[str, list[Carrier]] = {}
    for source in sources:
        for ident, channel in source.channels.items():
            carriers.setdefault(channel.topic, []).append(Carrier(source, ident, channel))
    return {topic: TopicChannels(carriers[topic]) for topic in sorted(carriers)}


def _same_kind(one: ChannelInfo, other: ChannelInfo) -> bool:
    return (message_type(one.msgtype), one.encoding) == (message_type(other.msgtype), other.encoding)
