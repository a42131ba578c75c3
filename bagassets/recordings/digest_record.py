"""Digests of files on record: in an extended attribute of the file, and in an index of the project.

The attribute names the size and mtime that it is valid for. Everybody who may read the file may read it, so a watcher on
a file server serves all clients. The index belongs to one project and also holds ctime, so that it notices a file that was
edited in place, or replaced, and had its mtime restored. Inodes are no evidence: exFAT and most file systems in user space
(s3fs) make numbers up, and give a file another one whenever the kernel has forgotten it.

Writing an attribute changes ctime, too. So the attribute also names the ctime before and the moment when it was written: an
index that knows the former, and finds a ctime of the latter, knows that nothing else happened to the file.
"""

import json
import os
import re
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, Self

from bagassets.base.cache import is_damage
from bagassets.base.disk_errors import disk_advice
from bagassets.base.errors import StoreError

if TYPE_CHECKING:
    from bagassets.recipe.model import Recipe


ATTRIBUTE = "user.bagassets.digest"
_DIGEST = re.compile("[0-9a-f]{64}")
# The kernel's clock of file times is behind by up to a tick; writing an attribute takes that long at most.
_TICK_NS, _WRITING_NS = 20_000_000, 50_000_000

Kept = Literal["attribute", "index", "nowhere"]


class _IndexRow(NamedTuple):
    """The index's entry for a file."""

    size: int
    mtime_ns: int
    ctime_ns: int
    digest: str

    @classmethod
    def of(cls, stat: os.stat_result, digest: str) -> Self:
        """Return the entry of a file whose status is `stat`."""
        return cls(stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, digest)

    def same_size_and_time(self, stat: os.stat_result) -> bool:
        """Tell whether size and mtime are those of `stat`."""
        return (self.size, self.mtime_ns) == (stat.st_size, stat.st_mtime_ns)

    def same_file(self, stat: os.stat_result) -> bool:
        """Tell whether size, mtime and ctime are those of `stat`."""
        return self == _IndexRow.of(stat, self.digest)


