"""Decoding serialized messages with the definitions that came with them.

Each message type gets a type store of its own, made from its own definition: a definition that
does not parse, or that contradicts another topic's, costs that topic only.
"""

import struct
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from bagassets.bags.inventory import Definition
from bagassets.errors import DecodeError, RecordingError

__all__ = ["MessageTypes", "Serialization", "normalise_msgtype"]

Serialization = Literal["ros1", "cdr"]

_HEADER = "std_msgs/msg/Header"
# In no store of ROS 1, but in most ROS 1 bags: `tf/tfMessage` is the older name.
_TF = "geometry_msgs/TransformStamped[] transforms\n"


def normalise_msgtype(name: str) -> str:
    """Return `pkg/msg/Type` for a type written either way."""
    parts = name.strip().split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else "/".join(parts)


class MessageTypes:
    """The message types of one recording.

    Args:
        serialization: how payloads are serialized.
        definitions: type -> the definition that came with the recording.
        message_definitions: folders of `.msg` files, laid out as `pkg/msg/Type.msg` or `pkg/Type.msg`.
    """

    def __init__(
        self,
        serialization: Serialization,
        definitions: Mapping[str, Definition],
        message_definitions: Sequence[Path] = (),
    ) -> None:
        self.serialization = serialization
        self._definitions = definitions
        self._folders = tuple(message_definitions)
        self._stores: dict[str, Typestore | str] = {}
        self._layouts: dict[str, str] = {}

    def problem(self, msgtype: str) -> str | None:
        """Return why messages of a type cannot be decoded, or None."""
        store = self._store(msgtype)
        return store if isinstance(store, str) else None

    def decode(self, msgtype: str, data: bytes | memoryview) -> Any:
        """Return the message object.

        Raises:
            DecodeError: the bytes do not fit the type, or the type is not known.
        """
        store = self._store(msgtype)
        if isinstance(store, str):
            raise DecodeError(store)
        try:
            if self.serialization == "ros1":
                return store.deserialize_ros1(data, msgtype)
            return store.deserialize_cdr(data, msgtype)
        except (SerdeError, AssertionError, ValueError, IndexError, struct.error, UnicodeDecodeError) as err:
            raise DecodeError(f"its bytes do not fit {msgtype}") from err

    def definition(self, msgtype: str) -> Definition:
        """Return what messages of a type are decoded with, wherever it came from.

        A recording's own definition as it is; one from a `.msg` folder or a default type store as
        text that holds without them.
        """
        own = self._definitions.get(msgtype, Definition("none", ""))
        store = self._store(msgtype)
        if (own.format != "none" and own.text) or isinstance(store, str):
            return own
        text, _ = store.generate_msgdef(msgtype, ros_version=1 if self.serialization == "ros1" else 2)
        return Definition("msg", text)

    def header(self, msgtype: str, data: bytes | memoryview) -> tuple[int, str] | None:
        """Return stamp in nanoseconds and frame id from the bytes of a message, without decoding it.

        Known for types whose first field is a header, or a sequence of elements that begin with
        one (TFMessage, MarkerArray), of which the first counts; else None.
        """
        layout = self._layouts.get(msgtype)
        if layout is None:
            layout = self._layouts[msgtype] = self._layout(msgtype)
        if layout == "none":
            return None
        try:
            return _read_header(data, self.serialization, sequence=layout == "sequence")
        except (struct.error, IndexError):
            return None  # too short to hold a header

    def _layout(self, msgtype: str) -> str:
        store = self._store(msgtype)
        if isinstance(store, str):
            return "none"
        first = _first_field(store, msgtype)
        if first == (Nodetype.NAME, _HEADER):
            return "header"
        if first is not None and first[0] == Nodetype.SEQUENCE:
            inner, _ = first[1]
            if inner[0] == Nodetype.NAME and _first_field(store, inner[1]) == (Nodetype.NAME, _HEADER):
                return "sequence"
        return "none"

    def _store(self, msgtype: str) -> Typestore | str:
        if msgtype not in self._stores:
            self._stores[msgtype] = self._make_store(msgtype)
        return self._stores[msgtype]

    def _make_store(self, msgtype: str) -> Typestore | str:
        definition = self._definitions.get(msgtype)
        try:
            if definition is not None and definition.format != "none" and definition.text:
                parse = get_types_from_idl if definition.format == "idl" else None
                store = get_typestore(Stores.EMPTY)
                types = (
                    parse(definition.text)
                    if parse is not None
                    else get_types_from_msg(definition.text, msgtype)
                )
                store.register(types)
            else:
                store = self._default_store()
            if msgtype not in store.fielddefs:
                return f"there is no definition of {msgtype}; name a folder of .msg files in bags.message_definitions"
            store.generate_msgdef(msgtype)
            # Compiles the (de)serializer, which finds references to types that are missing.
            store.get_msgdef(msgtype)
        except (TypesysError, SerdeError, KeyError, ValueError, AssertionError, TypeError) as err:
            return f"the definition of {msgtype} cannot be used ({_short(err)})"
        return store

    def _default_store(self) -> Typestore:
        store = get_typestore(Stores.ROS1_NOETIC if self.serialization == "ros1" else Stores.ROS2_HUMBLE)
        types: dict[str, Any] = {}
        for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
            if name not in store.fielddefs:
                types |= get_types_from_msg(_TF, name)
        for folder in self._folders:
            types |= _message_files(folder)
        store.register({name: fields for name, fields in types.items() if name not in store.fielddefs})
        return store


def _first_field(store: Typestore, msgtype: str) -> Any:
    fields = store.fielddefs[msgtype][1] if msgtype in store.fielddefs else ()
    return fields[0][1] if fields else None


@cache
def _message_files(folder: Path) -> dict[str, Any]:
    """Return the types defined in a folder of `.msg` files."""
    if not folder.is_dir():
        raise RecordingError(f"{folder}: no such folder; correct bags.message_definitions in the recipe.")
    types: dict[str, Any] = {}
    for path in sorted(folder.rglob("*.msg")):
        package = path.parent.parent.name if path.parent.name == "msg" else path.parent.name
        try:
            types |= get_types_from_msg(path.read_text(encoding="utf-8"), f"{package}/msg/{path.stem}")
        except TypesysError as err:
            raise RecordingError(f"{path}: not a message definition ({_short(err)}).") from err
    return types


def _read_header(
    data: bytes | memoryview, serialization: Serialization, *, sequence: bool
) -> tuple[int, str] | None:
    if serialization == "ros1":
        order, at = "<", 0
    else:
        order, at = ("<" if data[1] & 1 else ">"), 4
    if sequence:
        (count,) = struct.unpack_from(f"{order}I", data, at)
        at += 4
        if count == 0:
            return None
    if serialization == "ros1":
        at += 4  # seq
    seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, at)
    frame = bytes(data[at + 12 : at + 12 + length]).rstrip(b"\0").decode("utf-8", "replace")
    return seconds * 1_000_000_000 + nanoseconds, frame.lstrip("/")


def _short(err: Exception) -> str:
    lines = str(err).strip().splitlines()
    return lines[0] if lines else type(err).__name__
