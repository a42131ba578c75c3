"""Schemas of messages that are not ROS: protobuf, and JSON with or without a JSON schema, as an MCAP holds them.

Messages become objects with the fields of their schema, as those of ROS do. A schema is needed for bytes in JSON, which are
base64, and for fields that a message leaves out: they have the default of their type, as in protobuf.

protobuf is imported for the first such message, in 20 ms.
"""

import base64
import binascii
import json
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NoReturn, cast

import numpy as np

from bagassets.base.errors import DecodeError
from bagassets.recordings.model import Definition, Message, Serialization
from bagassets.store.canonical import digest_bytes, digest_json

if TYPE_CHECKING:
    from google.protobuf.message import Message as ProtobufMessage

FOXGLOVE = "foxglove."
_ROS_PACKAGE = "foxglove_msgs/msg/"
_MISSING = object()
_DEFAULTS = {"object": {}, "array": [], "string": "", "number": 0.0, "integer": 0, "boolean": False}
_MOST_REFERENCES = 20  # of JSON, one after the other


def foxglove_type(name: str) -> str:
    """Return the type of a protobuf or JSON schema: those of Foxglove have the names of their ROS twins, others their own."""
    return f"{_ROS_PACKAGE}{name[len(FOXGLOVE) :]}" if name.startswith(FOXGLOVE) else name


@lru_cache(maxsize=256)
def schema_of(
    msgtype: str, serialization: Serialization, definition: Definition, most_elements: int
) -> "Schema | str":
    """Return how messages are read, or a clause that says why they cannot be.

    Args:
        msgtype: type of the messages.
        serialization: `protobuf` or `json`.
        definition: their schema, as `schema_definition` has it.
        most_elements: strings and nested messages that one message may hold.
    """
    try:
        if serialization == "json":
            return JsonSchema(msgtype, definition, most_elements)
        if definition.format != "protobuf":
            return f"there is no protobuf schema of {msgtype} in the recording"
        return ProtobufSchema(msgtype, definition, most_elements)
    except MemoryError:
        raise
    except Exception:  # noqa: BLE001  (a bad schema costs its topic, nothing more)
        return (
            f"the schema of {msgtype} cannot be used (it is damaged, or refers to types that are not in it)"
        )


def schema_definition(encoding: str, name: str, data: bytes) -> Definition | None:
    """Return the definition in a schema record of an MCAP; None for an encoding that is not for these messages.

    Text of a protobuf schema is the full name of its message and, in base64, a `FileDescriptorSet`.
    """
    if encoding == "protobuf":
        return Definition("protobuf", f"{name}\n{base64.b64encode(data).decode('ascii')}")
    if encoding == "jsonschema":
        return Definition("jsonschema", data.decode("utf-8", "replace"))
    return None


class ProtobufSchema:
    """A `FileDescriptorSet`, and the full name of a message in it.

    Attributes:
        digest: of everything that decides what a payload decodes to; comments do not count.
    """

    def __init__(self, msgtype: str, definition: Definition, most_elements: int) -> None:
        from google.protobuf.descriptor_pb2 import FileDescriptorSet  # noqa: PLC0415
        from google.protobuf.descriptor_pool import DescriptorPool  # noqa: PLC0415
        from google.protobuf.message_factory import GetMessageClass  # noqa: PLC0415

        self._msgtype = msgtype
        self._most = most_elements
        name, _, encoded = definition.text.partition("\n")
        files = {file.name: file for file in FileDescriptorSet.FromString(base64.b64decode(encoded)).file}
        pool = DescriptorPool()

        def add(file_name: str) -> None:
            file = files.pop(file_name, None)
            if file is not None:
                for needed in file.dependency:
                    add(needed)
                file.ClearField("source_code_info")
                contents[file_name] = digest_bytes(file.SerializeToString(deterministic=True))
                pool.Add(file)

        contents: dict[str, str] = {}
        for file_name in sorted(files):
            add(file_name)
        self._class = cast("type[ProtobufMessage]", GetMessageClass(pool.FindMessageTypeByName(name)))
        self.digest = digest_json({"type": name, "files": contents})

    def decode(self, data: bytes) -> Message:
        """Return a message; a message in it that was left out has its defaults, and `HasField` tells.

        Raises:
            DecodeError: the bytes do not fit, or hold more than `most_elements` strings and messages.
        """
        if len(data) > 2 * self._most:  # each takes a tag and a length at least
            self._check(data)
        try:
            return cast("Message", self._class.FromString(data))
        except Exception as err:  # protobuf has errors of its own in each implementation
            raise DecodeError(f"its bytes do not fit {self._msgtype}") from err

    def _check(self, data: bytes) -> None:
        """Count strings and messages before objects are made of them.

        Raises:
            DecodeError: there are too many.
        """
        left = self._most
        waiting = [(self._class.DESCRIPTOR, memoryview(data))]
        try:
            while waiting:
                descriptor, message = waiting.pop()
                for number, value in _fields_in(message):
                    field = descriptor.fields_by_number.get(number)
                    if field is None or field.type not in {
                        field.TYPE_STRING,
                        field.TYPE_MESSAGE,
                        field.TYPE_BYTES,
                    }:
                        continue
                    left -= 1
                    if left < 0:
                        raise DecodeError(
                            "its lists hold more than limits.message_elements in the recipe allows"
                        )
                    if field.message_type is not None:
                        waiting.append((field.message_type, value))
        except (IndexError, ValueError) as err:
            raise DecodeError(f"its bytes do not fit {self._msgtype}") from err


