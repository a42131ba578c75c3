"""Content digests of recordings, each file hashed once.

The digest of a file is kept where the file is, as an extended attribute, with the size and
time it holds for; a watcher on a file server may have put it there. Where that cannot be, the
same record goes to an index of our own, which compares inode and change time as well.
"""

import json
import os
import re
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from bagassets.bags.model import Found
from bagassets.errors import ChangedWhileReadError, RecordingError, StoreError
from bagassets.store.canonical import digest_file, digest_json

__all__ = [
    "DigestIndex",
    "RecordingDigest",
    "RecordingStat",
    "assert_unchanged",
    "recording_digest",
    "recording_stat",
    "stored_digest",
]

ATTRIBUTE = "user.bagassets.digest"
_DIGEST = re.compile("[0-9a-f]{64}")


@dataclass(frozen=True)
class RecordingStat:
    """Sizes and times of the files of a recording: name -> (size, mtime_ns)."""

    files: tuple[tuple[str, int, int], ...]

    def as_json(self) -> list[list[Any]]:
        """Return it as JSON."""
        return [list(entry) for entry in self.files]

    @classmethod
    def from_json(cls, value: list[list[Any]]) -> Self:
        """Return what `as_json` gave."""
        return cls(tuple((str(name), int(size), int(mtime_ns)) for name, size, mtime_ns in value))


@dataclass(frozen=True)
class RecordingDigest:
    """The content digest of a recording.

    Attributes:
        digest: of a single file its BLAKE3 digest, else a digest over the sorted (name, digest).
        size: bytes of all files.
        files: name -> digest.
        hashed_bytes: bytes that had to be read for it; 0 if all digests were on record.
    """

    digest: str
    size: int
    files: dict[str, str]
    hashed_bytes: int


class DigestIndex:
    """Digests by path, for files without extended attributes; made when first written to."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "digests.sqlite"

    def get(self, path: Path, stat: os.stat_result) -> str | None:
        """Return the digest on record if nothing about the file differs."""
        if not self._path.is_file():
            return None
        try:
            with self._open() as connection:
                row = connection.execute(
                    "SELECT digest FROM digests WHERE path = ? AND size = ? AND mtime_ns = ? AND inode = ? AND ctime_ns = ?",
                    (str(path), stat.st_size, stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns),
                ).fetchone()
        except sqlite3.Error:
            return None  # another process is just making the table, or the file is damaged: hash
        return None if row is None else str(row[0])

    def put(self, path: Path, stat: os.stat_result, digest: str) -> None:
        """Record a digest of the file as it was at `stat`.

        Raises:
            StoreError: the index cannot be written.
        """
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._open() as connection:
                connection.execute(
                    "CREATE TABLE IF NOT EXISTS digests (path TEXT PRIMARY KEY, size INTEGER, mtime_ns INTEGER, "
                    "inode INTEGER, ctime_ns INTEGER, digest TEXT)"
                )
                connection.execute(
                    "INSERT OR REPLACE INTO digests VALUES (?, ?, ?, ?, ?, ?)",
                    (str(path), stat.st_size, stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns, digest),
                )
        except (OSError, sqlite3.Error) as err:
            raise StoreError(
                f"{self._path}: the index of digests cannot be written ({err}); mend the folder, or delete the file: "
                "it is made anew."
            ) from err

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        connection = sqlite3.connect(self._path, timeout=30)
        try:
            with connection:
                yield connection
        finally:
            connection.close()


def recording_stat(found: Found) -> RecordingStat:
    """Return sizes and times of the files as they are now.

    Raises:
        RecordingError: a file is gone or cannot be read.
    """
    return RecordingStat(tuple((path.name, s.st_size, s.st_mtime_ns) for path, s in _stats(found)))


def assert_unchanged(found: Found, before: RecordingStat) -> None:
    """Check that sizes and times are those of `before`.

    Raises:
        ChangedWhileReadError: they are not.
    """
    if recording_stat(found) != before:
        raise ChangedWhileReadError(
            f"{found.path}: the recording changed while it was read, so nothing was recorded; build again when it is "
            "complete."
        )


def stored_digest(found: Found, index: DigestIndex | None = None) -> str | None:
    """Return the digest if every file has a valid one on record; never reads content."""
    digests = {}
    for path, stat in _stats(found):
        digest = _read_attribute(path, stat) or (index.get(path, stat) if index is not None else None)
        if digest is None:
            return None
        digests[path.name] = digest
    return _combined(digests)


def recording_digest(found: Found, index: DigestIndex | None = None) -> RecordingDigest:
    """Return the digest of a recording, hashing the files that have no valid record.

    Raises:
        RecordingError: a file cannot be read.
        ChangedWhileReadError: a file changed while it was hashed.
        StoreError: the index cannot be written.
    """
    digests: dict[str, str] = {}
    hashed = size = 0
    for path, stat in _stats(found):
        size += stat.st_size
        digest = _read_attribute(path, stat) or (index.get(path, stat) if index is not None else None)
        if digest is None:
            digest = _hash(path, stat)
            hashed += stat.st_size
            if not _write_attribute(path, stat, digest) and index is not None:
                index.put(path, stat, digest)
        digests[path.name] = digest
    return RecordingDigest(_combined(digests), size, digests, hashed)


def _stats(found: Found) -> list[tuple[Path, os.stat_result]]:
    try:
        return [(path, path.stat()) for path in found.files]
    except OSError as err:
        raise RecordingError(f"{err.filename}: cannot be read ({err.strerror}); was it removed?") from err


def _combined(digests: dict[str, str]) -> str:
    if len(digests) == 1:
        return next(iter(digests.values()))
    return digest_json(sorted(digests.items()))


def _hash(path: Path, before: os.stat_result) -> str:
    try:
        digest = digest_file(path)
        after = path.stat()
    except OSError as err:
        raise RecordingError(f"{path}: cannot be read ({err.strerror}).") from err
    if _identity(after) != _identity(before):
        raise ChangedWhileReadError(
            f"{path}: the file changed while it was hashed; build again when it is complete."
        )
    return digest


def _identity(stat: os.stat_result) -> tuple[int, int, int]:
    return stat.st_ino, stat.st_size, stat.st_mtime_ns


def _read_attribute(path: Path, stat: os.stat_result) -> str | None:
    try:
        record = json.loads(os.getxattr(path, ATTRIBUTE))
        digest, held_for = record["digest"], (record["size"], record["mtime_ns"])
        valid = held_for == (stat.st_size, stat.st_mtime_ns) and _DIGEST.fullmatch(digest) is not None
        return str(digest) if valid else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None  # none, not supported here, or not ours: hash instead


def _write_attribute(path: Path, stat: os.stat_result, digest: str) -> bool:
    record = {"digest": digest, "size": stat.st_size, "mtime_ns": stat.st_mtime_ns}
    try:
        os.setxattr(path, ATTRIBUTE, json.dumps(record, sort_keys=True).encode())
    except (OSError, AttributeError):
        return False
    return True
