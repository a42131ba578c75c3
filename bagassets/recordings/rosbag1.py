"""ROS 1 bags: rosbags reads the index, and this module takes the messages out of the chunks.

rosbags parses the header of every message into a dictionary and copies its bytes once more, which together takes longer
than reading the file. Headers of one connection differ in their time only (https://wiki.ros.org/Bags/Format/2.0,
"Message data").
"""

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from struct import Struct
from types import MappingProxyType
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from rosbags import rosbag1
from rosbags.interfaces import Connection, ConnectionExtRosbag1, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1.reader import Chunk, ChunkInfo, Header, IndexData, RecordType
from rosbags.rosbag1.reader import normalize as normalise_topic

from bagassets.recipe.model import Limits
from bagassets.recordings.chunks import LatestChunks, detached
from bagassets.recordings.damage import DamageError, damage_passed_over
from bagassets.recordings.decompress import TooLargeError, decompress
from bagassets.recordings.model import Definition, OnRead
from bagassets.recordings.sizes import Sizes
from bagassets.recordings.topic import TopicSource, normalise_msgtype

SIZE = Struct("<I")
_TIME = Struct("<II")
ENTRY = np.dtype([("seconds", "<u4"), ("nanoseconds", "<u4"), ("offset", "<u4")])
_BLOCK = 100_000
_LONGEST_HEADER = 1_000_000


