"""Bare MCAP files, through the mcap library: any profile, also an empty one."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Schema
from mcap.stream_reader import CRCValidationError
from mcap.summary import Summary

from bagassets.bags.inventory import Definition
from bagassets.bags.mcap_checksums import checksum_mismatch
from bagassets.bags.model import RawMessage
from bagassets.bags.reader import BaseRecording, TopicSource
from bagassets.bags.typestores import Serialization, normalise_msgtype
from bagassets.errors import RecordingError

__all__ = ["McapRecording"]


class McapRecording(BaseRecording):
    """A bare `.mcap` file with CDR or ROS 1 messages; other encodings cost their topic."""

    def __init__(self, path: Path, message_definitions: Sequence[Path] = ()) -> None:
        self._file = path.open("rb")
        try:
            self._reader = make_reader(self._file)
            summary = _checked(self._reader.get_summary(), path)
            counts = summary.statistics.channel_message_counts if summary.statistics is not None else {}
            sources = []
            for channel in summary.channels.values():
                schema = summary.schemas.get(channel.schema_id)
                serialization: Serialization = "ros1" if channel.message_encoding == "ros1" else "cdr"
                problem = None
                if channel.message_encoding not in {"ros1", "cdr"}:
                    problem = f"its message encoding is '{channel.message_encoding}', not cdr or ros1"
                sources.append(
                    TopicSource(
                        channel.topic,
                        normalise_msgtype(schema.name) if schema is not None else "unknown",
                        counts.get(channel.id, 0),
                        _definition(schema),
                        serialization,
                        problem,
                    )
                )
            super().__init__(path, "mcap", sources, message_definitions)
        except BaseException:
            self._file.close()
            raise

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        try:
            for _, channel, message in self._reader.iter_messages(topics=list(topics), log_time_order=True):
                yield RawMessage(
                    channel.topic, self.topics[channel.topic].msgtype, message.log_time, message.data
                )
        except CRCValidationError as err:
            raise checksum_mismatch(self.path) or err from err

    def check_content(self) -> None:
        """Check the checksum of every chunk that is read from now on."""
        self._reader = make_reader(self._file, validate_crcs=True)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _checked(summary: Summary | None, path: Path) -> Summary:
    if summary is None or summary.statistics is None:
        raise RecordingError(f"{path}: the MCAP has no summary; run `mcap recover` on it first.")
    return summary


def _definition(schema: Schema | None) -> Definition:
    if schema is None or schema.encoding not in {"ros1msg", "ros2msg", "ros2idl"} or not schema.data:
        return Definition("none", "")
    return Definition("idl" if schema.encoding == "ros2idl" else "msg", schema.data.decode("utf-8"))
