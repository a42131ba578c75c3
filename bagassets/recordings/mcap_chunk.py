"""The chunks of an MCAP file: reading one, and finding the messages in it (https://mcap.dev/spec)."""

from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from struct import Struct
from typing import BinaryIO, NamedTuple
from zlib import crc32

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from bagassets.base.errors import RecordingError
from bagassets.recordings.damage import DamageError
from bagassets.recordings.decompress import TooLargeError, decompress
from bagassets.recordings.sizes import Sizes

# Opcode and length before the fields of a record.
RECORD_HEADER = Struct("<BQ")
# Channel, sequence number, log time and publish time before the payload of a message.
MESSAGE_HEADER = Struct("<HIQQ")
# Start, end, uncompressed size, checksum, and length of the compression's name.
_CHUNK_HEADER = Struct("<QQQII")
_SIZE = Struct("<Q")
_LONGEST_NAME = 64

Place = tuple[int, int, int, int]
"""Log time and channel of a message, and where its payload begins and ends."""


class ChecksumError(RecordingError):
    """The content of a chunk does not match its checksum."""


class ChunkHead(NamedTuple):
    """What stands before the content of a chunk: first and last log time, sizes, and length of its record."""

    start_ns: int
    end_ns: int
    unpacked_bytes: int
    checksum: int
    compression: str
    packed_bytes: int
    record_bytes: int


def chunk_head(file: BinaryIO, offset: int) -> ChunkHead:
    """Read what stands before the content of a chunk, up to there.

    Raises:
        DamageError: there is no chunk.
    """
    file.seek(offset)
    opcode, record_bytes = RECORD_HEADER.unpack(file.read(RECORD_HEADER.size))
    start_ns, end_ns, unpacked, checksum, name_length = _CHUNK_HEADER.unpack(file.read(_CHUNK_HEADER.size))
    if opcode != Opcode.CHUNK or name_length > _LONGEST_NAME:
        raise DamageError("its index names a chunk where none is")
    compression = file.read(name_length).decode("ascii", "replace")
    (packed_bytes,) = _SIZE.unpack(file.read(_SIZE.size))
    return ChunkHead(start_ns, end_ns, unpacked, checksum, compression, packed_bytes, record_bytes)


def load_chunk(
    file: BinaryIO,
    path: Path,
    offset: int,
    sizes: Sizes,
    *,
    check: bool,
    on_read: Callable[[bytes], None] | None = None,
) -> bytes:
    """Return the uncompressed content of a chunk.

    Args:
        file: the open file.
        path: its path.
        offset: of the chunk's record in the file.
        sizes: bounds on a chunk.
        check: verify the checksum, if there is one.
        on_read: called with the content as it stands in the file, which has been read up to its end.

    Raises:
        SizeLimitError: the chunk announces more than it may hold.
        DamageError: it holds more than it announces, is cut off, or is no chunk.
        ChecksumError: the content does not match the checksum.
    """
    head = chunk_head(file, offset)
    sizes.check_chunk(offset, head.unpacked_bytes)
    packed = file.read(min(head.packed_bytes, head.record_bytes))
    if len(packed) < head.packed_bytes:
        raise DamageError(f"the chunk at byte {offset} is cut off")
    if on_read is not None:
        on_read(packed)
    try:
        content = decompress(packed, head.compression, head.unpacked_bytes)
    except TooLargeError:
        raise DamageError(f"the chunk at byte {offset} holds more than it announces") from None
    if check and head.checksum and crc32(content) != head.checksum:
        raise ChecksumError(
            f"{path}: the content of the chunk at byte {offset} does not match its checksum, so the file was "
            "damaged after it was recorded; copy it again, or save the other chunks with `mcap recover`."
        )
    return content


def records_in(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the opcode of each record in a chunk, and where its fields begin and end."""
    at, size = 0, len(content)
    while at < size:
        opcode, length = RECORD_HEADER.unpack_from(content, at)
        at += RECORD_HEADER.size
        if at + length > size:
            raise DamageError("a record is cut off")
        yield opcode, at, at + length
        at += length


def messages_in(content: bytes, channels: Collection[int]) -> Iterator[Place]:
    """Yield the places of the messages of some channels in a chunk.

    Raises:
        DamageError: a record is cut off.
    """
    header = MESSAGE_HEADER
    for opcode, begin, end in records_in(content):
        if opcode == Opcode.MESSAGE:
            if begin + header.size > end:
                raise DamageError("a message is cut off")
            channel, _, log_time_ns, _ = header.unpack_from(content, begin)
            if channel in channels:
                yield log_time_ns, channel, begin + header.size, end


def kept_places(found: Iterable[Place]) -> NDArray[np.uint64]:
    """Return places of messages as (N, 4), in a few bytes each, however small the message."""
    return np.fromiter(found, np.dtype((np.uint64, 4)))


def in_order(places: NDArray[np.uint64]) -> Iterator[Place]:
    """Yield (N, 4) places in order of log time; messages of equal time keep their order."""
    for number in np.argsort(places[:, 0], kind="stable"):
        log_time_ns, channel, begin, end = places[number].tolist()
        yield log_time_ns, channel, begin, end
