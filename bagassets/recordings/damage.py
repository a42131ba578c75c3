"""Errors for damaged recordings, in sentences for users."""

import re
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bagassets.base.disk_errors import disk_fails
from bagassets.base.errors import DiskError, RecordingError

_ADVICE = {
    ".bag": "expected a finished ROS 1 bag; try `rosbag reindex` on a copy, or copy it again from where it was recorded",
    ".mcap": "expected a finished MCAP; try `mcap recover`, or copy it again from where it was recorded",
    ".db3": "expected a ROS 2 SQLite bag; try `sqlite3 FILE .recover`, or copy it again from where it was recorded",
    "": "expected a ROS 2 bag folder with metadata.yaml; try `ros2 bag reindex`, or copy it again from where it was "
    "recorded",
}
NO_RECORDING = (
    "it is no recording, or lost its first bytes: remove it, name it in bags.exclude, or copy it again"
)
NOTHING = "a copy or a recorder stopped before it wrote anything: copy it again from where it was recorded, or remove it"
MISNAMED = "whatever its name says"
# How files of each kind begin.
_BEGINNINGS = {
    ".bag": (b"#ROSBAG V", "a ROS 1 bag"),
    ".mcap": (b"\x89MCAP0\r\n", "an MCAP file"),
    ".db3": (b"SQLite format 3\0", "an SQLite database"),
}
_POINTER = b"version https://git-lfs.github.com/spec/"

# Messages of libraries about damaged files, and the clause that users read instead.
_REASONS = (
    (r"not indexed", "it has no index, as if the recorder had been stopped before it was done"),
    (r"index looks damaged", "its index is damaged"),
    (r"seems to be empty", "the file is empty"),
    (r"magic|not a valid MCAP", "it does not begin and end as such a file does"),
    (r"not a database|file is encrypted", "it is no SQLite database"),
    (r"malformed|no such (table|column)|missing tables", "its database is damaged"),
    (r"[Vv]ersion '?([\w.]+)'? is not supported", r"its format version \1 is not supported"),
    (r"encryption '?(\w+)'? is not supported", r"it is encrypted ('\1')"),
    (r"[Cc]ompression '?(\w*)'? is not supported", r"its compression '\1' is not supported"),
    (r"unexpected|[Ee]nd ?[Oo]f ?[Ff]ile|[Tt]runcated|Got only|cut off|incomplete", "it ends too early, or is damaged"),
)  # fmt: skip
NO_BEGINNING = "it does not begin as such a file does"
# Of disks; on damaged bytes SQLite raises others.
_READS_FAIL = {"SQLITE_CANTOPEN", "SQLITE_IOERR_CORRUPTFS", "SQLITE_IOERR_READ"}
_CONTRADICTS = "its bytes contradict each other"


class DamageError(Exception):
    """A reader found a recording damaged; the text is a clause for users."""


def advice_for(path: Path) -> str:
    """Return what kind of file was expected at a path, and what to do about it."""
    return _ADVICE.get("" if path.is_dir() else suffix_of(path), _ADVICE[""])


def begins_as_named(path: Path) -> bool:
    """Tell whether a file begins as those with its suffix do."""
    start, _ = _BEGINNINGS.get(path.suffix, _BEGINNINGS[".db3"])
    with path.open("rb") as file:
        return file.read(len(start)) == start


def without_advice(sentence: str) -> str:
    """Return an error about a recording without what it says to do."""
    for advice in (*_ADVICE.values(), NO_RECORDING, NOTHING):
        sentence = sentence.replace(f"; {advice}.", ".")
    return sentence


def hole_reason(path: Path, err: BaseException) -> str:
    """Return an error about a file as damage maps hold it: in artifacts, the advice stays what it was."""
    return str(err).removeprefix(f"{path}: ").rstrip(".").replace(NO_RECORDING, advice_for(path))


def suffix_of(path: Path) -> str:
    """Return the suffix that tells the format of a file, be it unfinished or packed."""
    return next((suffix for suffix in reversed(path.suffixes) if suffix not in {".active", ".zstd"}), "")


def unreadable(path: Path, err: BaseException) -> RecordingError:
    """Return the error to raise for any exception that reading a recording ended in.

    On damaged bytes libraries raise anything: errors of their own, of databases and decompressors, bare
    assertions, failed lookups. Their texts are for programmers; raise this error from the original one.
    """
    refuse_failing_disk(path, err)
    begins_as = _begins_as(path)
    if begins_as not in {None, suffix_of(path)}:
        return RecordingError(
            f"{path}: its content is that of {_BEGINNINGS[begins_as][1]}, {MISNAMED}; have its name end in {begins_as}."
        )
    reason = _reason(err)
    advice = "correct its permissions" if isinstance(err, PermissionError) else advice_for(path)
    if begins_as is None and path.is_file() and suffix_of(path) in _BEGINNINGS:
        reason = NO_BEGINNING if reason == _CONTRADICTS else reason
        advice = NO_RECORDING if reason.startswith(("it does not begin", "it is no SQLite")) else advice
    return RecordingError(f"{path}: it cannot be read ({reason}); {advice}.")


def refuse_failing_disk(path: Path, err: BaseException) -> None:
    """Raise DiskError if an error comes from a disk that cannot be read, not from what was read."""
    one: BaseException | None = err
    while one is not None:
        name = getattr(one, "sqlite_errorname", "")
        if disk_fails(one) or name in _READS_FAIL:
            why = one.strerror if isinstance(one, OSError) else one
            raise DiskError(
                f"{path}: it cannot be read ({why}); check its disk or file server, and try again."
            ) from err
        one = one.__cause__ or one.__context__


@contextmanager
def damage_passed_over(path: Path) -> Iterator[None]:
    """Leave the block where bytes of a file are damaged, whatever that leads to.

    Raises:
        DiskError: it is the disk that fails.
    """
    try:
        yield
    except Exception as err:  # noqa: BLE001  (whatever damaged bytes lead to)
        refuse_failing_disk(path, err)


def _begins_as(path: Path) -> str | None:
    """Return the suffix that goes with how a file begins, or None if no recording begins like that, or it is not a file."""
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as err:
        refuse_failing_disk(path, err)
        return None
    return next((suffix for suffix, (magic, _) in _BEGINNINGS.items() if head.startswith(magic)), None)


def _reason(err: BaseException) -> str:
    if isinstance(err, DamageError):
        return str(err)
    if isinstance(err, OSError) and err.strerror:
        return err.strerror
    if isinstance(err, MemoryError):
        return "it asks for more memory than there is"
    text = f"{type(err).__name__}: {err}"
    for pattern, reason in _REASONS:
        found = re.search(pattern, text)
        if found is not None:
            return found.expand(reason)
    return "its database is damaged" if isinstance(err, sqlite3.Error) else _CONTRADICTS


def refuse_pointer(path: Path) -> None:
    """Refuse a Git LFS pointer that stands in place of a recording.

    Raises:
        RecordingError: the file is a pointer.
    """
    with path.open("rb") as file:
        if file.read(len(_POINTER)) == _POINTER:
            raise RecordingError(
                f"{path}: this is a Git LFS pointer: the recording itself was not fetched; run `git lfs pull` there."
            )
