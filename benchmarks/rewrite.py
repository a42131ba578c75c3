"""Rewriting ROS 1 recordings with something changed, for benchmarks."""

from collections.abc import Callable
from pathlib import Path

from rosbags.rosbag1 import Reader, Writer

__all__ = ["rewrite"]

NOTES = "/bagassets_benchmark"
_NOTE = ("std_msgs/msg/String", "string data\n", "992ce8a1687cec8c8bd883ec73ca41d1")


def rewrite(
    path: Path, change: Callable[[str, bytes], bytes] = lambda _topic, data: data, note: str | None = None
) -> None:
    """Write a recording anew.

    Args:
        path: a ROS 1 bag, which is replaced.
        change: given topic and serialized message, returns the message to write.
        note: text of an additional message, on a topic that nothing reads.
    """
    new = path.with_suffix(".new")
    with Reader(path) as reader, Writer(new) as writer:
        connections = {
            connection.id: writer.add_connection(
                connection.topic,
                connection.msgtype,
                msgdef=connection.msgdef.data,
                md5sum=connection.digest,
                callerid=connection.ext.callerid,  # type: ignore[union-attr]  # ROS 1 connections have one
                latching=connection.ext.latching,  # type: ignore[union-attr]
            )
            for connection in reader.connections
            if connection.topic != NOTES
        }
        for connection, stamp_ns, data in reader.messages():
            if connection.id in connections:
                writer.write(connections[connection.id], stamp_ns, change(connection.topic, bytes(data)))
        if note is not None:
            msgtype, msgdef, md5sum = _NOTE
            extra = writer.add_connection(NOTES, msgtype, msgdef=msgdef, md5sum=md5sum)
            text = note.encode()
            writer.write(extra, reader.end_time, len(text).to_bytes(4, "little") + text)
    new.replace(path)
