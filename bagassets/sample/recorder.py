"""Writers of sample recordings: one interface, three formats with all their compressions."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import lz4.frame
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from bagassets.base.errors import RecordingError
from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages

RecordingFormat = Literal["ros1", "ros2", "mcap", "foxglove"]
Compression = Literal["none", "lz4", "bz2", "zstd"]

# Compressions of each format; ros2 is a folder with an sqlite3 database, or with the suffix .db3 that alone.
COMPRESSIONS: dict[RecordingFormat, tuple[Compression, ...]] = {
    "ros1": ("none", "lz4", "bz2"),
    "ros2": ("none", "zstd"),
    "mcap": ("none", "lz4", "zstd"),
    "foxglove": ("none", "lz4", "zstd"),  # an MCAP, too, but without ROS
}


class Recorder(ABC):
    """An open recording; the writer of each format says in `_add` how the connection of a topic is created."""

    def __init__(self, *, ros1: bool) -> None:
        self.messages = Messages(ros1=ros1)
        self._appenders: dict[str, Callable[[int, bytes | bytearray], None]] = {}

    @abstractmethod
    def _add(self, topic: str, msgtype: str) -> Callable[[int, bytes | bytearray], None]:
        """Create the connection of a topic; return a function that appends a message to it."""

    def serialize(self, msgtype: str, message: Message) -> bytes:
        """Return the bytes of a message in this format."""
        store = self.messages.store
        serialize = store.serialize_ros1 if self.messages.ros1 else store.serialize_cdr
        return bytes(serialize(message, msgtype))

    def write(self, topic: str, msgtype: str, log_time_ns: int, message: Message) -> None:
        """Serialize a message and append it."""
        self.write_raw(topic, msgtype, log_time_ns, self.serialize(msgtype, message))

    def write_raw(self, topic: str, msgtype: str, log_time_ns: int, data: bytes | bytearray) -> None:
        """Append a serialized message."""
        if topic not in self._appenders:
            self._appenders[topic] = self._add(topic, msgtype)
        self._appenders[topic](log_time_ns, data)


class _RosbagsRecorder(Recorder):
    _writer: Rosbag1Writer | Rosbag2Writer

    def _add(self, topic: str, msgtype: str) -> Callable[[int, bytes | bytearray], None]:
        connection = self._writer.add_connection(topic, msgtype, typestore=self.messages.store)
        return lambda log_time_ns, data: self._writer.write(connection, log_time_ns, bytes(data))


class _Ros1Recorder(_RosbagsRecorder):
    def __init__(self, path: Path, compression: Compression, stack: ExitStack) -> None:
        super().__init__(ros1=True)
        writer = Rosbag1Writer(path)
        if compression != "none":
            writer.set_compression(Rosbag1Writer.CompressionFormat[compression.upper()])
        if compression == "lz4":
            writer.compressor = _roslz4
        self._writer = stack.enter_context(writer)


def _roslz4(data: bytes) -> bytes:
    """Return a frame as ROS 1 writes it, the only kind that it reads: with checksum, without size, with independent blocks.

    Source: `roslz4/src/lz4s.c` of ros_comm, which refuses any other frame.
    """
    compressed: bytes = lz4.frame.compress(
        data,
        compression_level=0,
        block_size=lz4.frame.BLOCKSIZE_MAX1MB,
        block_linked=False,
        content_checksum=True,
        store_size=False,
    )
    return compressed


class _Ros2Recorder(_RosbagsRecorder):
    def __init__(self, path: Path, compression: Compression, stack: ExitStack) -> None:
        super().__init__(ros1=False)
        if path.suffix == ".db3":  # the database alone, without the folder and its metadata
            folder = Path(stack.enter_context(TemporaryDirectory(dir=path.parent)), "bag")
            stack.callback((folder / "bag.db3").rename, path)
            path = folder
        writer = Rosbag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
        if compression == "zstd":
            writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        self._writer = stack.enter_context(writer)


class McapRecorder(Recorder):
    """An MCAP, of ROS 2 unless its messages are converted."""

    def __init__(
        self, path: Path, compression: Compression, stack: ExitStack, *, profile: str = "ros2"
    ) -> None:
        super().__init__(ros1=False)
        stream = stack.enter_context(path.open("xb"))
        self._writer = McapWriter(stream, compression=CompressionType[compression.upper()])
        self._writer.start(profile=profile, library="bagassets sample")
        stack.callback(self._writer.finish)
        self._schemas: dict[str, int] = {}

    def _add(self, topic: str, msgtype: str) -> Callable[[int, bytes | bytearray], None]:
        channel = self._channel(topic, msgtype)
        return lambda log_time_ns, data: self._writer.add_message(
            channel, log_time_ns, bytes(data), log_time_ns
        )

    def _channel(self, topic: str, msgtype: str) -> int:
        """Register a topic, and its type if it is new; return its channel."""
        if msgtype not in self._schemas:
            definition, _ = self.messages.store.generate_msgdef(msgtype, ros_version=2)
            self._schemas[msgtype] = self._writer.register_schema(msgtype, "ros2msg", definition.encode())
        return self._writer.register_channel(topic, "cdr", self._schemas[msgtype])


def _foxglove(path: Path, compression: Compression, stack: ExitStack) -> Recorder:
    from bagassets.sample.foxglove import FoxgloveRecorder  # noqa: PLC0415  (protobuf, which the others need not)

    return FoxgloveRecorder(path, compression, stack)


_RECORDERS: dict[RecordingFormat, Callable[[Path, Compression, ExitStack], Recorder]] = {
    "ros1": _Ros1Recorder,
    "ros2": _Ros2Recorder,
    "mcap": McapRecorder,
    "foxglove": _foxglove,
}


def open_recorder(
    path: Path, file_format: RecordingFormat, compression: Compression, stack: ExitStack
) -> Recorder:
    """Open a recording for writing; closing `stack` finishes it.

    Raises:
        RecordingError: something is there already, or the format has no such compression.
    """
    if compression not in COMPRESSIONS[file_format]:
        known = ", ".join(COMPRESSIONS[file_format])
        raise RecordingError(
            f"{path}: {file_format} recordings do not support the compression {compression}; use {known}."
        )
    if path.exists():
        raise RecordingError(f"{path}: exists already; remove it or give another path.")
    path.parent.mkdir(parents=True, exist_ok=True)
    return _RECORDERS[file_format](path, compression, stack)
