"""The index of an MCAP file: channels, schemas and chunks, read from its summary or found by walking its records.

The mcap library parses the records of the summary only: it would decompress a chunk of any size.
"""

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import BinaryIO
from zlib import crc32

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics
from mcap.stream_reader import MAGIC_SIZE, StreamReader, read_magic

from bagassets.recordings.damage import DamageError, refuse_failing_disk
from bagassets.recordings.mcap_chunk import RECORD_HEADER, chunk_head, load_chunk, records_in
from bagassets.recordings.sizes import Sizes

# Start of the summary, start of its offsets, checksum.
_FOOTER_BYTES = RECORD_HEADER.size + 8 + 8 + 4
_FOOTER = RECORD_HEADER.pack(Opcode.FOOTER, 8 + 8 + 4)
# What stands before the summary, and a checksum between them.
_DATA_END = RECORD_HEADER.pack(Opcode.DATA_END, 4)

# What messages and their indexes begin with. An index goes on with a length of 4 bytes, and has a time and an offset per message.
CHANNEL = Struct("<H")
ENTRY_BYTES = 16


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """The place of a chunk.

    Attributes:
        offset: of its record in the file.
        start_ns: log time of its earliest message.
        channels: those with messages in it; None if unknown.
    """

    offset: int
    start_ns: int
    channels: frozenset[int] | None