class IndexReader(rosbag1.Reader):
    """Reads the index of a bag, within the recipe's limits; it is opened at once, and knows where its index ends."""

    def __init__(self, path: Path, limits: Limits, on_read: OnRead | None = None) -> None:
        super().__init__(path)
        self._file = path
        self._on_read = on_read
        self._limits = limits
        self._size = path.stat().st_size
        self._sizes = Sizes(path, self._size, limits)
        self._compression: dict[int, tuple[str, int]] = {}
        self._entries: dict[int, list[tuple[int, NDArray[np.void]]]] = {}  # with the position of their chunk
        self._connections_read = 0
        self._index_bytes = 0
        self.index_end = 0
        self.open()

    def open(self) -> None:
        """Open it; raise DamageError if its header and its index do not tell of all that is in it."""
        super().open()
        try:
            self._opened.seek(0)
            self._opened.readline()
            index_begin = Header.read(self._opened, RecordType.BAGHEADER).get_uint64("index_pos")
            self.index_end = max(index_begin, self.index_end)
            is_known = self._entries.keys() <= {one.id for one in self.connections}
            if not is_known or self._names_chunk(self.index_end):
                raise DamageError("its index is damaged")  # noqa: TRY301  (the file is closed below)
        except BaseException:
            self.close()
            raise

    def _names_chunk(self, begin: int) -> bool:
        """Tell whether the index goes on at a position, and names a chunk there."""
        with damage_passed_over(self._file):
            while (header := self._header_at(self._opened, begin)).get_uint8("op") == RecordType.CONNECTION:
                (size,) = SIZE.unpack(self._opened.read(SIZE.size))
                begin = self._opened.tell() + size
            self._opened.seek(begin)
            return header.get_uint8("op") == RecordType.CHUNK_INFO
        return False

    @staticmethod
    def _header_at(source: BinaryIO, begin: int) -> Header:
        """Return the header of the record at a position, and leave its end as the place to read from."""
        source.seek(begin)
        (length,) = SIZE.unpack(source.read(SIZE.size))
        if not 0 < length <= _LONGEST_HEADER:
            raise DamageError("header")
        source.seek(begin)
        return Header.read(source)

    @property
    def _opened(self) -> BinaryIO:
        if self.bio is None:
            raise DamageError("the file was closed")
        return self.bio

    def read_connection(self) -> Connection:
        """Read one connection; bytes that are not UTF-8, most often in comments, are replaced."""
        self._connections_read += 1
        self._sizes.check_connections(self._connections_read)
        header = Header.read(self._opened, RecordType.CONNECTION)
        topic = text_in(header, "topic")
        fields = Header.read(self._opened)
        self.index_end = self._opened.tell()
        return Connection(
            header.get_uint32("conn"),
            normalise_topic(topic) if topic else topic,
            text_in(fields, "type"),
            MessageDefinition(MessageDefinitionFormat.MSG, text_in(fields, "message_definition")),
            "",
            0,
            ConnectionExtRosbag1(None, int(fields.get("latching") == b"1")),
            self,
        )

    def read_chunk_info(self) -> ChunkInfo:
        """Read the place of one chunk."""
        info = super().read_chunk_info()
        self.index_end, counts_bytes = self._opened.tell(), 8 * len(info.connection_counts)
        self._opened.seek(self.index_end - counts_bytes - SIZE.size)
        if SIZE.unpack(self._opened.read(SIZE.size)) != (counts_bytes,):
            raise DamageError("its index is damaged")
        self._opened.seek(self.index_end)
        if info.pos in self._compression:
            raise DamageError("its index names a chunk twice")
        self._compression[info.pos] = ("", 0)
        return info

    def read_chunk(self) -> Chunk:
        """Read the header of a chunk, and check its announced size against the limits."""
        position = self._opened.tell()
        header = Header.read(self._opened, RecordType.CHUNK)
        self._opened.seek(position)
        compression, unpacked_bytes = text_in(header, "compression"), header.get_uint32("size")
        self._sizes.add_chunk(position, unpacked_bytes)
        self._compression[position] = (compression, unpacked_bytes)
        chunk = super().read_chunk()
        if chunk.datapos + chunk.datasize > self._size:
            raise DamageError(f"the chunk at byte {position} is cut off")
        if compression == "none":
            self._sizes.check_chunk(position, chunk.datasize)
        return chunk

    def read_index_data(self, pos: int, indexes: dict[int, list[IndexData]]) -> None:  # noqa: ARG002  (stays empty)
        """Read the index of one connection in a chunk; a forged one could make the same bytes count many times.

        `indexes` is left alone: an object for each message takes longer to make than the message to read.
        """
        file = self._opened
        begin = file.tell()
        header = Header.read(file, RecordType.IDXDATA)
        if header.get_uint32("ver") != 1:
            raise DamageError(f"the index of the chunk at byte {pos} is of an unknown version")
        (size,) = SIZE.unpack(file.read(SIZE.size))
        cut_off = file.tell() + size > self._size  # asked before so much memory is
        if size != header.get_uint32("count") * ENTRY.itemsize or cut_off:
            raise DamageError(f"the index of the chunk at byte {pos} is cut off")
        data = file.read(size)
        self._index_bytes += file.tell() - begin
        if self._index_bytes > self._size:
            raise DamageError("its index names messages twice")
        self._entries.setdefault(header.get_uint32("conn"), []).append((pos, np.frombuffer(data, ENTRY)))

    def _index(self, connection: int) -> tuple[NDArray[np.int64], ...]:
        """Return of the messages of a connection (N,) log times, positions of their chunks in the file, and offsets in these."""
        parts = self._entries.get(connection, [])
        entries = np.concatenate([np.empty(0, ENTRY), *(part for _, part in parts)])
        positions = np.repeat(
            np.array([position for position, _ in parts], dtype=np.int64), [len(part) for _, part in parts]
        )
        return times_of(entries), positions, entries["offset"].astype(np.int64)

    def counts(self) -> dict[int, int]:
        """Return connection -> number of messages."""
        return {number: sum(len(part) for _, part in parts) for number, parts in self._entries.items()}

    def sources(self, counts: Mapping[int, int] = MappingProxyType({})) -> dict[int, TopicSource]:
        """Return connection -> topic, type, definition, and one of `counts`."""
        return {
            one.id: TopicSource(
                one.topic,
                normalise_msgtype(one.msgtype),
                counts.get(one.id, 0),
                Definition("msg", one.msgdef.data),
                "ros1",
                is_latched=bool(getattr(one.ext, "latching", 0)),
            )
            for one in self.connections
        }

    def span_ns(self) -> tuple[int, int] | None:
        """Return first and last log time; None without messages."""
        filled = [chunk for chunk in self.chunk_infos if chunk.connection_counts]
        if not filled:
            return None
        return min(chunk.start_time for chunk in filled), max(chunk.end_time for chunk in filled) - 1

    def log_times(self) -> dict[int, NDArray[np.int64]]:
        """Return connection -> (N,) log times in nanoseconds, in the order in which they were written."""
        indexes = {one.id: self._index(one.id) for one in self.connections}
        return {
            number: times_ns[np.lexsort((offsets, positions))]
            for number, (times_ns, positions, offsets) in indexes.items()
        }

    def log_times_as_written(self) -> dict[int, NDArray[np.int64]]:
        """Return the same: they are all in memory."""
        return self.log_times()

    def messages(  # type: ignore[override]  # by their numbers, and without the objects of connections
        self, connections: Collection[int]
    ) -> Iterator[tuple[int, int, bytes | memoryview]]:
        """Yield connection, log time and payload in order of log time."""
        chunks = LatestChunks(self._load, self._limits.chunk_bytes, self._sizes.unpacked_bytes)
        records = [Records(one.id, one.topic) for one in self.connections if one.id in connections]
        readers = [(record.connection, record.data) for record in records]
        loaded, chunk = -1, b""
        for number, time_ns, position, offset in in_order([self._index(r.connection) for r in records]):
            if position != loaded:
                chunk, loaded = chunks.at(position), position
            connection, read = readers[number]
            yield connection, time_ns, detached(read(chunk, time_ns, offset))

    def _load(self, position: int) -> bytes:
        """Return the uncompressed content of the chunk at a position of the file.

        Raises:
            DamageError: it is cut off, or holds more than it announces.
        """
        chunk, (compression, unpacked_bytes) = self.chunks[position], self._compression[position]
        self._opened.seek(chunk.datapos)
        packed = self._opened.read(chunk.datasize)
        if self._on_read is not None:
            self._on_read(self._file, self._opened.tell(), packed)
        if compression == "none":
            return packed
        try:
            return decompress(packed, compression, unpacked_bytes)
        except TooLargeError:
            raise DamageError(f"the chunk at byte {position} holds more than it announces") from None


