"""ROS 1 bags and ROS 2 bag folders, through rosbags."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path

from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, MessageDefinitionFormat

from bagassets.bags.inventory import Definition
from bagassets.bags.model import RawMessage
from bagassets.bags.reader import BaseRecording, TopicSource
from bagassets.bags.typestores import Serialization, normalise_msgtype

__all__ = ["Rosbag1Recording", "Rosbag2Recording", "definition_of"]


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


class Rosbag1Recording(BaseRecording):
    """A ROS 1 bag, plain or compressed with lz4 or bz2."""

    def __init__(self, path: Path, message_definitions: Sequence[Path] = ()) -> None:
        self._reader = rosbag1.Reader(path)
        self._reader.open()
        try:
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
        for connection, log_time_ns, data in self._reader.messages(chosen):
            yield RawMessage(connection.topic, self.topics[connection.topic].msgtype, log_time_ns, data)

    def close(self) -> None:
        """Close the files."""
        self._reader.close()
