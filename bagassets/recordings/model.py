"""What recordings consist of: files, messages, and definitions of message types."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

from bagassets.base.fingerprints import Signature

Format = Literal["ros1", "ros2", "mcap"]
Serialization = Literal["ros1", "cdr", "protobuf", "json"]
OnRead = Callable[[Path, int, bytes], None]
"""Called after bytes of a file were read, with the file, the position that reading has come to, and the bytes before it.

Where these are not at hand, they are empty, and the position is rough."""

METADATA = "metadata.yaml"
"""The file that makes a folder a ROS 2 bag."""


@dataclass(frozen=True, slots=True)
class Definition:
    """The definition of a message type.

    Attributes:
        format: `msg` (ROS, with `MSG:` sections for nested types), `idl`, `protobuf` or `jsonschema` (see
            `schemas.schema_definition`), or `none` if there is none.
        text: the definition.
    """

    format: Literal["msg", "idl", "protobuf", "jsonschema", "none"]
    text: str


@dataclass(frozen=True, slots=True)
class RecordingFiles:
    """The files of one recording below the bag root, not opened yet.

    Attributes:
        key: partition key, a readable slug of `relative`; unique below one root.
        relative: path below the bag root, with `/`.
        path: the bag file, or the folder of a ROS 2 bag; of a series, where the whole drive would be.
        format: ros1 (`.bag`), ros2 (folder with metadata.yaml, or a bare `.db3`), mcap (bare `.mcap`).
        files: the files that make up the recording, sorted by name, with what a killed recorder left beside them; of a series,
            in the order of its parts.
        size: sum of their sizes in bytes.
        mtime_ns: newest modification time of any of them.
        parts: of a series, its parts in order, each as the recording that it would be alone.
        seen: signature of each file when it was found; empty if they are not known.
    """

    key: str
    relative: str
    path: Path
    format: Format
    files: tuple[Path, ...]
    size: int
    mtime_ns: int
    parts: tuple["RecordingFiles", ...] = ()
    seen: tuple[Signature, ...] = field(default=(), compare=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Its path below the bag root, and those of its parts: globs may be about any of them."""
        return (self.relative, *(part.relative for part in self.parts))


class Message(Protocol):
    """A decoded message, or a message inside one: an object with the fields of its type.

    Of which types there are, and what fields they have, nobody knows but the recording.
    """

    def __getattr__(self, name: str) -> Any: ...


# There are many thousands a second, and a named tuple is made in half the time of a frozen dataclass.
class RawMessage(NamedTuple):
    """A serialized message, as recorded."""

    topic: str
    msgtype: str
    log_time_ns: int
    data: bytes | memoryview


@dataclass(slots=True)
class SkimmedPacket:
    """Stamp and frame id of the header of a packet message, and the bytes of the packet."""

    stamp_ns: int
    frame_id: str
    payload: bytes
