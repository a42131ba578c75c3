"""The times of labelled frames: from messages, from lines of a file, or from the names of their files."""

import re
from calendar import timegm
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import PurePath

from bagassets.assets.boxes.files.label import UnreadableLabelsError, as_text

_DIGITS = {"ns": 0, "us": 3, "ms": 6, "s": 9}
_MOST_DIGITS = 19
# `12`, `1700000000.25`, and either with the endings of the cloud, as in `12.pcd.bin`.
_NUMBER = re.compile(r"(\d+)(?:\.(\d+))?(?:\.[A-Za-z]\w*)*$")
_DATE = re.compile(r"(\d{4})-(\d\d)-(\d\d)[ T](\d\d):(\d\d):(\d\d)(?:\.(\d{1,9})\d*)?Z?$")


FrameClock = Callable[[str, int | None], int | None]
"""Returns the time of a labelled frame, or None if it has none; given the name of the label file, and the number of the frame
in the label, or None to take it from the name of the file."""


def numbered_frames(stamps_ns: Sequence[int], first: int) -> FrameClock:
    """Return the clock of frames that are counted from `first`, with a list of their stamps."""

    def stamp_ns(file: str, number: int | None) -> int | None:
        if number is None:
            found = _NUMBER.search(PurePath(file).stem)
            if found is None:
                return None
            number = int(found[1])
        return stamps_ns[number - first] if 0 <= number - first < len(stamps_ns) else None

    return stamp_ns


def named_frames(unit: str) -> FrameClock:
    """Return the clock of frames whose time is at the end of the file's name; those numbered inside a file have none."""
    digits = _DIGITS[unit]

    def stamp_ns(file: str, number: int | None) -> int | None:
        found = _NUMBER.search(PurePath(file).stem)
        if found is None or number is not None:
            return None
        return int(found[1] + (found[2] or "")[:digits].ljust(digits, "0"))

    return stamp_ns


def read_times(data: bytes) -> list[int]:
    """Return the stamps of a file with one per line: nanoseconds, or date and time (UTC).

    Raises:
        UnreadableLabelsError: a line is neither.
    """
    stamps = []
    # A blank line is an error: skipping it would shift all later frames.
    for line, text in enumerate(as_text(data).rstrip().splitlines(), start=1):
        word = text.strip()
        if word.isdecimal() and len(word) <= _MOST_DIGITS:
            stamps.append(int(word))
            continue
        found = _DATE.match(word)
        if found is None:
            raise UnreadableLabelsError(
                line, f"{word[:40]!r} is neither a time in nanoseconds nor 2011-09-26 13:02:25.964389445"
            )
        year, month, day, hour, minute, second = (int(part) for part in found.groups()[:6])
        try:
            datetime(year, month, day, hour, minute, min(second, 59), tzinfo=UTC)
        except ValueError as err:
            raise UnreadableLabelsError(line, f"{word!r} is no time: {err}") from None
        seconds = timegm((year, month, day, hour, minute, second))
        stamps.append(seconds * 10**9 + int((found[7] or "0").ljust(9, "0")))
    return stamps
