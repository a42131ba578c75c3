"""Damaged MCAP files: chunks and messages are found by walking records, and after damage by what they begin with.

Chunks are unpacked by the scan only if nothing else says which channels they hold, and how many messages.
"""

import os
import re
from array import array
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from functools import partial
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from struct import Struct
from zlib import crc32

from mcap.opcode import Opcode
from mcap.stream_reader import MAGIC_SIZE

from bagassets.base.errors import SizeLimitError
from bagassets.recipe.model import Limits
from bagassets.recordings.damage import NO_BEGINNING, DamageError
from bagassets.recordings.mcap_chunk import MESSAGE_HEADER, RECORD_HEADER, Place
from bagassets.recordings.mcap_file import McapFile
from bagassets.recordings.mcap_index import ChunkPlace, McapIndex, add_bytes, read_index
from bagassets.recordings.model import OnRead
from bagassets.recordings.recording import merged
from bagassets.recordings.salvage.damage_map import CUT, NO_INDEX, Damage, Extent, Hole, times_around
from bagassets.recordings.salvage.find_records import next_record, what_is_there
from bagassets.recordings.salvage.unpack import unpack_chunk
from bagassets.recordings.sizes import Sizes

# Of a chunk: start, end, uncompressed size, checksum, name of the compression, and the length of what it holds.
_CHUNK = Struct("<QQQII")
_NAMES = {b"": "", b"lz4": "lz4", b"zstd": "zstd"}
_SIZE, _CHANNEL, _ENTRY_BYTES = Struct("<Q"), Struct("<H"), 16
_CHUNK_BEGINNING = rb"\x06.{5}\0\0\0.{28}(?:\0\0\0\0|\x03\0\0\0lz4|\x04\0\0\0zstd)"
_MESSAGE_BEGINNING = rb"\x05.{4}\0\0\0\0"
_BEGINNING = re.compile(_CHUNK_BEGINNING + b"|" + _MESSAGE_BEGINNING, re.DOTALL)
_CHUNKS = re.compile(_CHUNK_BEGINNING, re.DOTALL)
_LONGEST_RECORD = 64_000_000  # but for chunks and messages
_OPCODES = frozenset(range(0x01, 0x10))
_FROM_DAY_NS = 86_400_000_000_000


