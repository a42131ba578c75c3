"""ROS 1 bags: rosbags reads their index, and messages are taken out of the chunks here.

rosbags makes a dictionary of the header of every message and copies its bytes a second time, which
together takes longer than reading the file. Headers of one connection differ in nothing but the time
(https://wiki.ros.org/Bags/Format/2.0, "Message data").
"""

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from heapq import merge
from io import BytesIO
from itertools import repeat
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from rosbags import rosbag1
from rosbags.rosbag1.reader import Chunk, Header, IndexData, ReaderError, RecordType

from bagassets.bags.model import RawMessage
from bagassets.bags.reader import BaseRecording
from bagassets.bags.rosbag import sources_of

__all__ = ["Rosbag1Recording"]

# Chunks overlap with their neighbours; recorders fill them to a megabyte or a few.
_KEPT_CHUNKS = 4

_SIZE = Struct("<I")
_TIME = Struct("<II")


class Rosbag1Recording(BaseRecording):
    """A ROS 1 bag, plain or compressed with lz4 or bz2."""

    def __init__(self, path: Path, message_definitions: Sequence[Path] = ()) -> None:
        self._reader = rosbag1.Reader(path)
        self._reader.open()
        try:
            super().__init__(path, "ros1", sources_of(self._reader.connections, "ros1"), message_definitions)
        except BaseException:
            self._reader.close()
            raise

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        if self._reader.bio is None:
            raise ReaderError("the file was closed")
        chunks = _LatestChunks(self._reader.bio, self._reader.chunks)
        records = [
            _Records(connection.id, connection.topic, self.topics[connection.topic].msgtype)
            for connection in self._reader.connections
            if connection.topic in topics
        ]
        indexes = [
            zip(self._reader.indexes[found.connection], repeat(found), strict=False) for found in records
        ]
        for entry, found in merge(*indexes, key=_time_ns):
            data = found.data(chunks.at(entry.chunk_pos), entry)
            yield RawMessage(found.topic, found.msgtype, entry.time, data)

    def close(self) -> None:
        """Close the file."""
        self._reader.close()


class _LatestChunks:
    """The content of chunks, the last few of which are kept.

    Messages come sorted by time. Where times of neighbouring chunks overlap, as those of many recorders
    do, reading goes back and forth between them, and would decompress each again every time.
    """

    def __init__(self, file: BinaryIO, chunks: Mapping[int, Chunk]) -> None:
        self._file = file
        self._chunks = chunks
        self._kept: dict[int, bytes] = {}
        self._newest = -1

    def at(self, position: int) -> bytes:
        """Return what is in the chunk at a position of the file, decompressed."""
        if position == self._newest:
            return self._kept[position]
        content = self._kept.pop(position, None)
        if content is None:
            chunk = self._chunks[position]
            self._file.seek(chunk.datapos)
            packed = self._file.read(chunk.datasize)
            if len(packed) < chunk.datasize:
                raise ReaderError(f"the chunk at byte {position} is cut off")
            content = chunk.decompressor(packed)
        self._kept[position] = content  # the newest last
        self._newest = position
        if len(self._kept) > _KEPT_CHUNKS:
            del self._kept[next(iter(self._kept))]
        return content


class _Records:
    """Finds the message records of one connection in chunks.

    The first header is parsed. The next ones are compared with what it would be at their time; one that
    differs is parsed in its turn.
    """

    def __init__(self, connection: int, topic: str, msgtype: str) -> None:
        self.connection = connection
        self.topic = topic
        self.msgtype = msgtype
        self._around_time: tuple[bytes, bytes] | None = None

    def data(self, chunk: bytes, entry: IndexData) -> memoryview:
        """Return the bytes of the message that the index announces, as a view of the chunk.

        Raises:
            ReaderError: it is not there.
        """
        begin = entry.offset
        if self._around_time is not None:
            before, after = self._around_time
            header = before + _TIME.pack(*divmod(entry.time, 10**9)) + after
            if chunk.startswith(header, begin):
                return _sized(chunk, begin + len(header))
        return _sized(chunk, self._parse(chunk, entry))

    def _parse(self, chunk: bytes, entry: IndexData) -> int:
        """Return where the header of a record ends."""
        source = BytesIO(chunk)  # shares the bytes
        source.seek(entry.offset)
        begin = entry.offset
        while (header := Header.read(source)).get_uint8("op") == RecordType.CONNECTION:
            begin = source.seek(_SIZE.size + len(_sized(chunk, source.tell())), os.SEEK_CUR)
        end = source.tell()
        told = header.get_uint8("op"), header.get_uint32("conn"), header.get_time("time")
        if told != (RecordType.MSGDATA, self.connection, entry.time):
            raise ReaderError(f"the index announces a message of {self.topic} where none is")
        before, found, after = chunk[begin:end].partition(b"time=" + header["time"])
        if found:
            self._around_time = before + found[: -_TIME.size], after
        return end


def _sized(data: bytes, begin: int) -> memoryview:
    """Return the bytes whose number stands at `begin`."""
    (size,) = _SIZE.unpack_from(data, begin)
    begin += _SIZE.size
    if begin + size > len(data):
        raise ReaderError(f"a record of {size} bytes is cut off")
    return memoryview(data)[begin : begin + size]


def _time_ns(found: tuple[IndexData, _Records]) -> int:
    return found[0].time
