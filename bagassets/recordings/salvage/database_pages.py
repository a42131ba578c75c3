"""Damaged SQLite files of ROS 2: rows are read from the leaf pages of tables, wherever these lie in the file.

A page tells by itself what it is, and a row by the types of its values which table it is in
(https://www.sqlite.org/fileformat2.html). The pages above the leaves, and the index by time, are not needed.
"""

import os
from collections.abc import Collection, Iterator
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import BagAssetsError
from bagassets.recipe.model import Limits
from bagassets.recordings.damage import DamageError
from bagassets.recordings.database_file import Database
from bagassets.recordings.journals import journals_of, without_journals
from bagassets.recordings.model import Definition, OnRead
from bagassets.recordings.salvage.damage_map import CUT, Damage, Hole
from bagassets.recordings.salvage.find_records import ZEROS
from bagassets.recordings.topic import RefusedBytes, normalise_msgtype

_MAGIC = b"SQLite format 3\0"
_HEADER_BYTES, _LEAF = 100, 0x0D
_PAGE_SIZES = tuple(1 << power for power in range(9, 17))
_BLOCK_BYTES, _SCANNED_BYTES = 4 << 20, 256 << 10
_LEAF_HEAD, _POINTER, _NEXT = Struct(">BHHHB"), Struct(">H"), Struct(">I")
_INTEGER_BYTES = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0)


class _Cell(NamedTuple):
    """A row as it lies in a page: its number, (type, begin, end) of its values, where its bytes begin, how many are here and in all."""

    rowid: int
    values: list[tuple[int, int, int]]
    begin: int
    local: int
    size: int


class TopicRow(NamedTuple):
    """A row of `topics`."""

    name: str
    msgtype: str
    serialization: str
    qos: str


