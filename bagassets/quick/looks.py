"""Looking at files, database and store: digests that change whenever something there does.

Modules of this package import the standard library only, and little of it: the whole decision has to
be made in the time that Dagster needs to begin importing.
"""

import os
import sqlite3
from hashlib import blake2b
from typing import Any

__all__ = ["Doubt", "boot", "database_look", "files_look", "signature", "tree_look"]

# The schema that these were written for: `alembic_version` of Dagster 1.13. PostgreSQL keeps the events of runs in the
# table of those about assets, which alone count.
_QUERIES = (
    "SELECT version_num FROM alembic_version",
    "SELECT max(id), count(*) FROM event_logs {chosen}",
    "SELECT id, run_id, timestamp FROM event_logs {chosen} ORDER BY id DESC LIMIT 1",
    "SELECT asset_key, last_run_id, last_materialization_timestamp, wipe_timestamp FROM asset_keys ORDER BY asset_key",
)
_PARTITIONS = "SELECT partition FROM dynamic_partitions WHERE partitions_def_name = {mark} ORDER BY partition"


class Doubt(Exception):  # noqa: N818  (a reason to look closer, not an error)
    """Something differs, or cannot be seen; its text says what."""


def signature(path: str) -> list[int]:
    """Return what tells whether a file or the entries of a folder changed; empty if it is not there.

    Inode and time of change (ctime) cannot be put back by whoever edits a file in place.
    """
    try:
        stat = os.stat(path)  # noqa: PTH116  (no pathlib here: its import costs 5 ms)
    except OSError:
        return []
    return [stat.st_size, stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns]


def boot() -> str:
    """Return the name of this boot of the machine; empty where it has none."""
    try:
        with open("/proc/sys/kernel/random/boot_id", encoding="ascii") as stream:  # noqa: PTH123
            return stream.read().strip()
    except (OSError, ValueError):
        return ""


def files_look(paths: list[str]) -> str:
    """Return a digest over the signatures of files, whether they are there or not."""
    return _digest([f"{path}\0{signature(path)}" for path in paths])


def tree_look(root: str) -> str:
    """Return a digest over everything below a folder that is not hidden.

    Links are followed as finding recordings does, and noted themselves.

    Raises:
        Doubt: a folder cannot be read.
    """
    lines: list[str] = []
    _walk(root, (), lines)
    lines.sort()
    return _digest(lines)


def _walk(folder: str, ancestors: tuple[tuple[int, int], ...], lines: list[str]) -> None:
    try:
        status = os.stat(folder)  # noqa: PTH116
        identity = (status.st_dev, status.st_ino)
        if identity in ancestors:
            return
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.startswith("."):
                    continue
                if entry.is_symlink():
                    lines.append(f"{entry.path}\0link\0{os.readlink(entry.path)}")  # noqa: PTH115
                try:
                    stat = entry.stat()
                except FileNotFoundError:  # a link that leads nowhere, or removed just now
                    lines.append(f"{entry.path}\0gone")
                    continue
                if entry.is_dir():
                    lines.append(f"{entry.path}\0folder")
                    _walk(entry.path, (*ancestors, identity), lines)
                else:
                    lines.append(
                        f"{entry.path}\0{stat.st_size}\0{stat.st_mtime_ns}\0{stat.st_ino}\0{stat.st_ctime_ns}"
                    )
    except OSError as err:
        raise Doubt(f"{folder}: {err}") from err


def database_look(place: str, partitions: str) -> str:
    """Return a digest that changes with every event about an asset, wipe, deleted run or partition.

    Ids alone would not do: SQLite gives those of deleted events away again.

    Args:
        place: the database of Dagster's event log: a file of SQLite, or the URL of a PostgreSQL database.
        partitions: name of the dynamic partitions.

    Raises:
        Doubt: it cannot be read, or has another schema.
    """
    read = _postgres_rows if "://" in place else _sqlite_rows
    return _digest([repr(rows) for rows in read(place, partitions)])


def _sqlite_rows(path: str, partitions: str) -> list[Any]:
    quoted = path.replace("%", "%25").replace("?", "%3f").replace("#", "%23")
    try:
        connection = sqlite3.connect(f"file:{quoted}?mode=ro", timeout=1.0, uri=True)
        try:
            return _rows(connection.cursor(), partitions, mark="?")
        finally:
            connection.close()
    except sqlite3.Error as err:
        raise Doubt(f"{path}: {err}") from err


def _postgres_rows(url: str, partitions: str) -> list[Any]:
    try:
        import psycopg2  # noqa: PLC0415  (only there, and with dagster-postgres)
    except ImportError as err:
        raise Doubt("psycopg2 is not installed") from err
    scheme, _, rest = url.partition("://")
    try:
        connection = psycopg2.connect(f"{scheme.partition('+')[0]}://{rest}", connect_timeout=2)
        try:
            return _rows(connection.cursor(), partitions, mark="%s", chosen="WHERE asset_key IS NOT NULL")
        finally:
            connection.close()
    except psycopg2.Error as err:
        raise Doubt(f"PostgreSQL: {err}") from err


def _rows(cursor: Any, partitions: str, *, mark: str, chosen: str = "") -> list[Any]:
    """Return what each query gives; `mark` stands for a value, `chosen` picks the events that count."""
    rows: list[Any] = []
    for query in _QUERIES:
        cursor.execute(query.format(chosen=chosen))
        rows.append(cursor.fetchall())
    cursor.execute(_PARTITIONS.format(mark=mark), (partitions,))
    rows.append(cursor.fetchall())
    return rows


def _digest(lines: list[str]) -> str:
    # Names that are no UTF-8 come as lone surrogates.
    return blake2b("\n".join(lines).encode("utf-8", "surrogateescape"), digest_size=32).hexdigest()
