"""A log written anew: its messages in another order, changed, or some of them left out."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from locfuse import sample_logs

Keep = Callable[[str, float], bool]  # of a message: its topic, and s since the first message


def rewritten(
    target: Path,
    seed: int | None = None,
    without: str | None = None,
    name: str = "rounded_rectangle",
    *,
    source: Path | None = None,
    robot: str | Callable[[str], str] | None = None,
    keep: Keep = lambda topic, t: True,
    data: Callable[[str, bytes], bytes] = lambda topic, data: data,
) -> Path:
    """A sample log, or the log `source`, without one topic or what is not to be kept, in another order.

    `robot`: a robot.toml of its own, or what is made of the one that was there; `data`: what a message then holds.
    """
    with (source or sample_logs.path(name)).open("rb") as log, target.open("wb") as sink:
        reader = make_reader(log)
        writer: Any = Writer(sink, compression=CompressionType.NONE, chunk_size=20_000)
        writer.start()
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        messages = list(reader.iter_messages(log_time_order=False))
        begin = min(m.log_time for _, _, m in messages)
        if seed is not None:
            np.random.default_rng(seed).shuffle(messages)
        for schema, channel, m in messages:
            assert schema is not None
            if channel.topic == without or not keep(channel.topic, (m.log_time - begin) * 1e-9):
                continue
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id]
                )
            new = data(channel.topic, m.data)
            writer.add_message(channels[channel.id], m.log_time, new, m.publish_time, m.sequence)
        texts = {a.name: (a.media_type, a.data) for a in reader.iter_attachments()}
        if robot is not None:
            old = texts.get("robot.toml", ("", b""))[1].decode()
            texts["robot.toml"] = "application/toml", (robot if isinstance(robot, str) else robot(old)).encode()
        for file, (kind, text) in texts.items():
            writer.add_attachment(0, 0, file, kind, text)
        writer.finish()
    return target