class DigestIndex:
    """Digests by path in one SQLite file, created by the first write and read again only after others wrote.

    It is a cache: a damaged one is replaced.

    Attributes:
        writes_attributes: digests that enter it are stored with the files, too.
    """

    def __init__(self, folder: Path, *, writes_attributes: bool = True) -> None:
        self.writes_attributes = writes_attributes
        self._path = folder / "digests.sqlite"
        self._rows: dict[str, _IndexRow] = {}
        self._read_at: tuple[int, int, int] | None = None

    @classmethod
    def of(cls, recipe: "Recipe") -> Self:
        """Return the index of a recipe, which says whether builds may write to recordings."""
        return cls(recipe.state, writes_attributes=recipe.bags.digest_attributes)

    def row(self, path: Path) -> _IndexRow | None:
        """Return the entry for a file, valid or not."""
        try:
            state = self._state()
            if state is None:
                return None
            if state != self._read_at:
                with self._open() as connection:
                    rows = connection.execute("SELECT path, size, mtime_ns, ctime_ns, digest FROM digests")
                    self._rows = {row[0]: _IndexRow(*row[1:]) for row in rows}
                self._read_at = state
        except (sqlite3.Error, ValueError):  # see `is_damage`
            return None  # no table yet, or the file is damaged
        return self._rows.get(str(path))

    def digests(self) -> set[str]:
        """Return the digests of all files that have an entry, valid or not."""
        self.row(Path())  # reads what others wrote
        return {row.digest for row in self._rows.values()}

    def get(self, path: Path, stat: os.stat_result) -> str | None:
        """Return the digest of a file if its entry is valid."""
        row = self.row(path)
        return row.digest if row is not None and row.same_file(stat) else None

    def suspects_edit(self, path: Path, stat: os.stat_result) -> bool:
        """Tell whether a file has its recorded size and mtime, but may have been edited in place."""
        row = self.row(path)
        return row is not None and row.same_size_and_time(stat) and not _is_untouched(path, stat, row)

    def put(self, path: Path, stat: os.stat_result, digest: str) -> None:
        """Record the digest of a file whose status is `stat`.

        Raises:
            StoreError: the index cannot be written.
        """
        row = _IndexRow.of(stat, digest)
        try:
            try:
                self._insert(path, row)
            except (sqlite3.DatabaseError, ValueError) as err:
                if not is_damage(err):
                    raise
                self._path.unlink(missing_ok=True)
                self._insert(path, row)
        except (OSError, sqlite3.Error) as err:
            raise StoreError(
                f"{self._path}: the index of digests cannot be written ({err}); {disk_advice(err)}."
            ) from err

    def _insert(self, path: Path, row: _IndexRow) -> None:
        current = self._read_at is not None and self._read_at == self._state()
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._open() as connection:
            connection.execute(  # 0.1.0 writes an inode, too
                "CREATE TABLE IF NOT EXISTS digests (path TEXT PRIMARY KEY, size INTEGER, mtime_ns INTEGER, "
                "inode INTEGER, ctime_ns INTEGER, digest TEXT)"
            )
            connection.execute(
                "INSERT OR REPLACE INTO digests (path, size, mtime_ns, ctime_ns, digest) VALUES (?, ?, ?, ?, ?)",
                (str(path), row.size, row.mtime_ns, row.ctime_ns, row.digest),
            )
        # The rows read before stay valid, unless another process wrote meanwhile.
        self._rows[str(path)] = row
        self._read_at = self._state() if current else None

    def _state(self) -> tuple[int, int, int] | None:
        try:
            stat = self._path.stat()
        except OSError:
            return None  # not created yet, or unreachable: then writing raises
        return stat.st_ino, stat.st_size, stat.st_mtime_ns

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        with closing(sqlite3.connect(self._path, timeout=30)) as connection, connection:
            # Waiting for the disk takes longer than hashing most files; an index torn by a power loss is replaced.
            connection.execute("PRAGMA synchronous = OFF")
            yield connection


def digest_on_record(path: Path, stat: os.stat_result, index: DigestIndex | None) -> str | None:
    """Return the digest on record for a file whose status is `stat`, or None if it has to be hashed.

    A file whose entry in the index has this size and mtime, but another ctime, may have been edited in place: then the
    attribute is not trusted either.
    """
    row = None if index is None else index.row(path)
    if row is not None and row.same_size_and_time(stat):
        return row.digest if _is_untouched(path, stat, row) else None
    return read_attribute(path, stat)


def is_unchanged(path: Path, then: os.stat_result, now: os.stat_result, digest: str | None = None) -> bool:
    """Tell whether nothing happened to a file between two looks at it, but for an attribute that was written.

    Args:
        path: the file.
        then: its status at first.
        now: its status later.
        digest: of its content; None if that is not known.
    """
    if digest is None:
        digest = read_attribute(path) or ""
    row = _IndexRow.of(then, digest)
    return row.same_size_and_time(now) and _is_untouched(path, now, row)


def put_on_record(
    path: Path, stat: os.stat_result, digest: str, index: DigestIndex | None
) -> tuple[Kept, os.stat_result]:
    """Store the digest of a file as an attribute if possible and wanted, and in the index if there is one.

    Args:
        path: the file.
        stat: status of the file when it was hashed.
        digest: its digest.
        index: the project's index, if there is one.

    Returns:
        Where the digest is on record, and the status of the file for which it is valid.

    Raises:
        StoreError: the index cannot be written.
    """
    is_kept = read_attribute(path, stat) == digest
    if is_kept:
        now = path.stat()
        if not is_unchanged(path, stat, now, digest):
            return "attribute", stat  # for its size and time; the index must not vouch for more
        stat = now
    elif (index is None or index.writes_attributes) and _write_attribute(path, stat, digest):
        now, is_kept = path.stat(), True
        # Writing an attribute changes ctime; any other change was made by somebody else.
        if (now.st_size, now.st_mtime_ns) != (stat.st_size, stat.st_mtime_ns):
            return "attribute", stat
        stat = now
    if index is None:
        return ("attribute" if is_kept else "nowhere"), stat
    if index.get(path, stat) != digest:
        index.put(path, stat, digest)
    return ("attribute" if is_kept else "index"), stat


