"""The channels of a log's topics, and the decoders of their messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import msgspec

from locfuse.formats.container.source import ChannelInfo, Source, message_type
from locfuse.formats.messages.cdr import CDR, ROS1, Decoder
from locfuse.formats.messages.json_messages import JsonDecoder, parse_jsonschema
from locfuse.formats.messages.protobuf_messages import ProtobufDecoder, parse_descriptors
from locfuse.formats.messages.schema import MessageDecoder, SchemaError, parse, signature

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
        return ProtobufDecoder(*parse_descriptors(channel.msgtype, channel.schema))
    text = channel.schema.decode("utf-8", "replace")
    if channel.encoding == "json":
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
        count = sum(c.channel.n or 0 for c in self.carriers if _same_kind(c.channel, main))
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
        for carrier in self.carriers:
            key = carrier.channel._replace(n=None)
            if not _same_kind(carrier.channel, self.carriers[0].channel):
                continue
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
