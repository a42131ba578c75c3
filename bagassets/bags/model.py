"""What every reader of recordings offers, whatever the file format."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, Self

Format = Literal["ros1", "ros2", "mcap"]

__all__ = ["Definition", "Format", "Found", "RawMessage", "Recording", "SkimmedPacket", "TopicInfo"]


@dataclass(frozen=True, slots=True)
class Definition:
    """The definition of a message type.

    Attributes:
        format: `msg` (ROS, with `MSG:` sections for nested types), `idl`, or `none` if there is none.
        text: the definition.
    """

    format: Literal["msg", "idl", "none"]
    text: str


@dataclass(frozen=True, slots=True)
class Found:
    """A recording found below the bag root, not yet opened.

    Attributes:
        key: partition key, a readable slug of `relative`; unique below one root.
        relative: path below the bag root, with `/`.
        path: the bag file, or the folder of a ROS 2 bag.
        format: ros1 (`.bag`), ros2 (folder with metadata.yaml, or a bare `.db3`), mcap (bare `.mcap`).
        files: the files that make up the recording, sorted by name.
        size: sum of their sizes in bytes.
        mtime_ns: newest modification time of any of them.
    """

    key: str
    relative: str
    path: Path
    format: Format
    files: tuple[Path, ...]
    size: int
    mtime_ns: int


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a recording.

    Attributes:
        name: topic as recorded.
        msgtype: normalised type, `pkg/msg/Type`.
        count: number of messages.
        problem: why its messages cannot be decoded, in words; None if they can.
    """

    name: str
    msgtype: str
    count: int
    problem: str | None = None


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A serialized message: ROS 1 serialization or CDR, as recorded."""

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


class Recording(Protocol):
    """An open recording. Close it, or use it as a context manager."""

    path: Path
    format: Format
    topics: dict[str, TopicInfo]

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of `topics` in order of log time, in one pass over the file.

        Raises:
            KeyError: a topic is not in the recording.
            RecordingError: the file turns out to be damaged.
        """
        ...

    def decode(self, message: RawMessage) -> Any:
        """Return the message as an object with the fields of its type (rosbags' classes).

        Time fields have `sec` and `nanosec`, array fields are numpy arrays.

        Raises:
            DecodeError: the bytes do not fit the type, or the type is unknown.
        """
        ...

    def header_stamp_ns(self, message: RawMessage) -> int | None:
        """Return the header stamp without decoding the message; None if its type has no header."""
        ...

    def packet(self, message: RawMessage, payloads: Sequence[str]) -> SkimmedPacket | None:
        """Return header and bytes of a packet without decoding its message, None if only decoding tells.

        Args:
            message: whose packet.
            payloads: names that the field with the bytes may have.
        """
        ...

    def restrict(self, topics: Collection[str]) -> "Recording":
        """Return a view that offers `topics` only: a step cannot read what it did not declare."""
        ...

    def close(self) -> None:
        """Close the files."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...
