"""Finding where the next record begins after damage, by what records of a format begin with."""

import re
from collections.abc import Callable
from typing import BinaryIO

_BLOCK_BYTES = 1 << 20
_LONGEST_BEGINNING = 256
_MOST_TRIED = 200_000
"""Of noise that looks like beginnings of records: after so many the rest of a file is given up, so that time is bounded."""


def next_record(
    file: BinaryIO, begin: int, end: int, beginning: re.Pattern[bytes], is_record: Callable[[int], bool]
) -> int:
    """Return where the next record begins at or after a byte; `end` if there is none.

    Args:
        file: is searched; it is left at any position.
        begin: where to begin.
        end: where to stop.
        beginning: matches how a record may begin, in at most 256 bytes.
        is_record: tells whether there is one at a position.
    """
    tried = 0
    while begin < end:
        file.seek(begin)
        block = file.read(min(_BLOCK_BYTES + _LONGEST_BEGINNING, end - begin))
        for found in beginning.finditer(block):
            tried += 1
            if tried > _MOST_TRIED:
                return end
            if is_record(begin + found.start()):
                return begin + found.start()
        begin += _BLOCK_BYTES
    return end


def what_is_there(file: BinaryIO, begin: int, end: int) -> str:
    """Return what stands where no record can be read, as a clause."""
    file.seek(begin)
    is_empty = not file.read(min(end - begin, 4096)).strip(b"\0")
    return "zeros, as if it had not been written to the end" if is_empty else "no record can be read"
