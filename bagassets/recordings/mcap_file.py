"""MCAP files: bare ones of any profile or none, and those in ROS 2 bag folders.

The mcap library decompresses chunks of any size and makes an object of every record, for all chunks that overlap in
time at once. Here the size of a chunk is checked against the recipe's limits first, and messages are views of it.
"""

import os
from collections.abc import Collection, Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from struct import Struct
from types import MappingProxyType

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from bagassets.recipe.model import Limits
from bagassets.recordings.chunks import LatestChunks, detached
from bagassets.recordings.damage import DamageError
from bagassets.recordings.layouts import IDL_TEXT
from bagassets.recordings.mcap_chunk import (
    MESSAGE_HEADER,
    Place,
    in_order,
    kept_places,
    load_chunk,
    messages_in,
)
from bagassets.recordings.mcap_index import McapIndex, read_index, walk
from bagassets.recordings.model import Definition, OnRead, Serialization
from bagassets.recordings.recording import FileRecording, merged
from bagassets.recordings.schemas import foxglove_type, schema_definition
from bagassets.recordings.sizes import Sizes
from bagassets.recordings.topic import UNKNOWN, TopicSource, is_transient_local, normalise_msgtype

_ENCODINGS: Mapping[str, Serialization] = {
    "cdr": "cdr",
    "ros1": "ros1",
    "protobuf": "protobuf",
    "json": "json",
}
_FORMATS = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl", "omgidl": "idl"}
# Waiting messages in chunks that overlap in time; their places take a few hundred megabytes.
_MOST_WAITING = 10_000_000
_CHANNEL, _TIME_AT, _TIME_END = Struct("<H"), 6, 14
_FEW_CHUNKS = 100  # as many seeks as the index behind each of them takes


class McapFile:
    """One file; close it.

    Args:
        path: the file.
        limits: of the recipe.
        on_read: called with how far reading has come.
        whole: bounds on the recording that it is a part of.
        search: look for what its summary lacks; else that is damage.
    """

    def __init__(
        self,
        path: Path,
        limits: Limits,
        on_read: OnRead | None = None,
        whole: Sizes | None = None,
        *,
        search: bool = True,
    ) -> None:
        self.path = path
        self._on_read = on_read
        self.check = False
        self._limits = limits
        self._file = path.open("rb")
        try:
            self._size = os.fstat(self._file.fileno()).st_size
            self._sizes = Sizes(path, self._size, limits, whole)
            self._index = self._read_index(search=search)
        except BaseException:
            self._file.close()
            raise

    def _read_index(self, *, search: bool) -> McapIndex:
        return read_index(self._file, self.path, self._sizes, search=search)

    def counts(self) -> Mapping[int, int]:
        """Return channel -> number of messages, as the file announces it."""
        return self._index.counts

    def sources(self, counts: Mapping[int, int] = MappingProxyType({})) -> dict[int, TopicSource]:
        """Return channel -> topic, type, definition, and one of `counts`."""
        return {
            channel.id: TopicSource(
                channel.topic,
                _type_of(channel, schema),
                counts.get(channel.id, 0),
                _definition(schema),
                _serialization(channel, schema),
                _problem(channel, schema),
                is_transient_local(channel.metadata.get("offered_qos_profiles", "")),
            )
            for channel in self._index.channels.values()
            for schema in (self._index.schemas.get(channel.schema_id),)
        }

    def span_ns(self) -> tuple[int, int] | None:
        """Return first and last log time; None without messages, or if the file does not say."""
        return self._index.span_ns

    def log_times_as_written(self) -> dict[int, NDArray[np.int64]]:
        """Return channel -> (N,) log times in nanoseconds in the order in which they were written, of many chunks when they begin."""
        if len(self._index.chunks) <= _FEW_CHUNKS:
            return self.log_times()
        starts: dict[int, list[int]] = {}
        for chunk in sorted(self._index.chunks, key=lambda one: one.offset):
            for channel in chunk.channels or ():
                starts.setdefault(channel, []).append(chunk.start_ns)
        return {channel: np.array(some) for channel, some in starts.items()}

    def log_times(self) -> dict[int, NDArray[np.int64]]:
        """Return channel -> (N,) log times in nanoseconds, but for those in chunks without an index."""
        times: dict[int, list[NDArray[np.int64]]] = {}
        for opcode, begin, end in walk(self._file, self._size):
            if opcode in {Opcode.MESSAGE, Opcode.MESSAGE_INDEX}:
                # Both have a channel, four bytes, and a time; an index goes on with an offset, the next time, and so on.
                self._file.seek(begin)
                data = self._file.read(_TIME_END if opcode == Opcode.MESSAGE else end - begin)
                (channel,) = _CHANNEL.unpack_from(data)
                values = np.frombuffer(data, "<i8", offset=_TIME_AT)
                as_written = np.argsort(values[1::2], kind="stable") if len(values) > 1 else [0]
                times.setdefault(channel, []).append(values[::2][as_written])
        return {channel: np.concatenate(some) for channel, some in times.items()}

    def messages(self, channels: Collection[int]) -> Iterator[tuple[int, int, bytes | memoryview]]:
        """Yield channel, log time and payload in order of log time, then of position in the file."""
        return self._in_chunks(channels) if self._index.chunks else self._outside_chunks(channels)

    def _in_chunks(self, channels: Collection[int]) -> Iterator[tuple[int, int, bytes | memoryview]]:
        chunks = LatestChunks(self._load, self._limits.chunk_bytes, self._sizes.unpacked_bytes, kept=64)
        waiting = 0

        def places_in(offset: int) -> Iterator[tuple[int, int, int, int, int]]:
            nonlocal waiting
            places = kept_places(self._messages_in(offset, chunks.at(offset), channels))
            if waiting and waiting + len(places) > _MOST_WAITING:
                raise DamageError("too many of its chunks overlap in time; run `mcap sort` on it")
            waiting += len(places)
            for place in in_order(places):
                yield *place, offset
                waiting -= 1
            chunks.drop(offset)

        streams = [
            (chunk.start_ns, chunk.offset, places_in(chunk.offset))
            for chunk in self._index.chunks
            if chunk.channels is None or not chunk.channels.isdisjoint(channels)
        ]
        for log_time_ns, channel, begin, end, offset in merged(streams, itemgetter(0)):
            yield channel, log_time_ns, detached(memoryview(chunks.at(offset))[begin:end])

    def _messages_in(self, _: int, content: bytes, channels: Collection[int]) -> Iterator[Place]:
        return messages_in(content, channels)

    def _load(self, offset: int) -> bytes:
        return load_chunk(
            self._file, self.path, offset, self._sizes, check=self.check, on_read=self._tell_position
        )

    def _outside_chunks(self, channels: Collection[int]) -> Iterator[tuple[int, int, bytes | memoryview]]:
        """Read messages that are in no chunk."""
        for log_time_ns, channel, begin, end in in_order(kept_places(self._places_outside(channels))):
            self._file.seek(begin)
            data = self._file.read(end - begin)
            self._tell_position(data)
            yield channel, log_time_ns, data

    def _places_outside(self, channels: Collection[int]) -> Iterator[Place]:
        for opcode, begin, end in walk(self._file, self._size):
            if opcode == Opcode.MESSAGE:
                self._file.seek(begin)
                header = self._file.read(min(MESSAGE_HEADER.size, end - begin))
                channel, _, log_time_ns, _ = MESSAGE_HEADER.unpack(header)
                if channel in channels:
                    yield log_time_ns, channel, begin + MESSAGE_HEADER.size, end

    def _tell_position(self, data: bytes) -> None:
        if self._on_read is not None:
            self._on_read(self.path, self._file.tell(), data)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class McapRecording(FileRecording[McapFile]):
    """A bare `.mcap` file with messages in CDR, ROS 1, protobuf or JSON; other encodings cost their topic."""

    def check_content(self) -> None:
        """Verify the checksum of every chunk that is read from now on."""
        self._file.check = True