def _fields_in(message: memoryview) -> "list[tuple[int, memoryview]]":
    """Return number and bytes of the fields of a message that have a length (https://protobuf.dev/programming-guides/encoding)."""
    found = []
    at, size = 0, len(message)
    while at < size:
        tag, at = _varint(message, at)
        match tag & 7:
            case 0:
                _, at = _varint(message, at)
            case 1:
                at += 8
            case 2:
                length, at = _varint(message, at)
                if at + length > size:
                    raise ValueError("cut off")
                found.append((tag >> 3, message[at : at + length]))
                at += length
            case 5:
                at += 4
            case _:
                raise ValueError("a group")
    return found


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
        if shift > 63:
            raise ValueError("a number without end")


class JsonSchema:
    """A JSON schema, of which types, properties, items and base64 count; without one, whatever is in a message."""

    def __init__(self, msgtype: str, definition: Definition, most_elements: int) -> None:
        self._msgtype = msgtype
        self._most = most_elements
        self._schema: Mapping[str, Any] = (
            json.loads(definition.text)
            if definition.format == "jsonschema" and definition.text.strip()
            else {}
        )
        if not isinstance(self._schema, Mapping):
            raise TypeError("a schema is an object")

    @cached_property
    def digest(self) -> str:
        """Digest of the schema without its descriptions."""
        return digest_json({"type": self._msgtype, "schema": _without_comments(self._schema)})

    def decode(self, data: bytes) -> Message:
        """Return a message; arrays of numbers are numpy arrays, null where a number is due is NaN.

        Raises:
            DecodeError: as `ProtobufSchema.decode`.
        """
        if len(data) > 2 * self._most and sum(map(data.count, (b"{", b"[", b'"'))) > 2 * self._most:
            raise DecodeError("its lists hold more than limits.message_elements in the recipe allows")
        try:
            value = self._conform(json.loads(data), self._schema)
            if not isinstance(value, SimpleNamespace):
                self._refuse()
        except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as err:
            raise DecodeError(f"its bytes do not fit {self._msgtype}") from err
        return cast("Message", value)

    def _refuse(self) -> NoReturn:
        raise ValueError("it is of another type")

    def _conform(self, value: Any, schema: Mapping[str, Any]) -> Any:
        """Return a value as its schema has it."""
        schema = self._resolved(schema)
        kind = _kind_of(schema)
        is_missing = value is _MISSING
        if is_missing:
            value = _DEFAULTS.get(kind or "", 0)
        if kind == "object" or isinstance(value, dict):
            given = {} if value is None else value
            if not isinstance(given, dict) or kind not in {None, "object"}:
                self._refuse()
            known: Mapping[str, Any] = schema.get("properties", {})
            fields = {name: self._conform(item, known.get(name, {})) for name, item in given.items()}
            for name, one in known.items():
                if name not in fields:  # what is missing may refer to itself
                    fields[name] = None if is_missing and "$ref" in one else self._conform(_MISSING, one)
            return SimpleNamespace(**fields)
        if kind == "array" or isinstance(value, list):
            return self._list([] if value is None else value, schema)
        if kind == "number":
            return (
                float("nan")
                if value is None
                else float(value)
                if isinstance(value, int | float)
                else self._refuse()
            )
        if value is None:
            return _DEFAULTS.get(kind or "")
        if kind in {"integer", "boolean"}:
            return value if isinstance(value, int) else self._refuse()
        if kind == "string":
            if not isinstance(value, str):
                self._refuse()
            return (
                binascii.a2b_base64(value, strict_mode=True)
                if schema.get("contentEncoding") == "base64"
                else value
            )
        return value

    def _list(self, value: Any, schema: Mapping[str, Any]) -> Any:
        if not isinstance(value, list) or _kind_of(schema) not in {None, "array"}:
            self._refuse()
        items = schema.get("items", {})
        kind = _kind_of(items) if isinstance(items, Mapping) else None
        if kind in {"number", "integer"} or (value and all(type(one) in {int, float} for one in value)):
            whole = kind == "integer" or (kind is None and all(type(one) is int for one in value))
            return np.array(value, np.int64 if whole else np.float64)
        return [self._conform(one, items if isinstance(items, Mapping) else {}) for one in value]

    def _resolved(self, schema: Mapping[str, Any]) -> Mapping[str, Any]:
        """Follow references inside of the schema."""
        for _ in range(_MOST_REFERENCES):
            if "$ref" not in schema:
                return schema
            found: Any = self._schema
            for part in filter(None, str(schema["$ref"]).removeprefix("#").split("/")):
                found = found[part]
            schema = found
        raise ValueError("references that do not end")


Schema = ProtobufSchema | JsonSchema


def _kind_of(schema: Mapping[str, Any]) -> str | None:
    """Return the type of a value, besides null; None if it may be any."""
    kinds = schema.get("type")
    if isinstance(kinds, list):
        kinds = next(iter(one for one in kinds if one != "null"), None) if len(kinds) < 3 else None
    return kinds if isinstance(kinds, str) else None


def _without_comments(schema: object) -> object:
    if isinstance(schema, Mapping):
        return {
            name: _without_comments(value)
            for name, value in schema.items()
            if not (name in {"description", "$comment"} and isinstance(value, str))
        }
    return (
        [_without_comments(one) for one in schema]
        if isinstance(schema, Sequence) and not isinstance(schema, str)
        else schema
    )