@dataclass
class McapIndex:
    """Channels, schemas and chunks of a file.

    Attributes:
        channels: id -> channel.
        schemas: id -> schema.
        chunks: in order of start and offset; without any, messages are in no chunk.
        counts: channel -> number of messages, as the file announces it.
        span_ns: first and last log time, as the file announces them.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    span_ns: tuple[int, int] | None = None


def read_index(
    file: BinaryIO, path: Path, sizes: Sizes, *, search: bool = True, begins: bool = True
) -> McapIndex:
    """Read the index from the summary, and search the file for what the summary lacks.

    Args:
        file: the open file.
        path: its path.
        sizes: bounds on the recording; counts the sizes that its chunks announce.
        search: if not, what the summary lacks is damage.
        begins: it must begin as an MCAP does.

    Raises:
        SizeLimitError: the file announces more than the recording may hold.
        DamageError: the file is cut short, or the index contradicts itself. On damaged bytes the library raises anything else.
    """
    size = os.fstat(file.fileno()).st_size
    index = McapIndex()
    if begins:
        file.seek(0)
        read_magic(ReadDataStream(file))
    statistics = None
    if summary := _summary_start(file, size):
        statistics = _add_summary(index, file, summary, size, sizes)
    if statistics is None or (
        len(index.channels) < max(1, statistics.channel_count)
        or len(index.chunks) < statistics.chunk_count
        or not statistics.channel_message_counts.keys() <= index.channels.keys()
        or not (index.chunks or statistics.channel_message_counts)
    ):
        if not search:
            raise DamageError("its summary is missing or incomplete")
        _search(file, path, size, index, sizes)
    if statistics is not None:
        index.counts = Counter(statistics.channel_message_counts)
        if statistics.message_count:
            index.span_ns = statistics.message_start_time, statistics.message_end_time
    index.chunks.sort(key=lambda chunk: (chunk.start_ns, chunk.offset))
    return index


def _summary_start(file: BinaryIO, size: int) -> int:
    """Return where the summary begins; 0 if there is none.

    Raises:
        DamageError: there is no footer, since the recorder or a copy was interrupted.
    """
    start = _start_in_footer(file, size)
    if start is not None:
        file.seek(max(0, start - len(_DATA_END) - 4))
        if not start or file.read(len(_DATA_END)) == _DATA_END:
            return start
    # More bytes may follow its footer, such as a second recording, which ends in a footer of its own.
    whole, what = MAGIC_SIZE, "its end is missing or damaged"
    try:
        for opcode, _, end in walk(file, size):
            if opcode == 0:  # no record: zeros that were never written over
                break
            whole = end
        start = _start_in_footer(file, end_of(file, whole))
    except DamageError:
        what = "it is cut short"
    except Exception as err:  # noqa: BLE001  (whatever damaged bytes lead to: `what` says it)
        refuse_failing_disk(Path(file.name), err)
    if start is not None:
        return start
    raise DamageError(f"{what}: of its {size} bytes, the records up to byte {whole} are whole")


def _start_in_footer(file: BinaryIO, end: int) -> int | None:
    """Return where the summary begins, as the footer before an end says; None if there is no footer."""
    file.seek(max(0, end - _FOOTER_BYTES - MAGIC_SIZE))
    head = file.read(len(_FOOTER) + 8)
    return int.from_bytes(head[len(_FOOTER) :], "little") if head.startswith(_FOOTER) else None


def end_of(file: BinaryIO, begin: int = MAGIC_SIZE) -> int:
    """Return where an MCAP ends, whatever follows: behind the first footer after a record that begins at `begin`.

    Raises:
        DamageError: its records do not lead there. On damaged bytes anything else is raised.
    """
    file.seek(begin)
    opcode = 0
    while opcode != Opcode.FOOTER:
        opcode, length = RECORD_HEADER.unpack(file.read(RECORD_HEADER.size))
        if not opcode:  # zeros that were never written over
            raise DamageError("it has no footer")
        file.seek(length, os.SEEK_CUR)
    read_magic(ReadDataStream(file))
    return file.tell()


def _add_summary(index: McapIndex, file: BinaryIO, begin: int, size: int, sizes: Sizes) -> Statistics | None:
    statistics = None
    offsets: set[int] = set()
    file.seek(begin)
    for record in StreamReader(file, skip_magic=True, emit_chunks=True, record_size_limit=size).records:
        if isinstance(record, Schema | Channel):
            _add_record(index, record, sizes)
        elif isinstance(record, Statistics):
            statistics = record
        elif isinstance(record, ChunkIndex):
            offset = record.chunk_start_offset
            if offset in offsets or offset + record.compressed_size > size:
                raise DamageError("its index names a chunk twice, or one beyond the end")
            offsets.add(offset)
            sizes.add_chunk(offset, record.uncompressed_size)
            channels = frozenset(record.message_index_offsets) or None
            index.chunks.append(ChunkPlace(offset, record.message_start_time, channels))
        elif isinstance(record, Footer) and record.summary_crc:
            left, checksum = file.tell() - 4 - begin, 0
            file.seek(begin)
            while block := file.read(min(left, 1 << 20)):
                left, checksum = left - len(block), crc32(block, checksum)
            if checksum != record.summary_crc:
                raise DamageError("its summary does not match its checksum")
            file.seek(4, os.SEEK_CUR)  # to the magic bytes, which the library reads next
    return statistics


def _add_record(index: McapIndex, record: Schema | Channel, sizes: Sizes) -> None:
    if isinstance(record, Schema):
        index.schemas[record.id] = record
    else:
        index.channels[record.id] = record
        sizes.check_connections(len(index.channels))


def _search(file: BinaryIO, path: Path, size: int, index: McapIndex, sizes: Sizes) -> None:
    """Walk the file for channels and chunks that the summary does not list, and count messages."""
    known = {chunk.offset for chunk in index.chunks}
    # Then the index behind each chunk counts the messages; else any chunk may have a channel that the summary lacks.
    is_told = all(chunk.channels and chunk.channels <= index.channels.keys() for chunk in index.chunks)
    is_indexed = False
    for opcode, begin, end in walk(file, size):
        if opcode == Opcode.CHUNK:
            offset = begin - RECORD_HEADER.size
            if is_indexed := is_told and offset in known:
                continue
            head = chunk_head(file, offset)
            sizes.add_chunk(offset, head.unpacked_bytes)
            if offset not in known:
                index.chunks.append(ChunkPlace(offset, head.start_ns, None))
            content = load_chunk(file, path, offset, sizes, check=False)
            for inner, inner_begin, inner_end in records_in(content):
                if inner == Opcode.MESSAGE:
                    index.counts[CHANNEL.unpack_from(content, inner_begin)[0]] += 1
                else:
                    add_bytes(index, inner, content[inner_begin:inner_end], sizes)
        elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            file.seek(begin)
            add_bytes(index, opcode, file.read(end - begin), sizes)
        elif opcode == Opcode.MESSAGE or (opcode == Opcode.MESSAGE_INDEX and is_indexed):
            file.seek(begin)
            (channel,) = CHANNEL.unpack(file.read(CHANNEL.size))
            index.counts[channel] += 1 if opcode == Opcode.MESSAGE else (end - begin) // ENTRY_BYTES


def add_bytes(index: McapIndex, opcode: int, fields: bytes, sizes: Sizes) -> None:
    """Add the schema or channel in the fields of a record."""
    if opcode == Opcode.SCHEMA:
        _add_record(index, Schema.read(ReadDataStream(BytesIO(fields))), sizes)
    elif opcode == Opcode.CHANNEL:
        _add_record(index, Channel.read(ReadDataStream(BytesIO(fields))), sizes)


def walk(file: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """Yield the opcode of each record in the data section, and where its fields begin and end.

    Raises:
        DamageError: a record is cut off.
    """
    begin = MAGIC_SIZE + RECORD_HEADER.size
    while begin <= size:
        file.seek(begin - RECORD_HEADER.size)
        opcode, length = RECORD_HEADER.unpack(file.read(RECORD_HEADER.size))
        if opcode in {Opcode.DATA_END, Opcode.FOOTER}:
            return
        if begin + length > size:
            break
        yield opcode, begin, begin + length
        begin += length + RECORD_HEADER.size
    raise DamageError("it ends too early, or is damaged")