def _type_of(channel: Channel, schema: Schema | None) -> str:
    if schema is None:
        return UNKNOWN
    if schema.encoding == "omgidl":
        return schema.name.replace("::", "/")
    is_ros = channel.message_encoding not in {"protobuf", "json"}
    return normalise_msgtype(schema.name) if is_ros else foxglove_type(schema.name)


def _serialization(channel: Channel, schema: Schema | None) -> Serialization:
    # Some converters copy messages of ROS 1 with their schemas, and say `cdr` of all channels.
    is_ros1 = schema is not None and schema.encoding == "ros1msg" and channel.message_encoding == "cdr"
    return "ros1" if is_ros1 else _ENCODINGS.get(channel.message_encoding, "cdr")


def _problem(channel: Channel, schema: Schema | None) -> str | None:
    """Return why the messages of a channel cannot be decoded, whatever they hold."""
    if channel.message_encoding not in _ENCODINGS:
        return f"its message encoding is '{channel.message_encoding}', not cdr, ros1, protobuf or json"
    # In the IDL of ROS 2 the annotation changes nothing.
    is_omg = schema is not None and schema.encoding == "omgidl"
    if is_omg and "@optional" in IDL_TEXT.sub("", _definition(schema).text):
        return "its type has optional members (@optional), which are not read; record one without them"
    return None


def _definition(schema: Schema | None) -> Definition:
    """Return the definition in a schema.

    Bytes that are not UTF-8 are replaced: most are comments in another encoding, and at worst the topic is lost.
    """
    if (
        schema is not None
        and (given := schema_definition(schema.encoding, schema.name, schema.data)) is not None
    ):
        return given
    if schema is None or schema.encoding not in _FORMATS or not schema.data:
        return Definition("none", "")
    text = schema.data.decode("utf-8", "replace")
    return Definition("idl" if _FORMATS[schema.encoding] == "idl" else "msg", text)
