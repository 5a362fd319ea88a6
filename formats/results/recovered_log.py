"""Copying of a log's messages; recovery of a damaged log as a valid MCAP with all readable messages.

The copy has chunks, indexes and checksums; its metadata lists the losses of the damaged log.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import msgspec

from locfuse.formats.container.mcap_write import LATCHED, add_messages, open_writer
from locfuse.formats.logs.log import Log
from locfuse.formats.text import writable
from locfuse.formats.whole_files import whole_file
from locfuse.fusion.data import LocfuseError

NOTE = "locfuse recover"  # name of the metadata record
CLOCKLESS_LOG_NS = 0  # log time of a message from before 1970
END_OF_TIME = 2**63 - 1  # ns


class Recovered(msgspec.Struct, frozen=True):
    """The result of a recovery."""

    path: Path
    messages: dict[str, int]  # topic -> number
    lost: tuple[str, ...]  # one line for each file and reason


def recover(log: Log, path: Path) -> Recovered:
    """Write all readable messages of a log to an MCAP at `path`. Raises LocfuseError if none is readable."""
    encodings = {topic.encoding for topic in log.topics.values()}
    with whole_file(path) as temporary, temporary.open("wb") as file:
        writer = open_writer(file, "ros1" if encodings == {"ros1"} else "ros2")
        for name, data in log.attachments.items():
            writer.add_attachment(0, 0, name, "application/octet-stream", data)
        counts = copy_messages(writer, log)
        if not counts:
            why = f": {log.losses.lines()[0]}" if log.losses else ""
            raise LocfuseError(f"{log.name}: not one message can be read{why}")
        lines = tuple(log.losses.lines())
        writer.add_metadata(
            NOTE,
            {
                "input": ", ".join(writable(file.name) for file in log.paths),
                "messages": str(counts.total()),
                "lost": "; ".join(map(writable, lines)),
                "lost_messages": str(log.losses.messages),
                "lost_bytes": str(log.losses.bytes),
            },
        )
        writer.finish()
    return Recovered(path, dict(sorted(counts.items())), lines)


def copy_messages(writer: Any, log: Log) -> Counter[str]:
    """Copy every message of a log with its bytes, times and order; return topic -> number of messages."""
    schemas: dict[tuple[str, str, bytes], int] = {}
    channels: dict[tuple[str, str, int], int] = {}
    counts: Counter[str] = Counter()
    for channel, data, messages in log.messages():
        schema = (channel.msgtype, channel.schema_encoding, channel.schema)
        if schema not in schemas:
            schemas[schema] = writer.register_schema(*schema) if channel.schema_encoding else 0
        key = (channel.topic, channel.encoding, schemas[schema])
        if key not in channels:
            once = channel.n == 1 or channel.topic.endswith("tf_static")  # such topics are latched
            channels[key] = writer.register_channel(*key, {"offered_qos_profiles": LATCHED if once else ""})
        ends = (messages.start + messages.length).tolist()
        payload = [data[a:b].data for a, b in zip(messages.start.tolist(), ends, strict=True)]
        log_time = messages.log_time.clip(CLOCKLESS_LOG_NS, END_OF_TIME)
        published = messages.published.clip(CLOCKLESS_LOG_NS, END_OF_TIME)
        add_messages(writer, channels[key], log_time, messages.sequence, payload, published)
        counts[channel.topic] += len(messages.start)
    return counts
