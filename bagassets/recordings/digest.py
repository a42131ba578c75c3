"""Content digests of recordings, each file hashed once."""

import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Self

from bagassets.base.errors import ChangedWhileReadError, RecordingError
from bagassets.base.json_types import Json
from bagassets.base.trace import span
from bagassets.recordings.digest_record import (
    DigestIndex,
    Disagreement,
    Kept,
    digest_on_record,
    disagreements,
    is_unchanged,
    put_on_record,
)
from bagassets.recordings.journals import journals_of
from bagassets.recordings.model import RecordingFiles
from bagassets.store.canonical import FileHasher, digest_file, digest_json

# The thread that hashes along catches up after so many bytes, and may fall behind by so many: they are still in the page cache.
_FOLLOW_BYTES = 4 << 20
_MOST_BEHIND_BYTES = 32 << 20
# Fewer bytes are read again sooner than they are handed over.
_LEAST_BYTES = 64 << 10
# Two writes within one tick of the kernel's clock leave the same mtime.
_TICK_S = 0.02


@dataclass(frozen=True)
class RecordingStat:
    """What the files of a recording were like at some time.

    Attributes:
        files: name, size and mtime (ns) of each.
        statuses: path and status of each, by which an edit in place is seen although mtime was put back; empty if they are not
            known. They are neither compared nor kept.
        digests: digest of each file, as far as it is known.
    """

    files: tuple[tuple[str, int, int], ...]
    statuses: tuple[tuple[Path, os.stat_result], ...] = field(default=(), compare=False, repr=False)
    digests: Mapping[Path, str] = field(default_factory=dict, compare=False, repr=False)

    @property
    def sizes(self) -> tuple[tuple[str, int], ...]:
        """Name and size of each file."""
        return tuple((name, size) for name, size, _ in self.files)

    def as_of(self, digest: "RecordingDigest") -> Self:
        """Return it with the statuses for which a digest is valid: recording it changed the files' ctimes."""
        paths = [path for path, _ in digest.statuses]
        digests = dict(zip(paths, digest.files.values(), strict=True))
        return replace(self, statuses=digest.statuses, digests=digests)

    def as_json(self) -> list[list[Json]]:
        """Return it as JSON."""
        return [list(entry) for entry in self.files]

    @classmethod
    def from_json(cls, value: list[list[Json]]) -> Self:
        """Return what `as_json` gave."""
        return cls(tuple((str(name), int(size), int(mtime_ns)) for name, size, mtime_ns in value))


@dataclass(frozen=True)
class RecordingDigest:
    """The content digest of a recording.

    Attributes:
        digest: the BLAKE3 digest of a single file; of several, see `combined_digest`.
        size: bytes of all files.
        files: name -> digest; of a series, paths from the folder of its whole drive.
        hashed_bytes: how many bytes were read; 0 if all digests were on record.
        kept: name -> where its digest is on record.
        statuses: path and status of each file, for which the digest is valid.
    """

    digest: str
    size: int
    files: dict[str, str]
    hashed_bytes: int
    kept: dict[str, Kept]
    statuses: tuple[tuple[Path, os.stat_result], ...]


def recording_stat(recording: RecordingFiles) -> RecordingStat:
    """Return the current sizes and times of the files of a recording.

    Raises:
        RecordingError: a file is gone or cannot be read.
    """
    found = tuple(stat_files(recording))
    return RecordingStat(tuple((path.name, s.st_size, s.st_mtime_ns) for path, s in found), found)


def assert_unchanged(recording: RecordingFiles, before: RecordingStat) -> None:
    """Check that sizes and times are still those of `before`, and nobody has edited a file in place.

    If somebody may have, its content decides, where that is known.

    Raises:
        ChangedWhileReadError: somebody has.
    """
    now = recording_stat(recording)
    looks = zip(before.statuses, now.statuses, strict=False)
    if now != before or not all(
        is_unchanged(path, then, status) or _has_digest(path, status, before.digests.get(path))
        for (path, then), (_, status) in looks
    ):
        raise ChangedWhileReadError(
            f"{recording.path}: the recording changed while it was read, so nothing was recorded; build again when it is "
            "complete."
        )


