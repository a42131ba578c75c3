"""What SQLite leaves beside a database whose recorder was killed: a write-ahead log, or the journal of an unfinished change.

Without them a database lacks its last messages, or is torn. SQLite applies them by writing to the database and beside it,
so it gets a private copy: where recordings are, nothing is ever written.
"""

import shutil
import sqlite3
import stat
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from os import SEEK_END, stat_result
from pathlib import Path
from tempfile import TemporaryDirectory

from bagassets.base.disk_errors import FULL
from bagassets.base.errors import RecordingError, ScratchError
from bagassets.base.quantities import readable_bytes
from bagassets.recordings.damage import DamageError

_LOG, _JOURNAL = "-wal", "-journal"
# The header of a log; frames follow. A journal begins with a header of 28 bytes.
_HEADER_BYTES = 32
# At the end of a journal: it belongs to a transaction over several databases, which it names.
_OF_SEVERAL = bytes.fromhex("d9d505f920a163d7")


def journals_of(files: Iterable[Path]) -> dict[Path, stat_result]:
    """Return the logs and journals beside those of `files` that are databases, if there is anything in them."""
    found = {}
    for path in files:
        for suffix in (_LOG, _JOURNAL) if path.suffix == ".db3" else ():
            journal = path.with_name(path.name + suffix)
            try:
                status = journal.stat()
            except FileNotFoundError:
                continue
            if stat.S_ISREG(status.st_mode) and status.st_size > _HEADER_BYTES:
                found[journal] = status
    return found


@contextmanager
def without_journals(path: Path) -> Iterator[Path]:
    """Yield a path at which a database can be opened with its log and journal applied.

    Without these that is the path itself; else that of a private copy, whose name is removed at the end: whoever has opened
    it can go on reading, and nothing is left if the process is killed.

    Raises:
        RecordingError: the path is a link, and what belongs beside it was left behind.
        ScratchError: there is no space for a copy.
        DamageError: the journal cannot be applied safely.
    """
    journals = journals_of([path])
    if not journals:
        left_behind = journals_of([path.resolve()]) if path.is_symlink() else {}
        for journal in left_behind:
            raise RecordingError(
                f"{path}: it is a link to a database whose last messages are in {journal}; link that file beside it, too."
            )
        yield path
        return
    # Applying them may add as much to the copy as they hold.
    size = path.stat().st_size + 2 * sum(status.st_size for status in journals.values())
    with scratch_folder(path, size) as folder:
        copy = folder / "copy.db3"
        for source in (path, *journals):
            target = folder / f"copy.db3{source.name[len(path.name) :]}"
            shutil.copyfile(source, target)
            if target.name.endswith(_JOURNAL):
                with target.open("rb") as file:
                    file.seek(-len(_OF_SEVERAL), SEEK_END)
                    if file.read() == _OF_SEVERAL:  # no recorder writes one, and it would lead to other files
                        raise DamageError(f"{source.name} belongs to several databases")
        with closing(sqlite3.connect(copy)) as connection:
            connection.execute("PRAGMA trusted_schema = OFF")
            connection.execute("SELECT * FROM sqlite_master LIMIT 1").fetchall()
            connection.execute("PRAGMA journal_mode = DELETE")
        yield copy


@contextmanager
def scratch_folder(path: Path, size: int) -> Iterator[Path]:
    """Make a temporary folder for what a recording has to be turned into before it can be read, and remove it at the end.

    Args:
        path: of the recording.
        size: bytes that are at least needed.

    Raises:
        ScratchError: there is not enough space.
    """
    with TemporaryDirectory(prefix="bagassets-") as name:
        error = ScratchError(
            f"{path}: reading it takes {readable_bytes(size)} or more of disk space in {Path(name).parent}, where there is "
            "less; free some, or set TMPDIR to a folder that has it."
        )
        if shutil.disk_usage(name).free < size:
            raise error
        try:
            yield Path(name)
        except OSError as err:
            if err.errno in FULL:
                raise error from err
            raise
        except sqlite3.OperationalError as err:
            if err.sqlite_errorcode == sqlite3.SQLITE_FULL:
                raise error from err
            raise
