"""ROS 2 bag folders, through rosbags, and what its readers tell of the topics in a bag."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path

from rosbags import rosbag2
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import ReaderError

from bagassets.bags.inventory import Definition
from bagassets.bags.mcap_checksums import checksum_mismatch
from bagassets.bags.model import RawMessage
from bagassets.bags.reader import BaseRecording, TopicSource
from bagassets.bags.typestores import Serialization, normalise_msgtype

__all__ = ["Rosbag2Recording", "definition_of", "sources_of"]


def definition_of(connection: Connection) -> Definition:
    """Return the definition that came with a connection."""
    match connection.msgdef.format:
        case MessageDefinitionFormat.MSG:
            return Definition("msg", connection.msgdef.data)
        case MessageDefinitionFormat.IDL:
            return Definition("idl", connection.msgdef.data)
        case _:
            return Definition("none", "")


def sources_of(connections: Iterable[Connection], serialization: Serialization) -> list[TopicSource]:
    """Return the topics that the connections of a bag carry."""
    return [
        TopicSource(c.topic, normalise_msgtype(c.msgtype), c.msgcount, definition_of(c), serialization)
        for c in connections
    ]


class Rosbag2Recording(BaseRecording):
    """A ROS 2 bag folder: SQLite or MCAP, split, compressed by file or by message."""

    def __init__(self, path: Path, message_definitions: Sequence[Path] = ()) -> None:
        self._reader = rosbag2.Reader(path)
        self._reader.open()
        try:
            super().__init__(path, "ros2", sources_of(self._reader.connections, "cdr"), message_definitions)
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
