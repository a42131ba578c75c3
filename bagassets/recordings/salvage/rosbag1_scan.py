"""Damaged ROS 1 bags: chunks are found by their records, and messages by the index behind each chunk or by theirs.

Where the index behind a chunk is whole and its connections are known, the chunk is not unpacked before its messages are
due (https://wiki.ros.org/Bags/Format/2.0).
"""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import Chunk, ChunkInfo, Header, RecordType

from bagassets.base.errors import SizeLimitError
from bagassets.recipe.model import Limits
from bagassets.recordings.chunks import LatestChunks, detached
from bagassets.recordings.damage import NO_BEGINNING, DamageError, refuse_failing_disk
from bagassets.recordings.model import OnRead
from bagassets.recordings.rosbag1 import ENTRY, SIZE, IndexReader, Records, in_order, sized, text_in, times_of
from bagassets.recordings.salvage.damage_map import NO_INDEX, Damage, Extent, Hole, times_around
from bagassets.recordings.salvage.find_records import next_record, reaches_into_zeros, scan, what_is_there
from bagassets.recordings.salvage.unpack import unpack_chunk

_MAGIC = b"#ROSBAG V2.0\n"
_LONGEST_RECORD = 64_000_000  # but for those of chunks and messages
# Headers of chunks and messages have the same fields everywhere, in any order, and so one length each.
_CHUNK_BEGINNING = re.compile(
    rb"[\x28\x29]\0\0\0(?:[\x0f\x10]\0\0\0compression=|\x04\0\0\0op=\x05|\x09\0\0\0size=)", re.DOTALL
)
_MESSAGE_BEGINNING = re.compile(
    rb"\x26\0\0\0(?:\x09\0\0\0conn=|\x04\0\0\0op=\x02|\x0d\0\0\0time=)", re.DOTALL
)


@dataclass(slots=True)
class _Found:
    """A chunk: where it and its index end, and connection -> entries of its index.

    Its file may end before it does; or it was being written, and its length is not known.
    """

    end: int
    is_cut: bool
    is_open: bool
    index: dict[int, NDArray[np.void]] = field(default_factory=dict)


