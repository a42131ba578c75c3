"""Mended copies of damaged recordings, with everything that can be read of them."""

import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path

import yaml
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer

from bagassets.base.errors import RecordingError
from bagassets.recordings.model import METADATA
from bagassets.recordings.recording import FileRecording, Recording
from bagassets.recordings.salvage.database_pages import SalvagedDatabase
from bagassets.recordings.salvage.folder import SalvagedFolder
from bagassets.recordings.salvage.mcap_scan import SalvagedMcap
from bagassets.recordings.salvage.rosbag1_scan import SalvagedBag
from bagassets.recordings.topic import RefusedBytes, normalise_msgtype

_TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
    offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
    encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages(timestamp ASC);
"""
_TOPIC = tuple[str, str, str, str]
"""Name, type, serialization and QoS profiles of a topic."""


def write_copy(recording: Recording, target: Path) -> int:
    """Write what can be read of a recording to a file or, if it is one of ROS 2 that is no bare MCAP, to a folder.

    Args:
        recording: from `open_salvaged`, with limits that let every message through.
        target: where nothing is yet.

    Returns:
        Number of messages.

    Raises:
        RecordingError: it is of a kind of which no copy can be made, or holds a message that is too large.
    """
    if not isinstance(recording, SalvagedFolder | FileRecording):
        raise RecordingError(
            f"{recording.path}: a drive in several files is mended file by file; name one of them."
        )
    files: Sequence[object] = recording.files
    folder = recording if isinstance(recording, SalvagedFolder) else None
    bags = [one for one in files if isinstance(one, SalvagedBag)]
    mcaps = [one for one in files if isinstance(one, SalvagedMcap)]
    if bags:
        return _write_bag(bags[0], target)
    if mcaps and folder is None:
        return sum(_write_mcap(mcaps, target).values())
    target.mkdir()
    if mcaps:
        name = f"{target.name}_0.mcap"
        counts = _write_mcap(mcaps, target / name)
        spans = [span for one in mcaps if (span := one.span_ns()) is not None]
        span_ns = (min(one[0] for one in spans), max(one[1] for one in spans)) if spans else (0, 0)
        _write_metadata(target, name, "mcap", counts, span_ns)
    else:
        name = f"{target.name}_0.db3"
        databases = [one for one in files if isinstance(one, SalvagedDatabase)]
        counts, span_ns = _write_database(databases, folder, target / name)
        _write_metadata(target, name, "sqlite3", counts, span_ns)
    return sum(counts.values())


def _write_bag(bag: SalvagedBag, target: Path) -> int:
    number = 0
    with Rosbag1Writer(target) as writer:
        connections = {}
        for one in bag.connections:
            fields: Mapping[str, bytes] = bag.fields.get(one.id, {})
            connections[one.id] = writer.add_connection(
                one.topic,
                normalise_msgtype(one.msgtype),
                msgdef=one.msgdef.data,
                md5sum=fields.get("md5sum", b"*").decode("ascii", "replace") or "*",
                callerid=fields.get("callerid", b"").decode("utf-8", "replace") or f"/connection_{one.id}",
                latching=int(fields.get("latching") == b"1"),
            )
        for connection, time_ns, data in bag.messages(connections):
            writer.write(connections[connection], time_ns, bytes(data))
            number += 1
    return number


def _write_mcap(files: Sequence[SalvagedMcap], target: Path) -> Counter[_TOPIC]:
    counts: Counter[_TOPIC] = Counter()
    with target.open("wb") as out:
        writer = McapWriter(out)
        encodings = {channel.message_encoding for one in files for channel in one.index.channels.values()}
        writer.start(profile={"ros1": "ros1", "cdr": "ros2"}.get("".join(encodings), ""))
        for file in files:
            schemas, channels = file.index.schemas, {}
            ids = {0: 0} | {
                one.id: writer.register_schema(one.name, one.encoding, one.data) for one in schemas.values()
            }
            for number, one in file.index.channels.items():
                channels[number] = writer.register_channel(
                    one.topic, one.message_encoding, ids.get(one.schema_id, 0), one.metadata
                )
            for channel, sequence, time_ns, published_ns, data in file.records():
                if channel not in channels:
                    continue
                writer.add_message(channels[channel], time_ns, bytes(data), published_ns, sequence)
                one = file.index.channels[channel]
                schema = schemas.get(one.schema_id)
                qos = one.metadata.get("offered_qos_profiles", "")
                counts[one.topic, "" if schema is None else schema.name, one.message_encoding, qos] += 1
        writer.finish()  # type: ignore[no-untyped-call]  # the library's
    return counts


def _write_database(
    files: Sequence[SalvagedDatabase], folder: SalvagedFolder | None, target: Path
) -> tuple[Counter[_TOPIC], tuple[int, int]]:
    ids: dict[_TOPIC, int] = {}
    for file in files:
        for row in file.topics.values():
            ids.setdefault(
                (row.name, normalise_msgtype(row.msgtype), row.serialization, row.qos), len(ids) + 1
            )
    counts = Counter(dict.fromkeys(ids, 0))
    topics = [(number, name, kind, how or "cdr", qos) for (name, kind, how, qos), number in ids.items()]
    definitions = {name: one for file in reversed(files) for name, one in file.definitions().items()}
    rows = [
        (name, "ros2idl" if one.format == "idl" else "ros2msg", one.text, "")
        for name, one in sorted(definitions.items())
    ]
    first_ns, last_ns = 2**63, 0

    def messages() -> Iterator[tuple[int, int, bytes]]:
        nonlocal first_ns, last_ns
        for file in files:
            found = file.messages(file.topics) if folder is None else folder.rows(file)
            for number, time_ns, data in found:
                if isinstance(data, RefusedBytes):
                    raise RecordingError(
                        f"{target}: a message of {file.topics[number].name} is too large for a copy."
                    )
                row = file.topics[number]
                topic = row.name, normalise_msgtype(row.msgtype), row.serialization, row.qos
                counts[topic] += 1
                first_ns, last_ns = min(first_ns, time_ns), max(last_ns, time_ns)
                yield ids[topic], time_ns, bytes(data)

    with closing(sqlite3.connect(target)) as connection:
        connection.executescript(_TABLES)
        connection.execute("INSERT INTO schema VALUES (4, 'unknown')")
        connection.executemany("INSERT INTO topics VALUES (?, ?, ?, ?, ?, '')", topics)
        connection.executemany(
            "INSERT INTO message_definitions (topic_type, encoding, encoded_message_definition, type_description_hash) "
            "VALUES (?, ?, ?, ?)",
            rows,
        )
        connection.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", messages()
        )
        connection.commit()
    return counts, (first_ns, last_ns) if counts.total() else (0, 0)


def _write_metadata(
    folder: Path, name: str, storage: str, counts: Counter[_TOPIC], span_ns: tuple[int, int]
) -> None:
    topics = [
        {
            "topic_metadata": {
                "name": topic,
                "type": msgtype,
                "serialization_format": how or "cdr",
                "offered_qos_profiles": qos,
            },
            "message_count": number,
        }
        for (topic, msgtype, how, qos), number in sorted(counts.items())
    ]
    start, duration = {"nanoseconds_since_epoch": span_ns[0]}, {"nanoseconds": span_ns[1] - span_ns[0]}
    number = counts.total()
    entry = {"path": name, "starting_time": start, "duration": duration, "message_count": number}
    information = {
        "version": 5,
        "storage_identifier": storage,
        "duration": duration,
        "starting_time": start,
        "message_count": number,
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [name],
        "files": [entry],
    }
    text = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)
    (folder / METADATA).write_text(text, encoding="utf-8")
