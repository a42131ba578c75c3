"""SQLite files of ROS 2: bare `.db3` files without metadata.yaml, and those in bag folders."""

import json
import os
import sqlite3
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from errno import EIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.recipe.model import Limits
from bagassets.recordings.damage import DamageError
from bagassets.recordings.journals import without_journals
from bagassets.recordings.model import Definition, OnRead
from bagassets.recordings.topic import RefusedBytes, TopicSource, is_transient_local, normalise_msgtype

_GENERATED = (2, 3)  # `hidden` in `PRAGMA table_xinfo`
_PAGE_BYTES = 4092  # without the link to the next page
_READ_BYTES = 1 << 20
_SAMPLES = 1000  # a seek each
_ROW_BYTES = 30  # what a small message takes besides its payload, its place in the index included


def serialization_problem(name: object) -> str | None:
    """Return why messages in a serialization cannot be decoded; an empty name means cdr."""
    return None if name in {None, "", "cdr"} else f"its serialization is '{name}', not cdr"


class Database:
    """One file, with what is in its write-ahead log or journal; close it.

    Args:
        path: the file.
        limits: of the recipe.
        on_read: called with how far reading has come.
    """

    def __init__(self, path: Path, limits: Limits, on_read: OnRead | None = None) -> None:
        self._path = path
        self._on_read = on_read
        self._most_bytes = limits.message_bytes
        with without_journals(path) as readable:
            self._uri = f"{readable.absolute().as_uri()}?mode=ro&immutable=1"
            self._connection = self._connected()
            try:
                self._require_tables()
            except BaseException:
                self._connection.close()
                raise

    def _connected(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self._uri, uri=True)
        # Text in another encoding damages that text, not the file.
        connection.text_factory = lambda data: data.decode("utf-8", "replace")
        connection.execute("PRAGMA trusted_schema = OFF")
        return connection

    def _select(self, query: str, values: Sequence[object] = ()) -> Iterator[Any]:
        """Yield the rows of a query.

        Raises:
            OSError: a read failed, of which SQLite says what it says of damage. Damage is there when it is looked for again.
        """
        try:
            yield from self._connection.execute(query, values)
        except sqlite3.DatabaseError as err:
            with self._path.open("rb", buffering=0) as file:
                while file.read(_READ_BYTES):
                    pass
            with closing(self._connected()) as again:
                for _ in again.execute(query, values):
                    pass
            raise OSError(EIO, os.strerror(EIO), str(self._path)) from err

    def _require_tables(self) -> None:
        """Refuse databases that only look like a bag: a view or a generated column may compute for ever."""
        rows = self._select("SELECT name, type, sql FROM sqlite_master")
        objects = {name: (kind, sql) for name, kind, sql in rows}
        for name in ("topics", "messages"):
            kind, sql = objects.get(name, ("", ""))
            if kind != "table" or "VIRTUAL" in str(sql)[:20].upper():
                raise DamageError(f"it has no table '{name}'")
            columns = self._select(f"PRAGMA table_xinfo({name})")
            if any(column[6] in _GENERATED for column in columns):
                raise DamageError(f"its table '{name}' is not that of a bag")
        self._has_definitions = objects.get("message_definitions", ("", ""))[0] == "table"
        self._columns = {column[1] for column in self._select("PRAGMA table_xinfo(topics)")}

    def definitions(self) -> dict[str, Definition]:
        """Return type -> definition."""
        if not self._has_definitions:
            return {}
        rows = self._select(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        return {
            normalise_msgtype(str(msgtype)): Definition("idl" if encoding == "ros2idl" else "msg", str(text))
            for msgtype, encoding, text in rows
            if encoding in {"ros2msg", "ros2idl"} and text
        }

    def sources(self, counts: Mapping[int, int] = MappingProxyType({})) -> dict[int, TopicSource]:
        """Return topic id -> name, type, definition, and one of `counts`."""
        definitions = self.definitions()
        return {
            number: TopicSource(
                str(name),
                msgtype := normalise_msgtype(str(named)),
                counts.get(number, 0),
                definitions.get(msgtype, Definition("none", "")),
                "cdr",
                serialization_problem(serialization),
                is_transient_local(str(qos)),
            )
            for number, name, named, serialization, qos in self._topic_rows()
        }

    def _topic_rows(self) -> Iterable[tuple[int, object, object, object, object]]:
        """Return id, name, type, serialization and QoS profiles of each topic."""
        columns = ("serialization_format", "offered_qos_profiles")
        more = [one if one in self._columns else "NULL" for one in columns]
        return self._select(f"SELECT id, name, type, {', '.join(more)} FROM topics")  # noqa: S608  (of these)

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of messages, counted; raise DamageError if there are some of no topic."""
        counts = dict(self._select("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
        if not counts.keys() <= {number for number, *_ in self._topic_rows()}:
            raise DamageError("it has messages of topics that it does not name")
        return counts

    def messages(self, topics: Collection[int]) -> Iterator[tuple[int, int, bytes | memoryview]]:
        """Yield topic id, log time and payload in order of log time."""
        query = (
            "SELECT topic_id, timestamp, length(data), CASE WHEN length(data) <= ? THEN data END FROM messages "
            "WHERE topic_id IN (SELECT value FROM json_each(?)) ORDER BY timestamp, id"
        )
        rows = self._select(query, [self._most_bytes, json.dumps(sorted(topics))])
        position = 0
        for topic, log_time_ns, size, data in rows:
            if self._on_read is not None:
                # SQLite does not say where it reads; recorders append, and give large messages pages of their own.
                pages, _ = divmod(size or 0, _PAGE_BYTES)
                position += (pages + 1) * _PAGE_BYTES if pages else (size or 0) + _ROW_BYTES
                self._on_read(self._path, position, b"")
            yield topic, log_time_ns, RefusedBytes() if data is None and size else data

    def span_ns(self) -> tuple[int, int] | None:
        """Return first and last log time; None without messages."""
        # Asked for both in one query, SQLite looks at all messages, and not at the ends of its index.
        ends = "SELECT (SELECT min(timestamp) FROM messages), (SELECT max(timestamp) FROM messages)"
        ((first, last),) = self._select(ends)
        return None if first is None else (int(first), int(last))

    def log_times(self) -> dict[int, NDArray[np.int64]]:
        """Return topic id -> (N,) log times in nanoseconds."""
        return _by_topic(self._select("SELECT topic_id, timestamp FROM messages"))

    def log_times_as_written(self) -> dict[int, NDArray[np.int64]]:
        """Return topic id -> (N,) log times in nanoseconds, in the order in which they were written, of some of its messages."""
        ((first, last),) = self._select("SELECT min(id), max(id) FROM messages")
        if first is None:
            return {}
        some = json.dumps(list(range(first, last + 1, 1 + (last - first) // _SAMPLES)))
        query = "SELECT topic_id, timestamp FROM messages WHERE id IN (SELECT value FROM json_each(?)) ORDER BY id"
        return _by_topic(self._select(query, [some]))

    def close(self) -> None:
        """Close the file."""
        self._connection.close()


def _by_topic(rows: Iterable[Any]) -> dict[int, NDArray[np.int64]]:
    """Return topic id -> (N,) log times of pairs of both."""
    numbers, times_ns = np.array(list(rows), np.int64).reshape(-1, 2).T
    return {number: times_ns[numbers == number] for number in np.unique(numbers).tolist()}