@dataclass(frozen=True)
class Disagreement:
    """A digest on record that does not match the content of its file.

    Attributes:
        path: the file.
        where: `attribute` or `index`.
        recorded: the digest on record.
        actual: the digest of the content.
    """

    path: Path
    where: Literal["attribute", "index"]
    recorded: str
    actual: str

    def __str__(self) -> str:
        return (
            f"{self.path}: the digest on record ({self.where}, for this size and time) is {self.recorded[:16]}, that of "
            f"the content {self.actual[:16]}; the file was edited in place or its disk is failing. Compare it with its "
            "source, then accept it with `bagassets digest --rehash`."
        )


def disagreements(
    path: Path, stat: os.stat_result, actual: str, index: DigestIndex | None
) -> Iterator[Disagreement]:
    """Yield each digest on record for a file with this status that is not the actual one.

    Records for another size or mtime are no disagreement: nobody trusts them.
    """
    attribute = read_attribute(path, stat)
    if attribute is not None and attribute != actual:
        yield Disagreement(path, "attribute", attribute, actual)
    indexed = None if index is None else index.get(path, stat)
    if indexed is not None and indexed != actual:
        yield Disagreement(path, "index", indexed, actual)


def read_attribute(path: Path, stat: os.stat_result | None = None) -> str | None:
    """Return the digest in the attribute of a file if it is valid for `stat`; without `stat`, in any case."""
    attribute = _attribute(path)
    if attribute is None or (stat is not None and attribute.valid_for != (stat.st_size, stat.st_mtime_ns)):
        return None
    return attribute.digest


@dataclass(frozen=True, slots=True)
class _Attribute:
    """The attribute of a file.

    Attributes:
        digest: of its content.
        valid_for: size and mtime (ns) that the file must have.
        ctime_ns: its ctime before the attribute was written; None if that is not known.
        written_ns: when the attribute was written, by the clock of the writer; None if that is not known.
    """

    digest: str
    valid_for: tuple[int, int]
    ctime_ns: int | None
    written_ns: int | None


def _attribute(path: Path) -> _Attribute | None:
    try:
        record = json.loads(os.getxattr(path, ATTRIBUTE))
        digest, valid_for = record["digest"], (record["size"], record["mtime_ns"])
        if _DIGEST.fullmatch(digest) is None:
            return None
        return _Attribute(digest, valid_for, record.get("ctime_ns"), record.get("written_ns"))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None  # missing, not supported here, or malformed: hash instead


def _is_untouched(path: Path, stat: os.stat_result, row: _IndexRow) -> bool:
    """Tell whether a file is as the index knows it, but for an attribute that was written since."""
    if row.same_file(stat):
        return True
    attribute = _attribute(path)
    if attribute is None or (attribute.digest, attribute.ctime_ns) != (row.digest, row.ctime_ns):
        return False
    written_ns = attribute.written_ns
    return isinstance(written_ns, int) and -_TICK_NS <= stat.st_ctime_ns - written_ns <= _WRITING_NS


def _write_attribute(path: Path, stat: os.stat_result, digest: str) -> bool:
    record = {"digest": digest, "size": stat.st_size, "mtime_ns": stat.st_mtime_ns}
    try:
        if not _IndexRow.of(stat, digest).same_file(path.stat()):
            return False  # it has changed since it was hashed
        record |= {"ctime_ns": stat.st_ctime_ns, "written_ns": time.time_ns()}
        os.setxattr(path, ATTRIBUTE, json.dumps(record, sort_keys=True).encode())
    except (OSError, AttributeError):
        return False
    return True
