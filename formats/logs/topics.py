"""The topics of a log over all its files: what each is, and which channels carry it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple, Self

import msgspec

from locfuse.formats.container.source import ChannelInfo, Source, message_type
from locfuse.formats.messages.decode import encoding_problem, make_decoder
from locfuse.formats.messages.decoded import MessageDecoder
from locfuse.formats.messages.schema import SchemaError, signature
from locfuse.fusion.data import LocfuseError


class UnreadableTopicError(LocfuseError):
    """The messages of a topic cannot be decoded; `problem` says why without saying again of which topic."""

    problem: str = ""

    @classmethod
    def of(cls, log: str, topic: str, problem: str) -> Self:
        """Return the error for raising."""
        error = cls(f"{log}: {topic} cannot be read: {problem}")
        error.problem = problem
        return error


class Topic(msgspec.Struct, frozen=True):
    """One topic of a log, over all its files."""

    msgtype: str  # pkg/msg/Name
    count: int
    encoding: str  # of the messages
    schema_encoding: str
    problem: str | None = None  # why it cannot be read, None = it can


class Carrier(NamedTuple):
    """One channel of one file that carries a topic."""

    source: Source
    ident: int  # in that file
    channel: ChannelInfo


class TopicChannels:
    """All channels of one topic. The busiest says what the topic is; what is of another kind is left out."""

    def __init__(self, carriers: Sequence[Carrier]) -> None:
        self.carriers = sorted(carriers, key=lambda carrier: -(carrier.channel.n or 0))
        main = self.carriers[0].channel
        count = sum(c.channel.n or 0 for c in self.carriers if _same_kind(c.channel, main))
        problem = encoding_problem(main)
        self.topic = Topic(message_type(main.msgtype), count, main.encoding, main.schema_encoding, problem)

    @property
    def decoder(self) -> MessageDecoder:
        """What decodes the topic. Raises SchemaError where its definition cannot be used."""
        return self._decoders[0][1]

    @cached_property
    def _decoders(self) -> list[tuple[Carrier, MessageDecoder]]:
        """The channels that are read: those of the busiest one's type and structure."""
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
        """Return channel id -> decoder for the channels of one file that are read."""
        return {carrier.ident: decoder for carrier, decoder in self._decoders if carrier.source is source}

    def left_out(self) -> Counter[str]:
        """Count the messages on the topic that are of another type or definition than the rest, by reason."""
        read = [carrier for carrier, _ in self._decoders]
        counts: Counter[str] = Counter()
        for carrier in self.carriers:
            if not any(carrier is one for one in read) and carrier.channel.n:
                other = message_type(carrier.channel.msgtype)
                what = other if other != self.topic.msgtype else "another definition"
                counts[f"of {what}"] += carrier.channel.n
        return counts


def by_topic(sources: Sequence[Source]) -> Mapping[str, TopicChannels]:
    """Return topic -> its channels in all files, by topic name."""
    carriers: dict[str, list[Carrier]] = {}
    for source in sources:
        for ident, channel in source.channels.items():
            carriers.setdefault(channel.topic, []).append(Carrier(source, ident, channel))
    return {topic: TopicChannels(carriers[topic]) for topic in sorted(carriers)}


def _same_kind(one: ChannelInfo, other: ChannelInfo) -> bool:
    return (message_type(one.msgtype), one.encoding) == (message_type(other.msgtype), other.encoding)
