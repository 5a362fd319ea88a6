"""One number of any message as a topic of its own, "/topic:field.path", like a std_msgs/Float64."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from locfuse.fusion.data import Block, Column, Ints

from .stream import LogStream

NUMBER = "std_msgs/msg/Float64"


def field_of(name: str) -> tuple[str, str] | None:
    """Return topic and field of a name like "/status:heading.value", None for any other name."""
    parts = name.split(":")
    return (parts[0], parts[1]) if len(parts) == 2 and all(parts) else None


class NumberStream:
    """A field of a topic with the face of a topic (formats.log.stream.LogStream)."""

    msgtype = NUMBER

    def __init__(self, topic: str, source: LogStream, field: str) -> None:
        self.topic = topic
        self._source = source
        self._field = field

    @property
    def order(self) -> str:
        """The order in which the source is read."""
        return self._source.order

    @property
    def frame_id(self) -> str:
        """The frame of the first message's header, "" without one."""
        return self._source.frame_id

    @property
    def t_ns(self) -> Ints:
        """When the readings were taken, (n,), never decreasing."""
        return self._source.t_ns

    @property
    def delay_s(self) -> float | None:
        """By how much recording lags behind the header stamps, median [s]."""
        return self._source.delay_s

    @property
    def clock(self) -> str:
        """Which times were taken, in words."""
        return self._source.clock

    @property
    def by_stamps(self) -> bool:
        """Whether the times are those of the headers, sorted or repaired perhaps."""
        return self._source.by_stamps

    @property
    def as_stamped(self) -> bool:
        """Whether every time is simply its header's."""
        return self._source.as_stamped

    @property
    def repaired(self) -> Mapping[str, int]:
        """Stamps that were replaced, by reason."""
        return self._source.repaired

    @property
    def notes(self) -> tuple[str, ...]:
        """Oddities of the stream's times in words."""
        return self._source.notes

    @property
    def dropped(self) -> Mapping[str, int]:
        """Messages that are not among the rows, by reason."""
        return self._source.dropped

    def columns(self, *fields: str) -> dict[str, Column]:
        """Return the number as the column "data"."""
        values = np.asarray(self._source.columns(self._field)[self._field], dtype=np.float64)
        return dict.fromkeys(fields, values)

    def blocks(self, *fields: str, rows: int = 256) -> Iterator[Block]:
        """Yield everything as one block: numbers are light."""
        yield np.arange(len(self.t_ns)), self.columns(*fields)