class SalvagedMcap(McapFile):
    """Reads what is whole of a file; close it.

    Args:
        path: the file.
        limits: of the recipe.
        on_read: called with how far reading has come.
        damage: takes what is found damaged.
        whole: bounds on the recording that it is a part of.

    Raises:
        DamageError: nothing in it looks like an MCAP.
        SizeLimitError: it announces more than it may hold.
    """

    def __init__(
        self,
        path: Path,
        limits: Limits,
        on_read: OnRead | None,
        damage: Damage,
        whole: Sizes | None = None,
    ) -> None:
        self.path, self.check = path, True
        self._on_read, self._limits, self._damage = on_read, limits, damage
        self._file = path.open("rb")
        try:
            self._size = os.fstat(self._file.fileno()).st_size
            self._sizes = Sizes(path, self._size, limits, whole)
            self._index = McapIndex()
            self._extents: list[Extent] = []
            self._outside = array("Q")  # log time, channel, begin and end of each message outside of chunks
            self._in_chunk: dict[int, Counter[int]] = {}
            self._ends: dict[int, int] = {}
            self._scan()
        except BaseException:
            self._file.close()
            raise

    def _scan(self) -> None:
        announced = self._announced()
        self._has_chunks = announced is not None and bool(announced.chunks)
        has_end = self._walk()
        if not self._index.channels:
            raise DamageError(NO_BEGINNING if not self._ends and not self._outside else "it has no channels")
        found = sum(self._in_chunk.values(), Counter(self._outside[1::4]))
        if announced is None:
            self._damage.find(f"{self.path.name}: {NO_INDEX}")
            if not has_end:
                self._damage.end_unknown(self.path.name)
            elif self._damage.holes:
                self._damage.is_total_known = False
        self._index.counts = found | (announced.counts if announced is not None else Counter())
        for channel in self._index.counts.keys() - self._index.channels.keys():
            number = self._index.counts.pop(channel)
            reason = f"{number} messages are of channel {channel}, which is not defined"
            self._damage.hole(
                Hole(self.path.name, self._size + channel, self._size, reason, lost={"": number})
            )
        self._index.chunks.sort(key=lambda chunk: (chunk.start_ns, chunk.offset))
        spans = [one for one in self._all_extents() if self._in_chunk.get(one.begin, True)]
        if spans:
            self._index.span_ns = min(one.first_ns for one in spans), max(one.last_ns for one in spans)

    def _announced(self) -> McapIndex | None:
        """Return what the summary says, and take its channels; None without one that can be read."""
        with suppress(Exception):
            sizes = Sizes(self.path, self._size, self._limits)
            index = read_index(self._file, self.path, sizes, search=False, begins=False)
            self._index.channels |= index.channels
            self._index.schemas |= index.schemas
            if index.counts or index.span_ns is None:
                return index
        return None

    # --- records of the file -------------------------------------------------------------

    def _walk(self) -> bool:
        """Find channels, chunks and messages; what cannot be read between them is a hole. Return whether all were written."""
        begin, chunk = MAGIC_SIZE, -1
        while begin < self._size:
            try:
                opcode, end = self._record(begin, chunk)
            except SizeLimitError:
                raise
            except Exception:  # noqa: BLE001  (whatever damaged bytes lead to)
                self._close_chunk(chunk, is_last=True)
                what = (
                    _CHUNKS if self._ends or self._has_chunks else _BEGINNING
                )  # packed ones may hold whole messages
                at = next_record(self._file, begin + 1, self._size, what, self._is_record)
                self._note_hole(begin, at)
                begin, chunk = at, -1
                continue
            if opcode in {Opcode.DATA_END, Opcode.FOOTER}:
                self._close_chunk(chunk)
                return True
            if opcode == Opcode.CHUNK or (chunk >= 0 and opcode != Opcode.MESSAGE_INDEX):
                self._close_chunk(chunk)
                chunk = begin if opcode == Opcode.CHUNK else -1
            begin = end
        self._close_chunk(chunk, is_last=True)
        return False

    def _record(self, begin: int, chunk: int) -> tuple[int, int]:
        """Take the record at a position; return its opcode and where it ends."""
        opcode, length = self._header(begin)
        at, end = begin + RECORD_HEADER.size, begin + RECORD_HEADER.size + length
        if opcode == Opcode.CHUNK:
            self._take_chunk(begin, min(end, self._size))
            return opcode, min(end, self._size)
        if end > self._size or (length > _LONGEST_RECORD and opcode != Opcode.MESSAGE):
            raise DamageError("cut off")
        self._file.seek(at)
        if opcode == Opcode.MESSAGE:
            channel, _, time_ns, _ = MESSAGE_HEADER.unpack(self._file.read(MESSAGE_HEADER.size))
            self._outside.extend((time_ns, channel, at + MESSAGE_HEADER.size, end))
        elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            add_bytes(self._index, opcode, self._file.read(length), self._sizes)
        elif opcode == Opcode.MESSAGE_INDEX and chunk >= 0:
            (channel,) = _CHANNEL.unpack(self._file.read(_CHANNEL.size))
            self._in_chunk[chunk][channel] += (length - _CHANNEL.size - 4) // _ENTRY_BYTES
        return opcode, end

    def _header(self, begin: int) -> tuple[int, int]:
        self._file.seek(begin)
        opcode, length = RECORD_HEADER.unpack(self._file.read(RECORD_HEADER.size))
        if opcode not in _OPCODES and opcode < 0x80:  # those above are private
            raise DamageError("record")
        return opcode, length

    def _is_record(self, begin: int) -> bool:
        """Tell whether a chunk or a message begins there: of a message, the channel must be known, and a record follow."""
        with suppress(Exception):
            opcode, length = self._header(begin)
            end = begin + RECORD_HEADER.size + length
            if opcode == Opcode.CHUNK:
                self._chunk_fields(begin)
                return True
            if end > self._size or length < MESSAGE_HEADER.size:
                return False
            channel, _, time_ns, published_ns = MESSAGE_HEADER.unpack(self._file.read(MESSAGE_HEADER.size))
            is_near = abs(time_ns - published_ns) < _FROM_DAY_NS
            if channel not in self._index.channels or not is_near:
                return False
            return end == self._size or self._header(end)[0] in _OPCODES
        return False

    def _chunk_fields(self, begin: int) -> tuple[int, int, int, int, str, int, int]:
        """Return start, end, unpacked size, checksum, compression, where the content begins, and its length.

        Raises:
            DamageError: no chunk can be like that.
        """
        opcode, length = self._header(begin)
        start_ns, end_ns, unpacked, checksum, name_length = _CHUNK.unpack(self._file.read(_CHUNK.size))
        name = self._file.read(name_length) if name_length < 8 else b"?"
        (packed,) = _SIZE.unpack(self._file.read(_SIZE.size))
        head = _CHUNK.size + len(name) + _SIZE.size
        is_too_large = unpacked > self._limits.chunk_bytes or packed > self._limits.chunk_bytes
        if opcode != Opcode.CHUNK or name not in _NAMES or length != head + packed or is_too_large:
            raise DamageError("chunk")
        at = begin + RECORD_HEADER.size + head
        return start_ns, end_ns, unpacked, checksum, _NAMES[name], at, packed

    def _take_chunk(self, begin: int, end: int) -> None:
        start_ns, end_ns, unpacked, *_ = self._chunk_fields(begin)
        self._sizes.add_chunk(begin, unpacked)
        self._index.chunks.append(ChunkPlace(begin, start_ns, None))
        self._extents.append(Extent(begin, start_ns, end_ns))
        self._in_chunk[begin], self._ends[begin] = Counter(), end

    def _close_chunk(self, chunk: int, *, is_last: bool = False) -> None:
        """Unpack a chunk if the index behind it leaves questions; other indexes may be missing where the file ends."""
        counts = self._in_chunk.get(chunk)
        if counts is None or (counts and counts.keys() <= self._index.channels.keys() and not is_last):
            return
        found: Counter[int] = Counter()
        content = self._load(chunk)
        for opcode, begin, end in self._records_in(chunk, content):
            if opcode == Opcode.MESSAGE:
                found[_CHANNEL.unpack_from(content, begin)[0]] += 1
            elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                self._add(opcode, content[begin:end])
        self._in_chunk[chunk] = counts | found

    def _add(self, opcode: int, fields: bytes) -> None:
        try:
            add_bytes(self._index, opcode, fields, self._sizes)
        except SizeLimitError:
            raise
        except Exception:  # noqa: BLE001  (as above)
            self._damage.find(f"{self.path.name}: a channel or schema cannot be read")

    def _note_hole(self, begin: int, end: int) -> None:
        reason = what_is_there(self._file, begin, end)
        with suppress(Exception):
            if end == self._size < begin + RECORD_HEADER.size + self._header(begin)[1]:
                reason = CUT
        self._damage.hole(
            Hole(self.path.name, begin, end, reason, *times_around(self._all_extents(), begin, end))
        )

    def _all_extents(self) -> Iterator[Extent]:
        yield from self._extents
        for time_ns, begin in zip(self._outside[::4], self._outside[2::4], strict=True):
            yield Extent(begin, time_ns, time_ns)

    # --- chunks --------------------------------------------------------------------------

    def _load(self, offset: int) -> bytes:
        start_ns, end_ns, unpacked, checksum, compression, at, length = self._chunk_fields(offset)
        self._file.seek(at)
        packed = self._file.read(length)
        self._tell_position(packed)
        content, problem = unpack_chunk(packed, compression, unpacked, is_cut=len(packed) < length)
        if not problem and checksum and crc32(content) != checksum:
            content, problem = b"", "its content does not match its checksum"
        if problem:
            counts = self._in_chunk[offset]
            lost = Counter[str]()
            for channel, number in counts.items():
                known = self._index.channels.get(channel)
                lost["" if known is None else known.topic] += number
            reason = f"the chunk is damaged: {problem}"
            span = (start_ns, end_ns)
            named = dict(lost) if lost and not content else None
            self._damage.hole(Hole(self.path.name, offset, self._ends[offset], reason, *span, named))
        return content

    def _records_in(self, offset: int, content: bytes) -> Iterator[tuple[int, int, int]]:
        """Yield the opcode of each record in a chunk, and where its fields begin and end; what lies between them is noted."""
        begin, size = 0, len(content)
        while begin < size:
            opcode, at, end = _record_in(content, begin)
            if end:
                yield opcode, at, end
                begin = end
                continue
            at = next_record(
                BytesIO(content), begin + 1, size, _BEGINNING, partial(self._is_message, content)
            )
            if (self.path.name, offset) not in self._damage.holes:
                reason = f"bytes {begin} to {at} in the chunk are no record"
                self._damage.hole(Hole(self.path.name, offset, self._ends[offset], reason))
            begin = at

    def _is_message(self, content: bytes, begin: int) -> bool:
        opcode, at, end = _record_in(content, begin)
        if not end or opcode != Opcode.MESSAGE or end - at < MESSAGE_HEADER.size:
            return False
        return _CHANNEL.unpack_from(content, at)[0] in self._index.channels

    def _messages_in(self, offset: int, content: bytes, channels: Collection[int]) -> Iterator[Place]:
        for opcode, begin, end in self._records_in(offset, content):
            if opcode == Opcode.MESSAGE and begin + MESSAGE_HEADER.size <= end:
                channel, _, log_time_ns, _ = MESSAGE_HEADER.unpack_from(content, begin)
                if channel in channels:
                    yield log_time_ns, channel, begin + MESSAGE_HEADER.size, end

    # --- messages ------------------------------------------------------------------------

    def messages(self, channels: Collection[int]) -> Iterator[tuple[int, int, bytes | memoryview]]:
        """Yield channel, log time and payload in order of log time, of the messages that can be read."""
        if not self._outside:
            return self._in_chunks(channels)
        streams = [(0, 0, self._in_chunks(channels)), (0, 1, self._outside_chunks(channels))]
        return merged(streams, itemgetter(1))

    def records(self) -> Iterator[tuple[int, int, int, int, bytes | memoryview]]:
        """Yield channel, sequence number, log time, publish time and payload of each message, in the order of the file."""
        for chunk in sorted(self._index.chunks, key=lambda one: one.offset):
            content = self._load(chunk.offset)
            for opcode, begin, end in self._records_in(chunk.offset, content):
                if opcode == Opcode.MESSAGE and begin + MESSAGE_HEADER.size <= end:
                    head = MESSAGE_HEADER.unpack_from(content, begin)
                    yield *head, memoryview(content)[begin + MESSAGE_HEADER.size : end]
        for begin, end in zip(self._outside[2::4], self._outside[3::4], strict=True):
            self._file.seek(begin - MESSAGE_HEADER.size)
            head = MESSAGE_HEADER.unpack(self._file.read(MESSAGE_HEADER.size))
            yield *head, self._file.read(end - begin)

    @property
    def index(self) -> McapIndex:
        """Channels and schemas."""
        return self._index

    def _places_outside(self, channels: Collection[int]) -> Iterator[Place]:
        columns = (self._outside[number::4] for number in range(4))
        return (place for place in zip(*columns, strict=True) if place[1] in channels)


def _record_in(content: bytes, begin: int) -> tuple[int, int, int]:
    """Return the opcode of a record in a chunk, and where its fields begin and end; end 0 if there is none."""
    at = begin + RECORD_HEADER.size
    if at > len(content):
        return 0, 0, 0
    opcode, length = RECORD_HEADER.unpack_from(content, begin)
    is_one = opcode in _OPCODES and at + length <= len(content)
    return (opcode, at, at + length) if is_one else (0, 0, 0)