class SummaryReader(IndexReader):
    """Reads the end of a bag alone: topics and times, without the index behind each chunk, and so without counts."""

    def read_chunk(self) -> Chunk:
        """Read nothing."""
        return Chunk(0, 0, bytes)

    def read_index_data(self, pos: int, indexes: dict[int, list[IndexData]]) -> None:
        """Read nothing."""


def times_of(entries: NDArray[np.void]) -> NDArray[np.int64]:
    """Return (N,) log times in nanoseconds of entries of an index."""
    times_ns: NDArray[np.int64] = entries["seconds"].astype(np.int64) * 10**9 + entries["nanoseconds"]
    return times_ns


def text_in(header: Header, name: str) -> str:
    """Return a field of a header as text.

    Raises:
        DamageError: it has no such field.
    """
    if name not in header:
        raise DamageError(f"a connection or chunk of its index lacks its {name.replace('_', ' ')}")
    return header[name].decode("utf-8", "replace")


class Records:
    """Finds the message records of one connection in chunks.

    The first header is parsed. Each next one is compared with it but for its time, and parsed only if it differs.
    """

    def __init__(self, connection: int, topic: str) -> None:
        self.connection = connection
        self.topic = topic
        self._alike = Struct("")  # a header like the first one, and the size of the data behind it
        self._around_time = b"", b""

    def data(self, chunk: bytes, time_ns: int, begin: int) -> memoryview:
        """Return the bytes of the message that the index announces, as a view of the chunk.

        Raises:
            DamageError: there is no such message.
        """
        alike = self._alike
        data_begin = begin + alike.size
        if alike.size and data_begin <= len(chunk):
            before, seconds, nanoseconds, after, size = alike.unpack_from(chunk, begin)
            is_alike = (before, after) == self._around_time and seconds * 10**9 + nanoseconds == time_ns
            if is_alike and data_begin + size <= len(chunk):
                return memoryview(chunk)[data_begin : data_begin + size]
        return sized(chunk, self._parse(chunk, time_ns, begin))

    def _parse(self, chunk: bytes, time_ns: int, begin: int) -> int:
        """Return where the header of a record ends."""
        source = BytesIO(chunk)  # shares the bytes of the chunk
        source.seek(begin)
        while (header := Header.read(source)).get_uint8("op") == RecordType.CONNECTION:
            begin = source.seek(SIZE.size + len(sized(chunk, source.tell())), os.SEEK_CUR)
        end = source.tell()
        parsed = header.get_uint8("op"), header.get_uint32("conn"), header.get_time("time")
        if parsed != (RecordType.MSGDATA, self.connection, time_ns):
            raise DamageError(f"the index announces a message of {self.topic} where none is")
        before, stamp, after = chunk[begin:end].partition(b"time=" + header["time"])
        if stamp:
            self._around_time = before + stamp[: -_TIME.size], after
            self._alike = Struct(f"<{end - begin - len(after) - _TIME.size}sII{len(after)}sI")
        return end


def sized(data: bytes, begin: int) -> memoryview:
    """Return the bytes whose length stands at `begin`.

    Raises:
        DamageError: there are fewer.
    """
    (size,) = SIZE.unpack_from(data, begin)
    begin += SIZE.size
    if begin + size > len(data):
        raise DamageError(f"a record of {size} bytes is cut off")
    return memoryview(data)[begin : begin + size]


def in_order(indexes: Sequence[tuple[NDArray[np.int64], ...]]) -> Iterator[tuple[int, int, int, int]]:
    """Yield the number of the index, time, position and offset of each message, in order of time.

    Of messages at the same time, those of the first index come first, as they are in the file.
    """
    if not indexes:
        return
    numbers = np.repeat(np.arange(len(indexes)), [len(times_ns) for times_ns, *_ in indexes])
    columns = [numbers, *map(np.concatenate, zip(*indexes, strict=True))]
    order = np.argsort(columns[1], kind="stable")
    for begin in range(0, len(order), _BLOCK):  # without a Python object for each message of the file at once
        block = order[begin : begin + _BLOCK]
        yield from zip(*(column[block].tolist() for column in columns), strict=True)
