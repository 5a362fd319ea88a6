"""Which decoder a channel gets, and why one gets none."""

from __future__ import annotations

import json

import pytest
from google.protobuf import descriptor_pb2, timestamp_pb2

from locfuse.formats.container.source import ChannelInfo
from locfuse.formats.messages.cdr import CDR, ROS1, Decoder
from locfuse.formats.messages.decode import encoding_problem, make_decoder
from locfuse.formats.messages.json_messages import JsonDecoder
from locfuse.formats.messages.protobuf_messages import ProtobufDecoder
from locfuse.formats.messages.schema import SchemaError

IDL = b"module t { module msg { struct A { uint8 a; }; }; };"
JSON = json.dumps({"type": "object", "properties": {"a": {"type": "number"}}}).encode()
DESCRIBED = descriptor_pb2.FileDescriptorProto()
timestamp_pb2.DESCRIPTOR.CopyToProto(DESCRIBED)
TIME = descriptor_pb2.FileDescriptorSet(file=[DESCRIBED]).SerializeToString()


def channel(encoding: str, language: str, schema: bytes = b"uint8 a\n", msgtype: str = "t/A") -> ChannelInfo:
    return ChannelInfo("/a", msgtype, encoding, language, schema, 0)


@pytest.mark.parametrize(
    ("info", "kind"),
    [
        (channel("cdr", "ros2msg"), Decoder),
        (channel("cdr", "ros2idl", IDL, "t/msg/A"), Decoder),
        (channel("ros1", "ros1msg"), Decoder),
        (channel("json", "jsonschema", JSON), JsonDecoder),
        (channel("protobuf", "protobuf", TIME, "google.protobuf.Timestamp"), ProtobufDecoder),
    ],
)
def test_every_encoding_has_its_decoder(info: ChannelInfo, kind: type) -> None:
    assert encoding_problem(info) is None
    found = make_decoder(info)
    assert isinstance(found, kind)
    if isinstance(found, Decoder):
        assert found.rules is (ROS1 if info.encoding == "ros1" else CDR)


@pytest.mark.parametrize(
    ("info", "words"),
    [
        (channel("flatbuffer", "ros2msg"), "encoded as 'flatbuffer'; cdr, ros1, json, protobuf are read"),
        (channel("cdr", "ros1msg"), "described in 'ros1msg'; for cdr ros2msg and ros2idl are read"),
        (channel("cdr", ""), "its type is not described; for cdr ros2msg and ros2idl are read"),
        (channel("json", "protobuf"), "described in 'protobuf'; for json jsonschema are read"),
    ],
)
def test_what_cannot_be_decoded_says_why(info: ChannelInfo, words: str) -> None:
    problem = encoding_problem(info)
    assert problem is not None
    assert words in problem
    with pytest.raises(SchemaError, match="are read"):
        make_decoder(info)
