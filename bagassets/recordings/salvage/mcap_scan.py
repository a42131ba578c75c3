"""Damaged MCAP files: chunks and messages are found by walking records, and after damage by what they begin with.

Chunks are unpacked by the scan only if nothing else says which channels they hold, and how many messages.
"""

import re
from array import array
from collections import Counter
from collections.abc import Collection, Iterator
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
from bagassets.recordings.damage import NO_BEGINNING, DamageError, damage_passed_over
from bagassets.recordings.mcap_chunk import MESSAGE_HEADER, RECORD_HEADER, ChunkHead, Place, chunk_head
from bagassets.recordings.mcap_file import McapFile
from bagassets.recordings.mcap_index import CHANNEL, ENTRY_BYTES, ChunkPlace, McapIndex, add_bytes, read_index
from bagassets.recordings.model import OnRead
from bagassets.recordings.recording import merged
from bagassets.recordings.salvage.damage_map import CUT, NO_INDEX, Damage, Extent, Hole, times_around
from bagassets.recordings.salvage.find_records import reaches_into_zeros, scan, what_is_there
from bagassets.recordings.salvage.unpack import unpack_chunk
from bagassets.recordings.sizes import Sizes

_CHUNK_HEAD_BYTES = 40  # but for the name of the compression
_CHUNK_BEGINNING = rb"\x06.{5}\0\0\0.{28}(?:\0\0\0\0|\x03\0\0\0lz4|\x04\0\0\0zstd)"
_MESSAGE_BEGINNING = rb"\x05.{4}\0\0\0\0"
_BEGINNING = re.compile(_CHUNK_BEGINNING + b"|" + _MESSAGE_BEGINNING, re.DOTALL)
_LONGEST_RECORD = 64_000_000  # but for chunks and messages
_OPCODES = frozenset(range(0x01, 0x10))
# A chunk whose opcode was changed would end the file, or be the index of another one.
_LENGTHS: dict[int, int] = {Opcode.DATA_END: 4, Opcode.FOOTER: 20}
_INDEX_HEADER = Struct("<HI")
_LAST_NS = 2**63 - 1
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
        self._damage = damage
        self._extents: list[Extent] = []
        self._outside = array("Q")  # log time, channel, begin and end of each message outside of chunks
        self._in_chunk: dict[int, Counter[int]] = {}
        self._ends: dict[int, int] = {}
        self._chunk = -1  # which the next records may be the index of
        super().__init__(path, limits, on_read, whole)

    def _read_index(self, *, search: bool) -> McapIndex:
        del search
        self._index = McapIndex()
        announced = self._announced()
        self._has_chunks = announced is not None and bool(announced.chunks)
        has_end = self._walk()
        if not self._index.channels:
            raise DamageError(NO_BEGINNING if not self._ends and not self._outside else "it has no channels")
        found = sum(self._in_chunk.values(), Counter(self._outside[1::4]))
        if announced is None:
            finding = "its summary is missing or damaged" if has_end else NO_INDEX
            self._damage.find(f"{self.path.name}: {finding}")
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
        return self._index

    def _announced(self) -> McapIndex | None:
        """Return what the summary says, and take its channels; None without one that can be read."""
        with damage_passed_over(self.path):
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
        for begin, end, opcode in scan(
            self._file, MAGIC_SIZE, self._size, self._record, _BEGINNING, self._is_record
        ):
            if opcode is None:
                self._close_chunk(is_last=True)
                self._note_hole(begin, end)
            elif opcode in {Opcode.DATA_END, Opcode.FOOTER}:
                self._close_chunk()
                return True
            elif opcode != Opcode.MESSAGE_INDEX:
                self._close_chunk()
                self._chunk = begin if opcode == Opcode.CHUNK else -1
        self._close_chunk(is_last=True)
        return False

    def _record(self, begin: int) -> tuple[int, int]:
        """Take the record at a position; return its opcode and where it ends."""
        opcode, length = self._header(begin)
        at, end = begin + RECORD_HEADER.size, begin + RECORD_HEADER.size + length
        if opcode == Opcode.CHUNK:
            self._take_chunk(begin, min(end, self._size))
            return opcode, min(end, self._size)
        is_long = length > _LONGEST_RECORD and opcode != Opcode.MESSAGE
        if end > self._size or is_long or length != _LENGTHS.get(opcode, length):
            raise DamageError("cut off")
        self._file.seek(at)
        if opcode == Opcode.MESSAGE:
            channel, _, time_ns, _ = MESSAGE_HEADER.unpack(self._file.read(MESSAGE_HEADER.size))
            if time_ns > _LAST_NS or reaches_into_zeros(self._file, at + MESSAGE_HEADER.size, end):
                raise DamageError("message")
            self._outside.extend((time_ns, channel, at + MESSAGE_HEADER.size, end))
        elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            add_bytes(self._index, opcode, self._file.read(length), self._sizes)
        elif opcode == Opcode.MESSAGE_INDEX and self._chunk >= 0:
            channel, entries_bytes = _INDEX_HEADER.unpack(self._file.read(_INDEX_HEADER.size))
            if entries_bytes != length - _INDEX_HEADER.size:
                raise DamageError("index")
            self._in_chunk[self._chunk][channel] += entries_bytes // ENTRY_BYTES
        return opcode, end

    def _header(self, begin: int) -> tuple[int, int]:
        self._file.seek(begin)
        opcode, length = RECORD_HEADER.unpack(self._file.read(RECORD_HEADER.size))
        if opcode not in _OPCODES and opcode < 0x80:  # those above are private
            raise DamageError("record")
        return opcode, length

    def _is_record(self, begin: int) -> bool:
        """Tell whether a chunk or a message begins there: of a message, the channel must be known, and a record follow."""
        opcode, length = self._header(begin)
        end = begin + RECORD_HEADER.size + length
        if opcode == Opcode.CHUNK:
            self._head(begin)
            return True
        is_packed = self._ends or self._has_chunks  # packed chunks may hold whole messages
        if is_packed or end > self._size or length < MESSAGE_HEADER.size:
            return False
        channel, _, time_ns, published_ns = MESSAGE_HEADER.unpack(self._file.read(MESSAGE_HEADER.size))
        if channel not in self._index.channels or abs(time_ns - published_ns) >= _FROM_DAY_NS:
            return False
        return end == self._size or self._header(end)[0] in _OPCODES

    def _head(self, begin: int) -> ChunkHead:
        """Return what stands before the content of a chunk.

        Raises:
            DamageError: no chunk can be like that.
        """
        head = chunk_head(self._file, begin)
        length = _CHUNK_HEAD_BYTES + len(head.compression) + head.packed_bytes
        is_too_large = max(head.unpacked_bytes, head.packed_bytes) > self._limits.chunk_bytes
        if head.compression not in {"", "lz4", "zstd"} or head.record_bytes != length or is_too_large:
            raise DamageError("chunk")
        return head

    def _take_chunk(self, begin: int, end: int) -> None:
        head = self._head(begin)
        self._sizes.add_chunk(begin, head.unpacked_bytes)
        self._index.chunks.append(ChunkPlace(begin, head.start_ns, None))
        self._extents.append(Extent(begin, head.start_ns, head.end_ns))
        self._in_chunk[begin], self._ends[begin] = Counter(), end

    def _close_chunk(self, *, is_last: bool = False) -> None:
        """Unpack the chunk at hand if the index behind it leaves questions; other indexes may be missing where the file ends."""
        chunk, self._chunk = self._chunk, -1
        counts = self._in_chunk.get(chunk)
        if counts is None or (counts and counts.keys() <= self._index.channels.keys() and not is_last):
            return
        found: Counter[int] = Counter()
        content = self._load(chunk)
        for opcode, begin, end in self._records_in(chunk, content):
            if opcode == Opcode.MESSAGE:
                found[CHANNEL.unpack_from(content, begin)[0]] += 1
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
        with damage_passed_over(self.path):
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
        head = self._head(offset)
        packed = self._file.read(head.packed_bytes)
        self._tell_position(packed)
        is_cut = len(packed) < head.packed_bytes
        content, problem = unpack_chunk(packed, head.compression, head.unpacked_bytes, is_cut=is_cut)
        if not problem and head.checksum and crc32(content) != head.checksum:
            content, problem = b"", "its content does not match its checksum"
        if problem:
            counts = self._in_chunk[offset]
            lost = Counter[str]()
            for channel, number in counts.items():
                known = self._index.channels.get(channel)
                lost["" if known is None else known.topic] += number
            reason = f"the chunk is damaged: {problem}"
            span = (head.start_ns, head.end_ns)
            named = dict(lost) if lost and not content else None
            self._damage.hole(Hole(self.path.name, offset, self._ends[offset], reason, *span, named))
        return content

    def _records_in(self, offset: int, content: bytes) -> Iterator[tuple[int, int, int]]:
        """Yield the opcode of each record in a chunk, and where its fields begin and end; what lies between them is noted."""
        source, head = BytesIO(content), self._head(offset)
        self._file.seek(self._ends[offset])
        is_sure = head.compression or head.checksum
        beyond = b"" if is_sure else self._file.read(16)

        def record(at: int) -> tuple[tuple[int, int], int]:
            (opcode, fields), end = _record_in(content, at)
            begin = fields + MESSAGE_HEADER.size
            if opcode == Opcode.MESSAGE and not is_sure and reaches_into_zeros(source, begin, end, beyond):
                raise DamageError("zeros")
            return (opcode, fields), end

        is_message = partial(self._is_message, content)
        for begin, end, found in scan(source, 0, len(content), record, _BEGINNING, is_message):
            if found is not None:
                yield *found, end
            elif (self.path.name, offset) not in self._damage.holes:
                reason = f"bytes {begin} to {end} in the chunk are no record"
                self._damage.hole(Hole(self.path.name, offset, self._ends[offset], reason))

    def _is_message(self, content: bytes, begin: int) -> bool:
        (opcode, at), end = _record_in(content, begin)
        is_one = opcode == Opcode.MESSAGE and end - at >= MESSAGE_HEADER.size
        return is_one and CHANNEL.unpack_from(content, at)[0] in self._index.channels

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


def _record_in(content: bytes, begin: int) -> tuple[tuple[int, int], int]:
    """Return the opcode of a record in a chunk, where its fields begin, and where they end.

    Raises:
        Exception: there is none.
    """
    opcode, length = RECORD_HEADER.unpack_from(content, begin)
    at = begin + RECORD_HEADER.size
    if opcode not in _OPCODES or at + length > len(content):
        raise DamageError("record")
    if opcode == Opcode.MESSAGE and MESSAGE_HEADER.unpack_from(content, at)[2] > _LAST_NS:
        raise DamageError("time")
    return (opcode, at), at + length
