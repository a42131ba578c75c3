"""ROS 1 bags and ROS 2 bag folders, through rosbags."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag1.reader import Chunk
from rosbags.rosbag2 import ReaderError

from bagassets.bags.inventory import Definition
from bagassets.bags.mcap_checksums import checksum_mismatch
from bagassets.bags.model import RawMessage
from bagassets.bags.reader import BaseRecording, TopicSource
from bagassets.bags.typestores import Serialization, normalise_msgtype

__all__ = ["Rosbag1Recording", "Rosbag2Recording", "definition_of"]


# Chunks overlap with their neighbours; recorders fill them to a megabyte or a few.
_KEPT_CHUNKS = 4


def definition_of(connection: Connection) -> Definition:
    """Return the definition that came with a connection."""
    match connection.msgdef.format:
        case MessageDefinitionFormat.MSG:
            return Definition("msg", connection.msgdef.data)
        case MessageDefinitionFormat.IDL:
            return Definition("idl", connection.msgdef.data)
        case _:
            return Definition("none", "")


def _sources(connections: Iterable[Connection], serialization: Serialization) -> list[TopicSource]:
    return [
        TopicSource(c.topic, normalise_msgtype(c.msgtype), c.msgcount, definition_of(c), serialization)
        for c in connections
    ]


class _LatestChunks:
    """Keeps the last few decompressed chunks.

    Messages come sorted by time. Where times of neighbouring chunks overlap, as those of many recorders
    do, rosbags goes back and forth between them, and would decompress each again every time.
    """

    def __init__(self) -> None:
        self._kept: dict[int, bytes] = {}

    def keeping(self, position: int, chunk: Chunk) -> Chunk:
        """Return the chunk, to be decompressed through this."""
        return chunk._replace(decompressor=partial(self._decompress, position, chunk.decompressor))

    def clear(self) -> None:
        """Forget all."""
        self._kept.clear()

    def _decompress(self, position: int, decompress: Callable[[bytes], bytes], data: bytes) -> bytes:
        content = self._kept.pop(position, None)
        if content is None:
            content = decompress(data)
        self._kept[position] = content  # the newest last
        if len(self._kept) > _KEPT_CHUNKS:
            del self._kept[next(iter(self._kept))]
        return content


class Rosbag1Recording(BaseRecording):
    """A ROS 1 bag, plain or compressed with lz4 or bz2."""

    def __init__(self, path: Path, message_definitions: Sequence[Path] = ()) -> None:
        self._reader = rosbag1.Reader(path)
        self._reader.open()
        self._latest = _LatestChunks()
        try:
            for position, chunk in self._reader.chunks.items():
                self._reader.chunks[position] = self._latest.keeping(position, chunk)
            super().__init__(path, "ros1", _sources(self._reader.connections, "ros1"), message_definitions)
        except BaseException:
            self._reader.close()
            raise

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        chosen = [c for c in self._reader.connections if c.topic in topics]
        for connection, log_time_ns, data in self._reader.messages(chosen):
            yield RawMessage(connection.topic, self.topics[connection.topic].msgtype, log_time_ns, data)

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
        self._latest.clear()


class Rosbag2Recording(BaseRecording):
    """A ROS 2 bag folder: SQLite or MCAP, split, compressed by file or by message."""

    def __init__(self, path: Path, message_definitions: Sequence[Path] = ()) -> None:
        self._reader = rosbag2.Reader(path)
        self._reader.open()
        try:
            super().__init__(path, "ros2", _sources(self._reader.connections, "cdr"), message_definitions)
        except BaseException:
            self._reader.close()
            raise

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        chosen = [c for c in self._reader.connections if c.topic in topics]
        try:
            for connection, log_time_ns, data in self._reader.messages(chosen):
                yield RawMessage(connection.topic, self.topics[connection.topic].msgtype, log_time_ns, data)
        except ReaderError as err:
            # The library checks the chunks of MCAP files in every pass, but does not tell which one is damaged.
            mismatches = (checksum_mismatch(file) for file in sorted(self.path.glob("*.mcap")))
            raise next(filter(None, mismatches), err) from err

    def close(self) -> None:
        """Close the files."""
        self._reader.close()