class SalvagedDatabase(Database):
    """Reads the rows of a bag from the pages of its file; close it.

    Args:
        path: the file.
        limits: of the recipe.
        on_read: called with how far reading has come.
        damage: takes what is found damaged.

    Raises:
        DamageError: there is no page with messages.
    """

    def __init__(self, path: Path, limits: Limits, on_read: OnRead | None, damage: Damage) -> None:
        self._path, self._on_read, self._damage, self._limits = path, on_read, damage, limits
        self.topics: dict[int, TopicRow] = {}
        self._definitions: dict[str, Definition] = {}
        self._buffer = bytearray(_SCANNED_BYTES)  # used again and again: it stays in the processor's cache
        self._file = self._opened()
        try:
            self._size = os.fstat(self._file).st_size
            self._page_bytes, self._usable = self._page_size()
            self._written = self._last_written()
            self._rows = self._scan()
        except BaseException:
            os.close(self._file)
            raise

    def _opened(self) -> int:
        """Open the file or, if it has a log or journal that can be applied, a private copy with that applied."""
        if journals_of([self._path]):
            try:
                with without_journals(self._path) as readable:
                    return os.open(readable, os.O_RDONLY)
            except BagAssetsError:
                raise
            except Exception:  # noqa: BLE001  (whatever SQLite says of damaged bytes)
                reason = "what lies beside it cannot be applied, so the last messages are missing"
                size = self._path.stat().st_size
                self._damage.hole(Hole(self._path.name, size, size, reason), is_counted=False)
        return os.open(self._path, os.O_RDONLY)

    def _page_size(self) -> tuple[int, int]:
        """Return the size of a page and how much of it is used: as the header says or, if that is damaged, as most pages are."""
        head = os.pread(self._file, _HEADER_BYTES, 0)
        if len(head) < _HEADER_BYTES:
            raise DamageError("it ends too early, or is damaged")
        named = int.from_bytes(head[16:18], "big")
        named = 65536 if named == 1 else named
        reserved = head[20]
        if head.startswith(_MAGIC) and named in _PAGE_SIZES and self._leaves(named, _SCANNED_BYTES) > 0:
            return named, named - reserved
        found = max(_PAGE_SIZES, key=self._leaves)
        if self._leaves(found) <= 0:
            raise DamageError("it is no SQLite database")
        self._damage.find(
            f"{self._path.name}: its first page is damaged, so what pages hold was found by looking"
        )
        return found, found - (reserved if reserved < 64 and found == named else 0)

    def _leaves(self, page_bytes: int, most_bytes: int = _BLOCK_BYTES) -> int:
        """Return how many rows are whole in the first pages of a file, less those that are not, if its pages are so large."""
        block = os.pread(self._file, most_bytes, 0)
        found = 0
        for at in range(page_bytes, len(block) - page_bytes + 1, page_bytes):
            if block[at] == _LEAF:
                cells = _cells(block[at : at + page_bytes], 0, page_bytes)
                found += sum(-1 if cell is None else 1 for cell in cells)
        return found

    # --- scanning ------------------------------------------------------------------------

    def _scan(self) -> NDArray[np.int64]:
        """Return (N, 6) rows of `messages`, sorted by both of the first: log time, row number, topic, page, place in it, and size.

        A place is where the bytes of a row begin, how many are there, and where in them those of the message begin, 17 bits each.
        """
        found: list[tuple[int, int, int, int, int, int]] = []
        rows: list[NDArray[np.int64]] = []
        per_block = _SCANNED_BYTES // self._page_bytes
        buffer = bytearray(_SCANNED_BYTES)  # not that of chains, which are read meanwhile
        for first in range(0, -(-self._size // self._page_bytes), per_block):
            whole = os.preadv(self._file, [buffer], first * self._page_bytes) // self._page_bytes
            self._tell((first + per_block) * self._page_bytes)
            pages = np.frombuffer(buffer, np.uint8, whole * self._page_bytes).reshape(whole, -1)
            leaves = pages[:, 0] == _LEAF
            if first == 0 and whole:
                leaves[0] = pages[0, _HEADER_BYTES] == _LEAF
            for number in np.flatnonzero(leaves).tolist():
                page = bytes(pages[number])
                found += self._take_page(page, first + number)
            rows.append(np.array(found, np.int64).reshape(-1, 6))
            found.clear()
        together = np.concatenate(rows) if rows else np.empty((0, 6), np.int64)
        _, unique = np.unique(together[:, 1], return_index=True)
        together = together[unique]
        self._note_missing(together)
        return together[np.lexsort((together[:, 1], together[:, 0]))]

    def _last_written(self) -> int:
        """Return the number of pages up to the last one that is not just zeros."""
        end = -(-self._size // self._page_bytes)
        while end:
            begin = max(0, end - _SCANNED_BYTES // self._page_bytes)
            block = os.pread(self._file, (end - begin) * self._page_bytes, begin * self._page_bytes)
            if kept := len(block.rstrip(b"\0")):
                return begin + -(-kept // self._page_bytes)
            end = begin
        return 0

    def _take_page(self, page: bytes, number: int) -> Iterator[tuple[int, int, int, int, int, int]]:
        """Yield the messages of a page, and note rows of other tables."""
        broken = 0
        begin = _HEADER_BYTES if number == 0 else 0
        for cell in _cells(page, begin, self._usable):
            if cell is None:
                broken += 1
                continue
            values = cell.values
            if len(values) == 4 and values[2][0] <= 9 and values[1][0] <= 9 and values[0][0] <= 9:
                # More than a file of this size can hold.
                if not 0 < cell.rowid <= self._size or 0 < values[3][0] < 12:
                    broken += 1
                    continue
                topic, time_ns = _integer(page, *values[1]), _integer(page, *values[2])
                place = cell.begin | cell.local << 17 | values[3][1] - cell.begin << 34
                yield time_ns, cell.rowid, topic, number, place, cell.size
            elif (
                len(values) >= 4
                and values[0][0] <= 9
                and all(kind >= 13 and kind % 2 for kind, _, _ in values[1:4])
            ):
                self._take_texts(cell, self._content(page, cell.begin, cell.local, cell.size))
        if broken:
            begin = number * self._page_bytes
            reason = f"{broken} rows of a page are damaged"
            self._damage.hole(Hole(self._path.name, begin, begin + self._page_bytes, reason))

    def _take_texts(self, cell: _Cell, content: bytes | None) -> None:
        if content is None:
            return
        texts = [
            content[begin - cell.begin : end - cell.begin].decode("utf-8", "replace") if kind >= 13 else ""
            for kind, begin, end in cell.values
        ]
        if texts[2] in {"ros2msg", "ros2idl", "unknown"}:
            if texts[3] and texts[2] != "unknown":
                msgtype = normalise_msgtype(texts[1])
                kind: Any = "idl" if texts[2] == "ros2idl" else "msg"
                self._definitions.setdefault(msgtype, Definition(kind, texts[3]))
        elif "/" in texts[2]:
            self.topics.setdefault(cell.rowid, TopicRow(texts[1], texts[2], texts[3], "".join(texts[4:5])))

    def _note_missing(self, rows: NDArray[np.int64]) -> None:
        """Note what the file lacks: its end, pages that were not written, and messages by the gaps between their numbers."""
        name, end = self._path.name, self._size
        head = os.pread(self._file, 32, 0)
        announced = int.from_bytes(head[28:32], "big") * self._page_bytes
        is_sure = head.startswith(_MAGIC) and 0 < announced < 2**48
        if is_sure and announced > end:
            reason = f"{CUT}: of {announced} bytes there are {end}"
            self._damage.hole(Hole(name, end, announced, reason, _latest(rows)), is_counted=False)
        elif end % self._page_bytes:
            self._damage.hole(Hole(name, end, end, f"{CUT} within a page", _latest(rows)), is_counted=False)
        written = self._written * self._page_bytes
        if written < end - end % self._page_bytes:
            self._damage.hole(Hole(name, written, end, ZEROS, _latest(rows)), is_counted=False)
        numbers = np.concatenate([[0], rows[:, 1]])
        for at in np.flatnonzero(np.diff(numbers) > 1).tolist():
            missing = int(numbers[at + 1] - numbers[at] - 1)
            before, after = rows[at - 1] if at else None, rows[at]
            begin = 0 if before is None else (int(before[3]) + 1) * self._page_bytes
            start_ns = None if before is None else int(before[0])
            reason = "rows are gone, as the numbers of the others tell"
            close = max(begin, int(after[3]) * self._page_bytes)
            self._damage.hole(Hole(name, begin, close, reason, start_ns, int(after[0]), {"": missing}))

    # --- content -------------------------------------------------------------------------

    def _page(self, number: int) -> bytes:
        self._tell((number + 1) * self._page_bytes)
        return os.pread(self._file, self._page_bytes, number * self._page_bytes)

    def _content(self, page: bytes, begin: int, size_here: int, size: int) -> bytes | None:
        """Return the bytes of a row, those on overflow pages included; None if these are not all there."""
        local = page[begin : begin + size_here]
        if size_here == size:
            return local
        (following,) = _NEXT.unpack_from(page, begin + size_here)
        room = self._usable - _NEXT.size
        pieces, left = [local], size - size_here
        while left > 0:
            if not 2 <= following <= self._written:
                return None
            number = min(-(-left // room), _SCANNED_BYTES // self._page_bytes)
            into, at = (
                memoryview(self._buffer)[: number * self._page_bytes],
                (following - 1) * self._page_bytes,
            )
            whole = os.preadv(self._file, [into], at) // self._page_bytes
            if not whole:
                return None
            pages = np.frombuffer(into, np.uint8, whole * self._page_bytes).reshape(whole, -1)
            links = pages[:, : _NEXT.size].copy().view(">u4")[:, 0].astype(np.int64)
            apart = np.flatnonzero(links != np.arange(following + 1, following + whole + 1))
            run = int(apart[0]) + 1 if len(apart) else whole
            piece = pages[:run, _NEXT.size : self._usable].tobytes()
            pieces.append(piece[:left])
            left -= len(pieces[-1])
            following = int(links[run - 1])
        return b"".join(pieces) if following == 0 else None

    # --- as other files of recordings ----------------------------------------------------

    def definitions(self) -> dict[str, Definition]:
        """Return type -> definition."""
        return dict(self._definitions)

    def _topic_rows(self) -> Iterator[tuple[int, str, str, str, str]]:
        return ((number, *row) for number, row in sorted(self.topics.items()))

    def counts(self) -> dict[int, int]:
        """Return topic id -> number of rows."""
        numbers, counts = np.unique(self._rows[:, 2], return_counts=True)
        return dict(zip(numbers.tolist(), counts.tolist(), strict=True))

    def note_unnamed(self) -> None:
        """Note messages of topics that have no row."""
        for number, count in self.counts().items():
            if number not in self.topics:
                reason = f"nothing tells the name of topic {number}"
                self._damage.hole(Hole(self._path.name, -number, -number, reason, lost={"": count}))

    def span_ns(self) -> tuple[int, int] | None:
        """Return first and last log time; None without messages."""
        return (int(self._rows[0, 0]), int(self._rows[-1, 0])) if len(self._rows) else None

    def messages(self, topics: Collection[int]) -> Iterator[tuple[int, int, bytes | memoryview]]:
        """Yield topic id, log time and payload in order of log time."""
        rows = self._rows[np.isin(self._rows[:, 2], list(topics))]
        page, read = b"", -1  # small messages that follow each other mostly share a page
        for time_ns, rowid, topic, number, place, size in _listed(rows):
            begin, size_here, head = place & 0x1FFFF, place >> 17 & 0x1FFFF, place >> 34
            if size - head > self._limits.message_bytes:
                yield topic, time_ns, RefusedBytes()
                continue
            if number != read:
                page, read = self._page(number), number
            content = self._content(page, begin, size_here, size)
            if content is not None:
                yield topic, time_ns, memoryview(content)[head:]
                continue
            at = number * self._page_bytes + begin
            reason = f"the pages of message {rowid} are gone or torn"
            lost = {self.topics[topic].name if topic in self.topics else "": 1}
            self._damage.hole(Hole(self._path.name, at, at + size_here, reason, time_ns, time_ns, lost))

    def _tell(self, position: int) -> None:
        if self._on_read is not None:
            self._on_read(self._path, min(position, self._size), b"")

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def _listed(rows: NDArray[np.int64]) -> Iterator[list[int]]:
    """Yield rows as lists, without making all of them at once."""
    for begin in range(0, len(rows), 10_000):
        yield from rows[begin : begin + 10_000].tolist()


def _latest(rows: NDArray[np.int64]) -> int | None:
    return int(rows[:, 0].max()) if len(rows) else None


def _cells(page: bytes, begin: int, usable: int) -> Iterator[_Cell | None]:
    """Yield what the cells of a leaf hold; None for one that cannot be read, or if none can."""
    _, _, number, _, _ = _LEAF_HEAD.unpack_from(page, begin)
    first = begin + _LEAF_HEAD.size
    if first + _POINTER.size * number > usable:
        yield None
        return
    for place in range(first, first + _POINTER.size * number, _POINTER.size):
        (at,) = _POINTER.unpack_from(page, place)
        try:
            cell = _cell(page, at, usable)
        except (IndexError, DamageError):
            cell = None
        yield cell


def _cell(page: bytes, at: int, usable: int) -> _Cell:
    """Return a row of a table.

    Raises:
        DamageError: there is none.
        IndexError: likewise.
    """
    size, at = (page[at], at + 1) if page[at] < 0x80 else _varint(page, at)
    rowid, begin = _varint(page, at)
    most = usable - 35
    local = size
    if size > most:
        least = (usable - 12) * 32 // 255 - 23
        local = least + (size - least) % (usable - 4)
        local = local if local <= most else least
    if not size > 0 or begin + local + (4 if local < size else 0) > usable:
        raise DamageError("cell")
    head_bytes, at = (page[begin], begin + 1) if page[begin] < 0x80 else _varint(page, begin)
    values, value_at, head_end = [], begin + head_bytes, begin + head_bytes
    if head_end > begin + local:
        raise DamageError("cell")
    while at < head_end:
        kind = page[at]
        if kind < 0x80:
            at += 1
        else:
            kind, at = _varint(page, at)
        length = (kind - 12) >> 1 if kind >= 12 else _INTEGER_BYTES[kind]
        values.append((kind, value_at, value_at + length))
        value_at += length
    if at != head_end or value_at - begin != size or len(values) > 20:
        raise DamageError("cell")
    return _Cell(rowid, values, begin, local, size)


def _varint(page: bytes, at: int) -> tuple[int, int]:
    """Return a number of up to 9 bytes, and where it ends."""
    value = page[at]
    if value < 0x80:
        return value, at + 1
    value &= 0x7F
    for number in range(1, 8):
        byte = page[at + number]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at + number + 1
    value = value << 8 | page[at + 8]
    return value - (1 << 64) if value >= 1 << 63 else value, at + 9


def _integer(page: bytes, kind: int, begin: int, end: int) -> int:
    return kind - 8 if kind in {8, 9} else int.from_bytes(page[begin:end], "big", signed=True)
