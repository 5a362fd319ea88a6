"""Choice of the decoder of a channel's messages, by their encoding."""

from __future__ import annotations

from locfuse.formats.container.source import ChannelInfo

from .cdr import CDR, ROS1, Decoder
from .json_messages import JsonDecoder, parse_jsonschema
from .protobuf_messages import ProtobufDecoder, parse_descriptors
from .schema import MessageDecoder, SchemaError, parse

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