class SalvagedBag(IndexReader):
    """Reads what is whole of a bag; it is opened at once.

    Args:
        path: the file.
        limits: of the recipe.
        on_read: called with how far reading has come.
        damage: takes what is found damaged.
    """

    def __init__(self, path: Path, limits: Limits, on_read: OnRead | None, damage: Damage) -> None:
        self._damage = damage
        self._found: dict[int, _Found] = {}
        self._latest: _Found | None = None  # which the next records may be the index of
        self._data_end = 0  # where the index begins; 0 if nothing says so
        self._by_id: dict[int, Connection] = {}
        self.fields: dict[int, Header] = {}
        self._announced: Counter[int] = Counter()
        self._infos: list[ChunkInfo] = []
        self._counts_at: dict[int, dict[int, int]] = {}
        super().__init__(path, limits, on_read)

    def open(self) -> None:
        """Find the chunks, and what is in them.

        Raises:
            DamageError: it does not begin as a bag does.
            SizeLimitError: it announces more than it may hold.
        """
        self.bio = self._file.open("rb")
        try:
            if not (has_magic := self.bio.read(len(_MAGIC)) == _MAGIC):
                self._damage.find(f"{self._file.name}: its first bytes are damaged")
            is_indexed = self._read_index()
            self._walk(len(_MAGIC), is_indexed=is_indexed)
            is_indexed = is_indexed or self._has_found_index()
            if not has_magic and not self._found:
                raise DamageError(NO_BEGINNING)  # noqa: TRY301  (the file is closed below)
            for position in sorted(self._found):
                self._take_chunk(position)
            self.connections = [self._by_id[one] for one in sorted(self._by_id)]
            if not is_indexed:
                self._note_missing_index()
            self._note_missing_chunks()
        except BaseException:
            self.bio.close()
            raise

    def _read_index(self) -> bool:
        """Read connections and the counts of chunks at the end of the file; return whether all are there."""
        try:
            header = Header.read(self._opened, RecordType.BAGHEADER)
            position, connections = header.get_uint64("index_pos"), header.get_uint32("conn_count")
            if not len(_MAGIC) < position <= self._size:
                return False
            self._data_end = position
            self._opened.seek(position)
            for _ in range(connections):
                self._take_connection(self.read_connection())
            infos = [self.read_chunk_info() for _ in range(header.get_uint32("chunk_count"))]
            while self._names_chunk(self._opened.tell()):
                infos.append(self.read_chunk_info())
        except SizeLimitError:
            raise
        except Exception as err:  # noqa: BLE001  (whatever the library raises on damaged bytes)
            refuse_failing_disk(self._file, err)
            beyond = next_record(self._opened, self._data_end, self._size, _CHUNK_BEGINNING, self._is_chunk)
            if beyond < self._size:  # then what the header takes for the index is none
                self._data_end = 0
            return False
        finally:
            self._compression.clear()
        self._announce(infos)
        return True

    def _has_found_index(self) -> bool:
        """Take the index that the scan came across, to which nothing points; return whether it is whole.

        It names chunks in their order: if the last one there is the last that it names, no more of it is missing.
        """
        places = {info.pos for info in self._infos}
        is_whole = len(places) == len(self._infos) and self._found.keys() <= places
        if self._data_end or not self._found or not is_whole or max(places) > max(self._found):
            return False
        self._damage.find(f"{self._file.name}: nothing points to its index, which is whole")
        self._announce(self._infos)
        for hole in [one for one in self._damage.holes.values() if one.file == self._file.name]:
            self._note_hole(hole.begin, hole.end, hole.reason)
        return True

    def _announce(self, infos: list[ChunkInfo]) -> None:
        self.chunk_infos = infos
        self._counts_at = {info.pos: info.connection_counts for info in infos}
        for info in infos:
            self._announced.update(info.connection_counts)

    def read_connection(self) -> Connection:
        """Read one connection, and keep its fields for a copy."""
        begin = self._opened.tell()
        self._connections_read = len(self._by_id)  # the same one may be met several times
        one = super().read_connection()
        self._opened.seek(begin)
        Header.read(self._opened)
        self.fields[one.id] = Header.read(self._opened)
        return one

    def _take_connection(self, one: Connection) -> None:
        self._by_id.setdefault(one.id, one)

    # --- records of the file -------------------------------------------------------------

    def _walk(self, begin: int, *, is_indexed: bool) -> None:
        """Find all chunks with their indexes, and what is left of that of the bag; holes between chunks are noted."""
        data_end = self._data_end or self._size
        end = data_end if is_indexed else self._size
        found_there = scan(self._opened, begin, end, self._record, _CHUNK_BEGINNING, self._is_chunk)
        for hole_begin, hole_end, op in found_there:
            if op is None and hole_begin < data_end:
                self._note_hole(hole_begin, min(hole_end, data_end))

    def _record(self, begin: int) -> tuple[int, int]:
        """Take the record at a position; return its opcode and where it ends."""
        header, at, size = self._header(begin)
        end, op = at + size, header.get_uint8("op")
        if op == RecordType.CHUNK:
            compression, unpacked = text_in(header, "compression"), header.get_uint32("size")
            if compression not in {"none", "bz2", "lz4"}:
                raise DamageError("compression")
            most = max(unpacked, size if compression == "none" else 0)
            if most > self._limits.chunk_bytes:
                raise DamageError("size")
            self._sizes.add_chunk(begin, most)
            if is_open := not size and not unpacked:  # recorders fill these in when a chunk is done
                most = min(self._size - at, self._limits.chunk_bytes)
                end, unpacked = self._size + 1, most if compression == "none" else self._limits.chunk_bytes
                self._damage.find(f"{self._file.name}: its last chunk was being written")
            self.chunks[begin] = Chunk(min(end, self._size) - at, at, bytes)
            self._compression[begin] = compression, unpacked
            self._latest = self._found[begin] = _Found(min(end, self._size), end > self._size, is_open)
            return op, self._latest.end
        if end > self._size or size > _LONGEST_RECORD:
            raise DamageError("cut off")
        latest = self._latest
        if op == RecordType.IDXDATA and latest is not None and begin == latest.end:
            if size != header.get_uint32("count") * ENTRY.itemsize or header.get_uint32("ver") != 1:
                raise DamageError("index")
            self._opened.seek(at)
            latest.index[header.get_uint32("conn")] = np.frombuffer(self._opened.read(size), ENTRY)
            latest.end = end
        elif op == RecordType.CONNECTION:
            self._opened.seek(begin)
            self._take_connection(self.read_connection())
        elif op == RecordType.CHUNK_INFO:
            self._opened.seek(begin)
            self._infos.append(Reader.read_chunk_info(self))  # in the order of the file, behind all chunks
        elif op not in {RecordType.BAGHEADER, RecordType.IDXDATA}:
            raise DamageError("record")
        return op, end

    def _header(self, begin: int) -> tuple[Header, int, int]:
        """Return the header of the record at a position, where its data begin, and their length."""
        header = self._header_at(self._opened, begin)
        (size,) = SIZE.unpack(self._opened.read(SIZE.size))
        return header, self._opened.tell(), size

    def _is_chunk(self, begin: int) -> bool:
        header, _, size = self._header(begin)
        return header.get_uint8("op") == RecordType.CHUNK and size > 0

    def _note_hole(self, begin: int, end: int, reason: str = "") -> None:
        lost: Counter[str] = Counter()
        for info in self.chunk_infos:
            if begin <= info.pos < end:
                lost += self._of_topics(info.connection_counts)
        if not reason:
            reason = what_is_there(self._opened, begin, end)
        known = dict(lost) if self.chunk_infos else None
        self._damage.hole(
            Hole(self._file.name, begin, end, reason, *times_around(self._extents(), begin, end), known)
        )

    def _extents(self) -> list[Extent]:
        spans = [(position, _span_of(one.index.values())) for position, one in self._found.items()]
        return [Extent(position, *span) for position, span in spans if span is not None]

    def _note_missing_index(self) -> None:
        if not self._data_end:
            self._damage.find(f"{self._file.name}: {NO_INDEX}")
            self._damage.end_unknown(self._file.name)
            return
        self._damage.find(f"{self._file.name}: its index is damaged")
        if self._damage.holes:
            self._damage.is_total_known = False

    def _note_missing_chunks(self) -> None:
        for info in self.chunk_infos:
            holes = self._damage.holes.values()
            is_told = any(hole.begin <= info.pos < hole.end for hole in holes if hole.file == self._file.name)
            if info.pos not in self._found and not is_told:
                self._note_hole(info.pos, info.pos + 1, "there is no chunk, although its index names one")

    def _of_topics(self, counts: "Counter[int] | dict[int, int]") -> Counter[str]:
        found: Counter[str] = Counter()
        for one, number in counts.items():
            found[self._by_id[one].topic if one in self._by_id else ""] += number
        return found

    # --- chunks --------------------------------------------------------------------------

    def _take_chunk(self, position: int) -> None:
        """Note the messages of a chunk, by its index if that can be trusted, else by its records."""
        found = self._found[position]
        index = found.index
        if not self._is_sound(position) or not index.keys() <= self._by_id.keys():
            content = self._load(position)
            index = found.index = self._index_of(position, content)
        for one, entries in index.items():
            if one in self._by_id:
                self._entries.setdefault(one, []).append((position, entries))
            else:
                reason = f"nothing describes connection {one}"
                self._damage.hole(Hole(self._file.name, position, found.end, reason, lost={"": len(entries)}))

    def _is_sound(self, position: int) -> bool:
        """Tell whether the index behind a chunk is whole, as far as can be seen without unpacking."""
        found, (compression, unpacked) = self._found[position], self._compression[position]
        if (
            found.is_cut
            or not found.index
            or (compression == "none" and unpacked != self.chunks[position].datasize)
        ):
            return False
        offsets = np.sort(np.concatenate([entries["offset"] for entries in found.index.values()]))
        if len(offsets) and (int(offsets[-1]) >= unpacked or (np.diff(offsets) == 0).any()):
            return False
        if not all(
            (np.diff(times_of(one)) >= 0).all() and (np.diff(one["offset"].astype(np.int64)) > 0).all()
            for one in found.index.values()
        ):
            return False
        if not self.chunk_infos:
            return found.end in self._found  # else more of the index may be missing
        counts = {one: len(entries) for one, entries in found.index.items()}
        return counts == self._counts_at.get(position)

    def _content_end(self, position: int) -> int:
        chunk = self.chunks[position]
        return chunk.datapos + chunk.datasize

    def _load(self, position: int) -> bytes:
        """Return what a chunk holds, as far as it can be read; anything else is noted."""
        chunk, (compression, unpacked) = self.chunks[position], self._compression[position]
        self._opened.seek(chunk.datapos)
        packed = self._opened.read(chunk.datasize)
        if self._on_read is not None:
            self._on_read(self._file, self._opened.tell(), packed)
        found = self._found[position]
        most = max(unpacked, len(packed)) if compression == "none" else unpacked
        content, problem = unpack_chunk(packed, compression, most, is_cut=found.is_cut)
        if problem and not (found.is_open and compression == "none"):  # whose records tell where they end
            end = self._content_end(position)
            own_ns = _span_of(found.index.values())
            if content or own_ns is None:  # what is missing comes after all that was found up to there
                first_ns, last_ns = times_around(self._extents(), end, end)
            else:
                first_ns, last_ns = own_ns
            lost = self._of_topics({one: len(entries) for one, entries in found.index.items()})
            known = dict(lost) if lost and not content else None
            reason = f"the chunk is damaged: {problem}"
            self._damage.hole(Hole(self._file.name, position, end, reason, first_ns, last_ns, known))
        return content

    def _index_of(self, position: int, content: bytes) -> dict[int, NDArray[np.void]]:
        """Return connection -> entries of the records in a chunk; what lies between them is noted."""
        found: dict[int, list[tuple[int, int, int]]] = {}
        for begin, header, end in self._records_in(position, content):
            if header.get_uint8("op") == RecordType.CONNECTION:
                with suppress(Exception):  # one without a topic carries nothing
                    self._take_connection(_read_as(self, BytesIO(content), begin))
            elif end <= len(content):
                time_ns = header.get_time("time")
                found.setdefault(header.get_uint32("conn"), []).append((*divmod(time_ns, 10**9), begin))
        return {one: np.array(entries, ENTRY) for one, entries in found.items()}

    def _records_in(self, position: int, content: bytes) -> Iterator[tuple[int, Header, int]]:
        """Yield where each record in a chunk begins, its header, and where it ends."""
        source = BytesIO(content)

        def record(at: int) -> tuple[Header, int]:
            header = self._header_at(source, at)
            op = header.get_uint8("op")
            if op not in {RecordType.MSGDATA, RecordType.CONNECTION}:
                raise DamageError("record")
            header.get_uint32("conn")
            if op == RecordType.MSGDATA:
                header.get_time("time")
            begin = source.tell() + SIZE.size
            end = begin + len(sized(content, begin - SIZE.size))
            if op == RecordType.MSGDATA and self._reaches_into_zeros(position, source, begin, end):
                raise DamageError("zeros")
            return header, end

        at_hand = self._found[position]
        for begin, end, header in scan(source, 0, len(content), record, _MESSAGE_BEGINNING, record):
            if header is not None:
                yield begin, header, end
            elif not at_hand.is_cut or at_hand.is_open or end < len(content):
                reason = f"bytes {begin} to {end} in the chunk are no record"
                self._damage.hole(Hole(self._file.name, position, self._content_end(position), reason))

    # --- messages ------------------------------------------------------------------------

    def counts(self) -> dict[int, int]:
        """Return connection -> number of messages, announced or found."""
        found = super().counts()
        return {one: max(self._announced[one], found.get(one, 0)) for one in {*found, *self._announced}}

    def span_ns(self) -> tuple[int, int] | None:
        """Return first and last log time of what can be read."""
        return _span_of(entries for parts in self._entries.values() for _, entries in parts)

    def messages(  # type: ignore[override]  # as that of its base
        self, connections: Collection[int]
    ) -> Iterator[tuple[int, int, bytes | memoryview]]:
        """Yield connection, log time and payload in order of log time, of the messages that can be read."""
        chunks = LatestChunks(self._load, self._limits.chunk_bytes, self._sizes.unpacked_bytes)
        records = [Records(one.id, one.topic) for one in self.connections if one.id in connections]
        for number, time_ns, position, offset in in_order([self._index(r.connection) for r in records]):
            content = chunks.at(position)
            try:
                data: memoryview | None = records[number].data(content, time_ns, offset)
                if data and not data[-1]:  # else it was written to its end
                    begin = offset + SIZE.unpack_from(content, offset)[0] + 2 * SIZE.size
                    if self._reaches_into_zeros(position, BytesIO(content), begin, begin + len(data)):
                        raise DamageError("zeros")  # noqa: TRY301  (as what cannot be read)
            except Exception as err:  # noqa: BLE001  (as above)
                refuse_failing_disk(self._file, err)
                data = self._looked_for(position, content, records[number].connection, time_ns)
            if data is not None:
                yield records[number].connection, time_ns, detached(data)

    def _reaches_into_zeros(self, position: int, content: BytesIO, begin: int, end: int) -> bool:
        """Tell whether a message in a chunk was not written to its end."""
        if self._compression[position][0] != "none":  # else it was unpacked as a whole
            return False
        self._opened.seek(self._content_end(position))
        return reaches_into_zeros(content, begin, end, self._opened.read(SIZE.size))

    def _looked_for(self, position: int, content: bytes, connection: int, time_ns: int) -> memoryview | None:
        """Return a message that is not where the index says, or note that it is lost."""
        for begin, header, _ in self._records_in(position, content) if content else ():
            with suppress(Exception):
                if (header.get_uint32("conn"), header.get_time("time")) == (connection, time_ns):
                    return Records(connection, "").data(content, time_ns, begin)
        if content:
            reason = "its index announces messages where none are"
            hole = Hole(self._file.name, position, self._content_end(position), reason, time_ns, time_ns)
            self._damage.cost(hole, self._by_id[connection].topic)
        return None


def _span_of(index: Iterable[NDArray[np.void]]) -> tuple[int, int] | None:
    """Return first and last log time of entries; None if there are none."""
    times = [times_of(entries) for entries in index if len(entries)]
    return (min(int(one.min()) for one in times), max(int(one.max()) for one in times)) if times else None


def _read_as(bag: SalvagedBag, source: BinaryIO, begin: int) -> Connection:
    """Have a bag read a connection from other bytes."""
    own, bag.bio = bag.bio, source
    try:
        source.seek(begin)
        return bag.read_connection()
    finally:
        bag.bio = own
