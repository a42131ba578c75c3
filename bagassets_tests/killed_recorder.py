"""Databases as killed recorders leave them: the last messages in a write-ahead log, or a change that was not finished."""

import shutil
import sqlite3
from contextlib import closing, contextmanager
from pathlib import Path

from bagassets_tests.small_drive import write_drive

COLUMNS = "topic_id, timestamp, data"


def write_clean(path, **options):
    """Write the small drive as one database, closed as it should be."""
    folder = write_drive(path.parent / f"{path.name}.made", "ros2", **options)
    (database,) = folder.glob("*.db3")
    database.rename(path)
    shutil.rmtree(folder)
    return path


def _copied(working, database):
    """Copy what lies on the disk while the recorder has the database open: what is left when it is killed now."""
    for file in working.parent.iterdir():
        if not file.name.endswith("-shm"):
            shutil.copyfile(file, database.with_name(file.name.replace(working.name, database.name)))


def leave_log(database, logged, *, uncommitted=0):
    """Replace a database by one of the same content whose last `logged` messages are in its write-ahead log.

    Args:
        database: the file.
        logged: how many messages are in the log.
        uncommitted: how many of them, the last ones, belong to a transaction that was not committed.
    """
    with closing(sqlite3.connect(database)) as connection:
        rows = connection.execute(
            f"SELECT {COLUMNS} FROM messages ORDER BY id DESC LIMIT {logged}"
        ).fetchall()[::-1]
        connection.execute(
            f"DELETE FROM messages WHERE id IN (SELECT id FROM messages ORDER BY id DESC LIMIT {logged})"
        )
        connection.commit()
        connection.execute("VACUUM")
    insert = f"INSERT INTO messages ({COLUMNS}) VALUES (?, ?, ?)"
    with _at_work(database) as (working, connection):
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA wal_autocheckpoint = 0")
        connection.executemany(insert, rows[: logged - uncommitted])
        connection.commit()
        connection.execute("PRAGMA cache_size = 2")  # what is not committed reaches the disk as well
        connection.executemany(insert, rows[logged - uncommitted :])
        _copied(working, database)
        connection.rollback()
    return database


def leave_journal(database):
    """Leave a change unfinished that would have emptied the database, with the journal that undoes it."""
    with _at_work(database) as (working, connection):
        connection.execute("PRAGMA journal_mode = DELETE")
        connection.execute("PRAGMA cache_size = 2")
        connection.execute("UPDATE messages SET timestamp = 0, data = zeroblob(length(data))")
        _copied(working, database)
        connection.rollback()
    return database


@contextmanager
def _at_work(database):
    """Open a copy of a database, as the recorder has it that will be killed."""
    folder = database.parent / f"{database.name}.recorder"
    folder.mkdir()
    working = Path(shutil.copy(database, folder / "working"))
    with closing(sqlite3.connect(working)) as connection:
        yield working, connection
    shutil.rmtree(folder)
