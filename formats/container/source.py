"""The common interface of log files: channels, and batches of raw messages in one buffer.

A batch is one chunk, so memory stays flat; its messages are columns of offsets into the buffer, so that
decoding can gather a field of all messages at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Ints

from .file_bytes import FileBytes
from .losses import Losses


class ChannelInfo(NamedTuple):
    """One channel of one file. Channels with the same topic are one stream."""

    topic: str
    msgtype: str  # as the file spells it
    encoding: str  # of the messages: cdr, json, ros1, protobuf
    schema_encoding: str  # ros2msg, ros2idl, ros1msg, jsonschema, protobuf
    schema: bytes
    n: int | None  # messages, where the file knows


class Messages(NamedTuple):
    """The messages of one channel in one batch, in file order."""

    start: Ints  # (k,) first payload byte in the batch's buffer
    length: Ints  # (k,) payload bytes
    log_time: Ints  # (k,) ns
    sequence: Ints  # (k,)

    def take(self, rows: NDArray[Any] | slice) -> Messages:
        """Return the given rows."""
        return Messages(*(column[rows] for column in self))


def by_channel(channel: Ints, everything: Messages) -> dict[int, Messages]:
    """Group messages by their channels (k,)."""
    return {int(ident): everything.take(channel == ident) for ident in np.unique(channel)}


class Batch(NamedTuple):
    """Messages that were read and decompressed together."""

    data: NDArray[np.uint8]
    messages: dict[int, Messages]  # by channel id


class Source(ABC):
    """One file of a log; damage is counted and left out."""

    channels: Mapping[int, ChannelInfo]  # by id

    def __init__(self, data: FileBytes, losses: Losses) -> None:
        self.path = data.path
        self.losses = losses
        self.data = data

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Attachments by name."""
        return {}

    @property
    def checked(self) -> bool:
        """Whether a changed value would be noticed, by checksums."""
        return False

    @property
    @abstractmethod
    def time_span_ns(self) -> tuple[int, int] | None:
        """First and last log time, None without messages."""

    def published(self, data: NDArray[np.uint8], messages: Messages) -> Ints:
        """Return the publish times of a batch, ns; the log times if the file has no others."""
        return messages.log_time

    @abstractmethod
    def batches(self, wanted: Collection[int]) -> Iterator[Batch]:
        """Yield the messages of the wanted channels in file order, the same at every call."""


class Recorded(NamedTuple):
    """Messages of one channel as they are stored, decodable or not."""

    channel: ChannelInfo
    data: NDArray[np.uint8]  # the buffer they lie in
    messages: Messages
    published: Ints  # (k,) ns; the log times where the file keeps no others


def message_type(name: str) -> str:
    """Return a type name as pkg/msg/Name; it may be given as "pkg/Name" or "pkg::msg::Name"."""
    parts = name.replace("::", "/").split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else "/".join(parts)
