"""Going from record to record and, after damage, to where the next one begins, by what records of a format begin with."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, TypeVar

from bagassets.base.errors import SizeLimitError
from bagassets.recordings.damage import damage_passed_over, refuse_failing_disk

T = TypeVar("T")
_BLOCK_BYTES = 1 << 20
_LONGEST_BEGINNING = 256
_ZEROS = 32
ZEROS = "zeros, as if it had not been written to the end"
_MOST_TRIED = 200_000
"""Of noise that looks like beginnings of records: after so many the rest of a file is given up, so that time is bounded."""


def scan(
    file: BinaryIO,
    begin: int,
    end: int,
    record: Callable[[int], tuple[T, int]],
    beginning: re.Pattern[bytes],
    is_record: Callable[[int], object],
) -> Iterator[tuple[int, int, T | None]]:
    """Yield where each record begins and ends, and what it is; of bytes that are no record, None.

    Args:
        file: is searched; it is left at any position.
        begin: where the first one begins.
        end: where to stop.
        record: returns the record at a position and where it ends, or raises anything where there is none.
        beginning: matches how a record may begin, in at most 256 bytes.
        is_record: tells whether there is one at a position; it may raise anything if not.
    """
    while begin < end:
        found: T | None
        try:
            found, after = record(begin)
        except SizeLimitError:
            raise
        except Exception as err:  # noqa: BLE001  (whatever damaged bytes lead to)
            refuse_failing_disk(_path_of(file), err)
            found, after = None, next_record(file, begin + 1, end, beginning, is_record)
        yield begin, after, found
        begin = after


def next_record(
    file: BinaryIO, begin: int, end: int, beginning: re.Pattern[bytes], is_record: Callable[[int], object]
) -> int:
    """Return where the next record begins at or after a byte; `end` if there is none."""
    tried = 0
    while begin < end:
        file.seek(begin)
        block = file.read(min(_BLOCK_BYTES + _LONGEST_BEGINNING, end - begin))
        for found in beginning.finditer(block):
            tried += 1
            if tried > _MOST_TRIED:
                return end
            with damage_passed_over(_path_of(file)):
                if is_record(begin + found.start()):
                    return begin + found.start()
        begin += _BLOCK_BYTES
    return end


def _path_of(file: BinaryIO) -> Path:
    return Path(getattr(file, "name", ""))  # what was unpacked has none


def what_is_there(file: BinaryIO, begin: int, end: int) -> str:
    """Return what stands where no record can be read, as a clause."""
    file.seek(begin)
    is_empty = not file.read(min(end - begin, 4096)).strip(b"\0")
    return ZEROS if is_empty else "no record can be read"


def reaches_into_zeros(file: BinaryIO, begin: int, end: int, beyond: bytes = b"") -> bool:
    """Tell whether a message ends in zeros and zeros follow, so that it was not written to its end.

    Args:
        file: holds it; it is left at any position.
        begin: where the message begins in there.
        end: where it ends.
        beyond: what follows the file, if it is the content of a chunk.
    """
    file.seek(end)
    following = file.read(_ZEROS) or beyond
    if any(following) or not following:
        return False
    file.seek(max(begin, end - _ZEROS))
    tail = file.read(min(end - begin, _ZEROS))
    return bool(tail) and not any(tail)
