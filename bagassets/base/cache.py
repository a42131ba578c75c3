"""The cache file: everything that decides about freshness, in one SQLite file in the state folder.

Any of it may be lost: an entry that is missing, damaged or written by another version raises `PlanNeeded`, which only
costs time. Nothing is synced to disk, so each entry carries a digest: one torn by a power loss counts as missing.
"""

import json
import os
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, nullcontext, suppress
from hashlib import blake2b
from typing import TYPE_CHECKING

from bagassets.base.fingerprints import PlanNeeded, open_read_only

if TYPE_CHECKING:
    from bagassets.base.json_types import Json

NAME = "freshness.sqlite"
_FORMAT = 3
_BUSY_S = 10.0
_BATCH_BYTES = 1 << 20  # what `Kept` has is written whenever there is so much
_NO_DAMAGE = tuple(
    f"SQLITE_{name}" for name in ("BUSY", "LOCKED", "READONLY", "IOERR", "FULL", "CANTOPEN", "PERM")
)
_VERSION = "PRAGMA user_version"
_ALL = "SELECT key, content, digest FROM entries WHERE kind = ?"
_KEYS = "SELECT key, NULL, NULL FROM entries WHERE kind = ?"
_ONE = f"{_ALL} AND key = ?"

_Row = tuple[object, object, object]


class Changes:
    """Changes to the cache file, made all at once or not at all."""

    def __init__(self) -> None:
        self._put: list[tuple[str, str, bytes, bytes]] = []
        self._drop: list[tuple[str, str, str]] = []
        self.size = 0

    def __bool__(self) -> bool:
        return bool(self._put or self._drop)

    def put(self, kind: str, key: str, content: bytes) -> None:
        """Write an entry."""
        self._put.append((kind, key, content, _check(kind, key, content)))
        self.size += len(content)

    def drop(self, kind: str, key: str) -> None:
        """Remove an entry."""
        self._drop.append((kind, key, key))

    def drop_below(self, kind: str, key: str) -> None:
        """Remove the entries whose keys begin with this one and a slash."""
        self._drop.append((kind, f"{key}/", f"{key}/\U0010ffff"))

    def apply(self, connection: sqlite3.Connection) -> None:
        """Apply the changes to an open database."""
        connection.executemany("DELETE FROM entries WHERE kind = ? AND key BETWEEN ? AND ?", self._drop)
        connection.executemany("INSERT OR REPLACE INTO entries VALUES (?, ?, ?, ?)", self._put)