def stored_digest(recording: RecordingFiles, index: DigestIndex | None = None) -> str | None:
    """Return the digest of a recording if all its files have valid ones on record; no content is read.

    Raises:
        RecordingError: a file is gone.
    """
    digests = {}
    for path, stat in stat_files(recording):
        digest = digest_on_record(path, stat, index)
        if digest is None:
            return None
        digests[name_in(recording, path)] = digest
    return combined_digest(recording, digests)


def recording_digest(
    recording: RecordingFiles,
    index: DigestIndex | None = None,
    *,
    rehash: bool = False,
    between: Callable[[int], None] | None = None,
    begun: Mapping[Path, tuple[os.stat_result, FileHasher | None]] = MappingProxyType({}),
) -> RecordingDigest:
    """Return the digest of a recording, hashing the files that have no valid record.

    Args:
        recording: its files.
        index: holds digests that cannot be stored as attributes.
        rehash: hash every file, whatever is on record.
        between: see `hash_file`.
        begun: file -> its status before, and what has begun to hash it, if anything has.

    Raises:
        RecordingError: a file cannot be read.
        ChangedWhileReadError: a file changed while it was hashed.
        StoreError: the index cannot be written.
    """
    digests: dict[str, str] = {}
    kept: dict[str, Kept] = {}
    statuses = []
    hashed = size = 0
    for path, stat in stat_files(recording):
        name = name_in(recording, path)
        size += stat.st_size
        digest = None if rehash else digest_on_record(path, stat, index)
        if digest is None:
            with span("hash", file=path.name):
                before, hasher = begun.get(path, (stat, None))
                digest = hash_file(path, before, between, hasher)
            hashed += stat.st_size
        try:
            kept[name], stat = put_on_record(path, stat, digest, index)  # noqa: PLW2901  (as it is now)
        except OSError as err:
            raise _gone(path, err) from err
        digests[name] = digest
        statuses.append((path, stat))
    return RecordingDigest(combined_digest(recording, digests), size, digests, hashed, kept, tuple(statuses))


def check_digests(recording: RecordingFiles, index: DigestIndex | None) -> Iterator[Disagreement]:
    """Hash all files of a recording, and yield each digest on record that should match but does not.

    Raises:
        RecordingError: a file cannot be read.
        ChangedWhileReadError: a file changed while it was hashed.
    """
    for path, stat in stat_files(recording):
        yield from disagreements(path, stat, hash_file(path, stat), index)


class HashedAlong:
    """Hashes the files of a recording as somebody else reads them, so that the disk gives each byte once for both.

    A thread hashes what the reader has just read, and is never far behind. It reads again what the reader does not hand over,
    like the index between chunks. Close it, or use it as a context manager.

    Args:
        recording: its files; those with a digest on record are not hashed.
        index: see `recording_digest`.
    """

    def __init__(self, recording: RecordingFiles, index: DigestIndex | None = None) -> None:
        self._recording, self._index = recording, index
        self._before = {
            path: stat for path, stat in stat_files(recording) if digest_on_record(path, stat, index) is None
        }
        for stat in self._before.values():
            _wait_a_tick(stat)
        self._hashers: dict[Path, FileHasher] = {}
        self._asked: dict[Path, int] = dict.fromkeys(self._before, 0)
        self._thread = ThreadPoolExecutor(1, "hash")

    def follow(self, path: Path, position: int, data: bytes) -> None:
        """Hash a file up to where its reader has come; errors are left to `finish`, which meets them again.

        Args:
            path: the file.
            position: where its reader has come to.
            data: the bytes before that position, if the reader has them at hand: they need not be read again.
        """
        if path not in self._asked:
            return
        if len(data) < _LEAST_BYTES:
            data = b""
            if position < self._asked[path] + _FOLLOW_BYTES:
                return
        self._asked[path] = position
        hashed = self._thread.submit(self._hash, path, position, data)
        hasher = self._hashers.get(path)  # none until the thread has run for the first time
        if position > (0 if hasher is None else hasher.position) + _MOST_BEHIND_BYTES:
            hashed.result()

    def finish(self) -> RecordingDigest:
        """Hash what is left, and return the digest.

        Raises:
            BagAssetsError: as `recording_digest`.
        """
        self._thread.shutdown()
        begun = {path: (stat, self._hashers.get(path)) for path, stat in self._before.items()}
        return recording_digest(self._recording, self._index, begun=begun)

    def _hash(self, path: Path, position: int, data: bytes) -> None:
        if path not in self._asked:
            return
        try:
            if path not in self._hashers:
                self._hashers[path] = FileHasher(path)
            self._hashers[path].follow(position, data)
        except Exception:  # noqa: BLE001  (whatever it is: `finish` hashes the file anew)
            del self._asked[path]
            if path in self._hashers:
                self._hashers.pop(path).close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._thread.shutdown(cancel_futures=True)
        for hasher in self._hashers.values():
            hasher.close()


