"""Bytes behind the end of a recording, which no reader looks at."""

from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.stream_reader import MAGIC_SIZE
from rosbags.rosbag1.reader import Header, RecordType

from bagassets.recordings.mcap_chunk import RECORD_HEADER
from bagassets.recordings.rosbag1 import SIZE


def bytes_behind_end(path: Path) -> int:
    """Return how many bytes follow the end of a ROS 1 bag or an MCAP; 0 if its records do not tell where it ends."""
    with suppress(Exception), path.open("rb") as file:  # whatever damaged bytes lead to
        first = file.readline(100)
        end = _end_of_bag(file) if first.startswith(b"#ROSBAG") else _end_of_mcap(file)
        return max(path.stat().st_size - end, 0)
    return 0


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


def _end_of_mcap(file: BinaryIO) -> int:
    file.seek(MAGIC_SIZE)
    opcode = 0
    while opcode != Opcode.FOOTER:
        opcode, length = RECORD_HEADER.unpack(file.read(RECORD_HEADER.size))
        file.seek(length, 1)
    return file.tell() + MAGIC_SIZE