class Cache:
    """The cache file of a state folder: entries by kind and key.

    Attributes:
        path: the file.
    """

    def __init__(self, state: str | os.PathLike[str]) -> None:
        self.path = os.path.join(state, NAME)
        self._open: sqlite3.Connection | None = None

    @contextmanager
    def kept_open(self) -> Iterator[None]:
        """Keep the file open during many calls of `get`: opening it takes longer than finding an entry."""
        with ExitStack() as stack:
            with suppress(PlanNeeded):  # `get` meets it again
                self._open = stack.enter_context(self._reading())
            try:
                yield
            finally:
                self._open = None

    def get(self, kind: str, *keys: str) -> list[bytes]:
        """Return entries.

        Raises:
            PlanNeeded: one is missing or damaged.
        """
        queries = [(_ONE, (kind, key)) for key in keys]
        contents = [content for rows in self._rows(queries) for _, content in _intact(kind, rows)]
        if len(contents) != len(keys):
            raise PlanNeeded(f"{self.path}: there is no {kind} {', '.join(keys)}, or it is damaged")
        return contents

    def all(self, kind: str, keys: Iterable[str] | None = None) -> dict[str, bytes]:
        """Return key -> content of the entries of a kind, or of those with some keys; damaged ones are left out.

        Raises:
            PlanNeeded: the file cannot be read.
        """
        queries = [(_ALL, (kind,))] if keys is None else [(_ONE, (kind, key)) for key in keys]
        return {key: content for rows in self._rows(queries) for key, content in _intact(kind, rows)}

    def keys(self, kind: str) -> set[str]:
        """Return the keys of the entries of a kind, damaged ones too; none if the file cannot be read."""
        with suppress(PlanNeeded):
            return {str(row[0]) for rows in self._rows([(_KEYS, (kind,))]) for row in rows}
        return set()

    def write(self, changes: Changes) -> bool:
        """Change entries; a damaged file is replaced.

        Returns:
            False if that is not possible: the disk is full, or the file belongs to somebody else.
        """
        if not changes:
            return True
        for _ in range(2):
            try:
                with self._writing() as connection:
                    connection.execute("BEGIN IMMEDIATE")
                    changes.apply(connection)
                    connection.execute("COMMIT")
            except (OSError, sqlite3.DatabaseError, ValueError) as err:
                if isinstance(err, OSError) or not is_damage(err):
                    return False
                self.remove()
            else:
                return True
        return False

    def remove_if_damaged(self) -> None:
        """Remove the file if a power loss tore it; the digests of entries do not reveal entries that were lost."""
        try:
            with closing(open_read_only(self.path)) as connection:
                is_whole = connection.execute("PRAGMA integrity_check(1)").fetchone() == ("ok",)
        except (sqlite3.DatabaseError, ValueError) as err:
            is_whole = not is_damage(err)
        if not is_whole:
            self.remove()

    def remove(self) -> None:
        """Remove the file."""
        for suffix in ("", "-journal"):
            with suppress(OSError):
                os.unlink(self.path + suffix)

    def _rows(self, queries: Sequence[tuple[str, tuple[str, ...]]]) -> list[list[_Row]]:
        """Return the rows of each query.

        Raises:
            PlanNeeded: the file cannot be read, or was written by another version.
        """
        reading = nullcontext(self._open) if self._open is not None else self._reading()
        try:
            with reading as connection:
                return [connection.execute(query, values).fetchall() for query, values in queries]
        except (sqlite3.Error, ValueError) as err:
            raise PlanNeeded(f"{self.path}: {err}") from err

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        """Yield a connection to the file.

        Raises:
            PlanNeeded: the file cannot be read, or was written by another version.
        """
        try:
            with closing(open_read_only(self.path)) as connection:
                if connection.execute(_VERSION).fetchone() != (_FORMAT,):
                    raise PlanNeeded(f"{self.path}: written by another version")
                yield connection
        except (sqlite3.Error, ValueError) as err:
            raise PlanNeeded(f"{self.path}: {err}") from err

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """Yield a connection for writing to the file, which is created with its table if it is missing.

        Only its owner may read it, since URLs of databases may hold passwords.

        Raises:
            OSError: it cannot be opened or created.
            sqlite3.Error: the same, or it is damaged, or of another format.
        """
        os.makedirs(os.path.dirname(self.path), exist_ok=True)
        os.close(os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))
        with closing(sqlite3.connect(self.path, timeout=_BUSY_S, isolation_level=None)) as connection:
            connection.execute("PRAGMA synchronous = OFF")
            (version,) = connection.execute(_VERSION).fetchone()
            if version == 0:
                connection.execute(
                    "CREATE TABLE IF NOT EXISTS entries "
                    "(kind TEXT, key TEXT, content BLOB, digest BLOB, PRIMARY KEY (kind, key))"
                )
                connection.execute(f"PRAGMA user_version = {_FORMAT}")
            elif version != _FORMAT:
                raise sqlite3.DatabaseError("written by another version")
            yield connection


class Kept:
    """Values by key in the cache file, each with a mark; it holds for whoever has the same one.

    Args:
        state: the state folder.
        kind: of the entries.

    Attributes:
        cache: has them.
    """

    def __init__(self, state: str | os.PathLike[str], kind: str) -> None:
        self.cache, self._kind, self._changes = Cache(state), kind, Changes()

    def find(self, key: str, mark: bytes) -> "Json":
        """Return the value of a key if it was kept with this mark; else None."""
        with suppress(PlanNeeded):
            (content,) = self.cache.get(self._kind, key)
            if content.startswith(mark):
                found: Json = json.loads(zlib.decompress(content[len(mark) :]))
                return found
        return None

    def keep(self, key: str, mark: bytes, value: object) -> None:
        """Keep a value that JSON can express, with its mark; `write` at the end."""
        self._changes.put(self._kind, key, mark + zlib.compress(json.dumps(value).encode(), 1))
        if self._changes.size > _BATCH_BYTES:
            self.write()

    def write(self) -> None:
        """Write what is not yet in the file."""
        self.cache.write(self._changes)
        self._changes = Changes()


def is_damage(err: Exception) -> bool:
    """Tell whether an error of SQLite is about what a file holds; otherwise it is missing, in use or full, or others' own.

    A text in a torn schema need not be UTF-8, of which Python makes a ValueError.
    """
    return not getattr(err, "sqlite_errorname", "").startswith(_NO_DAMAGE)


def _check(kind: str, key: str, content: bytes) -> bytes:
    hasher = blake2b(f"{kind}\0{key}\0".encode("utf-8", "surrogateescape"), digest_size=16)
    hasher.update(content)
    return hasher.digest()


def _intact(kind: str, rows: Iterable[_Row]) -> Iterator[tuple[str, bytes]]:
    """Yield key and content of the entries that match their digests."""
    for key, content, check in rows:
        if isinstance(key, str) and isinstance(content, bytes) and _check(kind, key, content) == check:
            yield key, content