def stat_files(recording: RecordingFiles) -> list[tuple[Path, os.stat_result]]:
    """Return the files of a recording with their current status; a log or journal that has appeared since belongs to them.

    Raises:
        ChangedWhileReadError: a file is gone or cannot be read.
    """
    try:
        found = {path: path.stat() for path in recording.files}
        return list((found | journals_of(found)).items())
    except OSError as err:
        raise _gone(err.filename, err) from err


def name_in(recording: RecordingFiles, path: Path) -> str:
    """Return what a file of a recording is called among its digests."""
    return os.path.relpath(path, recording.path.parent) if recording.parts else path.name


def combined_digest(recording: RecordingFiles, digests: dict[str, str]) -> str:
    """Return the digest of a recording, given those of its files (name -> digest).

    For a series it is taken over the digests of its parts in order, whatever they are called; for a folder, over its sorted
    (name, digest) pairs; for a single file it is the file's.
    """
    if recording.parts:
        return digest_json(["series", *digests.values()])
    if len(digests) == 1:
        return next(iter(digests.values()))
    return digest_json(sorted(digests.items()))


def hash_file(
    path: Path,
    before: os.stat_result,
    between: Callable[[int], None] | None = None,
    hasher: FileHasher | None = None,
) -> str:
    """Return the digest of the content of a file.

    Args:
        path: the file.
        before: status of the file, which must stay the same meanwhile.
        between: called with the number of bytes just read, every few milliseconds; what it raises ends the hashing.
        hasher: has begun to hash the file.

    Raises:
        RecordingError: the file cannot be read.
        ChangedWhileReadError: the file changed meanwhile.
    """
    _wait_a_tick(before)
    try:
        digest = digest_file(path, between) if hasher is None else hasher.finish(between)
        after = path.stat()
    except OSError as err:
        if isinstance(err, FileNotFoundError):
            raise _gone(path, err) from err
        raise RecordingError(
            f"{path}: cannot be read ({err.strerror}); correct its permissions, or check the disk."
        ) from err
    same_times = (before.st_size, before.st_mtime_ns) == (after.st_size, after.st_mtime_ns)
    if not (is_unchanged(path, before, after, digest) or (same_times and _has_digest(path, after, digest))):
        raise ChangedWhileReadError(
            f"{path}: the file changed while it was hashed; build again when it is complete."
        )
    return digest


def _has_digest(path: Path, stat: os.stat_result, digest: str | None) -> bool:
    """Tell whether a file with this status still has the content with a digest."""
    return digest is not None and _digest_at(path, stat.st_ctime_ns) == digest


@lru_cache(1000)
def _digest_at(path: Path, ctime_ns: int) -> str | None:
    """Return the digest of a file whose ctime changed, once for each ctime; None if it changes again or cannot be read.

    Two builds that record its digest at nearly one moment change it in ways that neither can tell from an edit.
    """
    with suppress(OSError):
        digest = digest_file(path, None)
        if path.stat().st_ctime_ns == ctime_ns:
            return digest
    return None


def _wait_a_tick(stat: os.stat_result) -> None:
    """Wait if a file was written just now: it may be written again within the same tick, which its mtime would not show."""
    age_s = time.time() - stat.st_mtime_ns / 1e9
    if 0 <= age_s < _TICK_S:
        time.sleep(_TICK_S - age_s)


def _gone(path: Path | str, err: OSError) -> ChangedWhileReadError:
    return ChangedWhileReadError(f"{path}: cannot be read ({err.strerror}); was it removed?")
