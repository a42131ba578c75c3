"""Bytes behind the end of a recording, which no reader looks at."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from rosbags.rosbag1.reader import Header, RecordType

from bagassets.recordings.journals import journals_of
from bagassets.recordings.mcap_index import end_of as end_of_mcap
from bagassets.recordings.rosbag1 import SIZE


def bytes_behind_end(path: Path) -> Iterator[str]:
    """Yield a clause about each file of a recording that goes on behind its end; not if its records do not tell where that is."""
    for one in sorted(path.iterdir()) if path.is_dir() else [path]:
        with suppress(Exception), one.open("rb") as file:  # whatever damaged bytes lead to
            first = file.readline(100)
            ends = {b"#ROSBAG": _end_of_bag, b"SQLite ": _end_of_database, b"\x89MCAP0\r": end_of_mcap}
            if (more := one.stat().st_size - ends[first[:7]](file)) > 0:
                yield f"{one.name}: behind the end of the recording are {more} more bytes, which are not read"


def _end_of_database(file: BinaryIO) -> int:
    file.seek(0)
    page_bytes, changes, pages, changes_then = Struct(">16xH6xII60xI").unpack(file.read(96))
    if changes != changes_then or not pages or journals_of([Path(file.name)]):
        raise ValueError(pages)  # the number of pages is an older one
    return int(65536 if page_bytes == 1 else page_bytes) * int(pages)


def _end_of_bag(file: BinaryIO) -> int:
    header = Header.read(file, RecordType.BAGHEADER)
    if not (index := header.get_uint64("index_pos")):
        raise ValueError(index)
    file.seek(index)
    for _ in range(header.get_uint32("conn_count") + header.get_uint32("chunk_count")):
        op = Header.read(file).get_uint8("op")
        if op not in {RecordType.CONNECTION, RecordType.CHUNK_INFO}:
            raise ValueError(op)
        (size,) = SIZE.unpack(file.read(SIZE.size))
        file.seek(size, 1)
    return file.tell()
