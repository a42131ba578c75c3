"""Bare `.db3` files: the SQLite storage of ROS 2 without its metadata.yaml."""

import json
import sqlite3
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from bagassets.bags.inventory import Definition
from bagassets.bags.model import RawMessage
from bagassets.bags.reader import BaseRecording, TopicSource
from bagassets.bags.typestores import normalise_msgtype

__all__ = ["DatabaseRecording"]


class DatabaseRecording(BaseRecording):
    """One `.db3` file with CDR messages."""

    def __init__(self, files: Sequence[Path], path: Path, message_definitions: Sequence[Path] = ()) -> None:
        self._connections = [sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
                             for file in files]  # fmt: skip
        try:
            sources = [source for connection in self._connections for source in _sources(connection)]
            super().__init__(path, "ros2", sources, message_definitions)
        except BaseException:
            self.close()
            raise

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        query = (
            "SELECT topics.name, messages.timestamp, messages.data FROM messages JOIN topics "
            "ON messages.topic_id = topics.id WHERE topics.name IN (SELECT value FROM json_each(?)) "
            "ORDER BY messages.timestamp, messages.id"
        )
        for connection in self._connections:
            for topic, log_time_ns, data in connection.execute(query, [json.dumps(sorted(topics))]):
                yield RawMessage(topic, self.topics[topic].msgtype, log_time_ns, data)

    def close(self) -> None:
        """Close the file."""
        for connection in self._connections:
            connection.close()


def _sources(connection: sqlite3.Connection) -> list[TopicSource]:
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    definitions: dict[str, Definition] = {}
    if "message_definitions" in tables:
        rows = connection.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        for msgtype, encoding, text in rows:
            if encoding in {"ros2msg", "ros2idl"} and text:
                definitions[normalise_msgtype(msgtype)] = Definition(
                    "idl" if encoding == "ros2idl" else "msg", text
                )
    counts = dict(connection.execute("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
    return [
        TopicSource(
            name,
            normalise_msgtype(msgtype),
            counts.get(topic_id, 0),
            definitions.get(normalise_msgtype(msgtype), Definition("none", "")),
            "cdr",
        )
        for topic_id, name, msgtype in connection.execute("SELECT id, name, type FROM topics")
    ]
