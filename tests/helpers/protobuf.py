"""Protobuf messages for tests, built by Google's library from JSON schemas: it knows nothing of our reader."""

from __future__ import annotations

from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory, timestamp_pb2

KINDS = descriptor_pb2.FieldDescriptorProto
TIME = {"sec", "nsec"}


class Definition:
    """A message type made of the properties of a JSON schema."""

    def __init__(self, name: str, properties: dict[str, Any]) -> None:
        self.pool = descriptor_pool.DescriptorPool()
        self.files = descriptor_pb2.FileDescriptorSet()
        timestamp_pb2.DESCRIPTOR.CopyToProto(self.files.file.add())
        package, _, short = name.rpartition(".")
        file = self.files.file.add(name="made.proto", package=package, syntax="proto3")
        file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
        self._add(file.message_type.add(name=short), name, properties)
        for one in self.files.file:
            self.pool.Add(one)
        self.type: Any = message_factory.GetMessageClass(self.pool.FindMessageTypeByName(name))

    def _add(self, message: Any, full: str, properties: dict[str, Any]) -> None:
        for number, (name, said) in enumerate(properties.items(), 1):
            repeated = said.get("type") == "array"
            schema = said["items"] if repeated else said
            label = KINDS.LABEL_REPEATED if repeated else KINDS.LABEL_OPTIONAL
            field = message.field.add(name=name, number=number, label=label)
            inside = schema.get("properties")
            if schema.get("contentEncoding") == "base64":
                field.type = KINDS.TYPE_BYTES
            elif inside is None:
                field.type = {"string": KINDS.TYPE_STRING, "integer": KINDS.TYPE_FIXED32}.get(
                    schema["type"], KINDS.TYPE_DOUBLE
                )
            else:
                field.type = KINDS.TYPE_MESSAGE
                field.type_name = ".google.protobuf.Timestamp" if set(inside) == TIME else f".{full}.In{number}"
                if set(inside) != TIME:
                    self._add(message.nested_type.add(name=f"In{number}"), f"{full}.In{number}", inside)

    @property
    def schema(self) -> bytes:
        """The FileDescriptorSet that an MCAP file carries."""
        return bytes(self.files.SerializeToString())

    def message(self, values: dict[str, Any]) -> bytes:
        """Return values as a message; None is NaN, as where JSON has no word for it."""
        made = self.type()
        json_format.ParseDict(_json(values), made, descriptor_pool=self.pool)
        return bytes(made.SerializeToString())


def _json(value: Any) -> Any:
    """Return a value as Protobuf's own JSON: times are texts."""
    if isinstance(value, dict) and set(value) == TIME:
        return timestamp_pb2.Timestamp(seconds=value["sec"], nanos=value["nsec"]).ToJsonString()
    if isinstance(value, dict):
        return {key: _json(one) for key, one in value.items()}
    if isinstance(value, list):
        return ["NaN" if one is None else _json(one) for one in value]
    return value
