"""What a schema's name means: how its messages are encoded, and the description others need."""

from __future__ import annotations

import importlib
import json
from functools import lru_cache

from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from wire.generated.telepresence.v1 import telepresence_pb2

JSON_STRING = {
    "title": "std_msgs/msg/String",
    "type": "object",
    "properties": {"data": {"type": "string"}},
}


def is_json(schema: str) -> bool:
    """Return whether messages of a schema are JSON: its name then has slashes, as in ROS."""
    return "/" in schema


@lru_cache(maxsize=256)
def schema_data(schema: str) -> tuple[str, bytes]:
    """Return encoding and bytes of a schema as MCAP embeds it; ("", b"") for an unknown name."""
    if is_json(schema):
        known = schema == JSON_STRING["title"]
        return "jsonschema", json.dumps(JSON_STRING if known else {"type": "object"}).encode()
    descriptor = _file_of(schema)
    if descriptor is None:
        return "", b""
    files = FileDescriptorSet()
    _collect(descriptor, files, seen=set())
    return "protobuf", files.SerializeToString()


def _file_of(schema: str) -> FileDescriptor | None:
    package, _, name = schema.rpartition(".")
    if package == "telepresence.v1" and name in telepresence_pb2.DESCRIPTOR.message_types_by_name:
        return telepresence_pb2.DESCRIPTOR
    if package != "foxglove" or not name.isidentifier():
        return None
    try:
        module = importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2")
    except ModuleNotFoundError:
        return None
    descriptor: FileDescriptor = module.DESCRIPTOR
    return descriptor


def _collect(file: FileDescriptor, files: FileDescriptorSet, *, seen: set[str]) -> None:
    if file.name in seen:
        return
    seen.add(file.name)
    for dependency in file.dependencies:
        _collect(dependency, files, seen=seen)
    file.CopyToProto(files.file.add())
