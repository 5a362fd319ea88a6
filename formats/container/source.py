"""The common interface of log files: channels, and batches of raw messages in one buffer.

A batch is about one chunk, so memory use is bounded; its messages are columns of offsets into the buffer, so that
decoding can gather a field of all messages at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from locfuse.formats.columns import Bytes
from locfuse.fusion.data import Ints

from .file_bytes import FileBytes


class ChannelInfo(NamedTuple):
    """One channel of one file. Channels with the same topic are one stream."""

    topic: str
    msgtype: str  # as written in the file
    encoding: str  # of the messages: cdr, json, ros1, protobuf
    schema_encoding: str  # ros2msg, ros2idl, ros1msg, jsonschema, protobuf
    schema: bytes
    n: int | None  # number of messages; None where the file does not store it


class Messages(NamedTuple):
    """The messages of one channel in one batch, in file order."""

    start: Ints  # (k,) offset of the first payload byte in the batch's buffer
    length: Ints  # (k,) number of payload bytes
    log_time: Ints  # (k,) ns
    sequence: Ints  # (k,)
    published: Ints  # (k,) publish times, ns; the log times if the file stores none

    def take(self, rows: NDArray[Any] | slice) -> Messages:
        """Return the messages of these rows: indices, a mask or a slice."""
        return Messages(*(column[rows] for column in self))


def by_channel(channel: Ints, everything: Messages) -> dict[int, Messages]:
    """Group messages by channel id (k,)."""
    return {int(ident): everything.take(channel == ident) for ident in np.unique(channel)}


class Batch(NamedTuple):
    """Messages that were read and decompressed together."""

    data: Bytes
    messages: dict[int, Messages]  # by channel id


class Source(ABC):
    """One file of a log; damaged parts are skipped and recorded as losses."""

    channels: Mapping[int, ChannelInfo]  # by id

    def __init__(self, data: FileBytes) -> None:
        self.path = data.path
        self.data = data

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Attachments by name."""
        return {}

    @property
    def checked(self) -> bool:
        """Whether the file has checksums that reveal a changed value."""
        return False

    @property
    @abstractmethod
    def time_span_ns(self) -> tuple[int, int] | None:
        """First and last log time [ns]; None without messages."""

    @abstractmethod
    def batches(self, wanted: Collection[int]) -> Iterator[Batch]:
        """Yield the messages of the wanted channels in file order, the same at every call."""


def message_type(name: str) -> str:
    """Return a ROS type name in the form "pkg/msg/Name"; "pkg/Name" and "pkg::msg::Name" are converted."""
    parts = name.replace("::", "/").split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else "/".join(parts)
