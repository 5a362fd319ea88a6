"""A sample log written anew: its messages in another order, or without one topic."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from locfuse import sample_logs


def rewritten(target: Path, seed: int | None, without: str | None = None, name: str = "rounded_rectangle") -> Path:
    """The sample log with its messages at other positions in the file, or without one topic."""
    with sample_logs.path(name).open("rb") as source, target.open("wb") as sink:
        reader = make_reader(source)
        writer: Any = Writer(sink, compression=CompressionType.NONE, chunk_size=20_000)
        writer.start()
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        messages = list(reader.iter_messages(log_time_order=False))
        if seed is not None:
            np.random.default_rng(seed).shuffle(messages)
        for schema, channel, message in messages:
            assert schema is not None
            if channel.topic == without:
                continue
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id]
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        for attachment in reader.iter_attachments():
            writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)
        writer.finish()
    return target
