"""From a channel to the decoder of its messages: one entry per encoding."""

from __future__ import annotations

from collections.abc import Callable

from locfuse.formats.container.source import ChannelInfo

from .schema import MessageDecoder, SchemaError


def encoding_problem(channel: ChannelInfo) -> str | None:
    """Return why a channel's messages cannot be read at all, None if they can."""
    if channel.encoding not in ENCODINGS:
        return f"its messages are encoded as {channel.encoding!r}; {', '.join(ENCODINGS)} are read"
    languages = ENCODINGS[channel.encoding][0]
    if channel.schema_encoding not in languages:
        found = f"described in {channel.schema_encoding!r}" if channel.schema_encoding else "not described"
        return f"its type is {found}; for {channel.encoding} {' and '.join(languages)} are read"
    return None


def make_decoder(channel: ChannelInfo) -> MessageDecoder:
    """Return the decoder of a channel's messages. Raises SchemaError with the reason if there is none."""
    problem = encoding_problem(channel)
    if problem:
        raise SchemaError(problem)
    return ENCODINGS[channel.encoding][1](channel)


def _cdr(channel: ChannelInfo) -> MessageDecoder:
    from .cdr import CDR, Decoder
    from .schema import parse

    return Decoder(parse(channel.msgtype, channel.schema_encoding, _text(channel)), CDR)


def _ros1(channel: ChannelInfo) -> MessageDecoder:
    from .cdr import ROS1, Decoder
    from .schema import parse

    return Decoder(parse(channel.msgtype, channel.schema_encoding, _text(channel), filler=False), ROS1)


def _json(channel: ChannelInfo) -> MessageDecoder:
    from .json_messages import JsonDecoder, parse_jsonschema

    return JsonDecoder(parse_jsonschema(channel.msgtype, _text(channel)))


def _protobuf(channel: ChannelInfo) -> MessageDecoder:
    from .protobuf_messages import ProtobufDecoder, parse_descriptors

    return ProtobufDecoder(*parse_descriptors(channel.msgtype, channel.schema))


def _text(channel: ChannelInfo) -> str:
    return channel.schema.decode("utf-8", "replace")


ENCODINGS: dict[str, tuple[tuple[str, ...], Callable[[ChannelInfo], MessageDecoder]]] = {
    "cdr": (("ros2msg", "ros2idl"), _cdr),
    "ros1": (("ros1msg",), _ros1),
    "json": (("jsonschema",), _json),
    "protobuf": (("protobuf",), _protobuf),
}
