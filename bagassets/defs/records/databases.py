"""What a Dagster home folder names: SQLite databases, created whole or not at all, by one process, and errors explained.

Dagster creates a database in place, table by table, and takes one without tables for finished: a process
that is killed meanwhile leaves a project that no build can use. Here databases are created in a temporary folder and
moved into place; one that was left unfinished and holds nothing is replaced.
"""

import os
import shlex
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from uuid import uuid4

import yaml
from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import Engine, MetaData, event
from sqlalchemy.exc import DatabaseError, OperationalError

from bagassets.base.disk_errors import disk_advice
from bagassets.base.errors import BagAssetsError, StoreError
from bagassets.base.fingerprints import open_read_only
from bagassets.base.lock_files import LockFile
from bagassets.defs.dagster_private import (
    ConfigurableClassData,
    DagsterSqliteStorage,
    InstanceRef,
    RunStorageSqlMetadata,
    ScheduleStorageSqlMetadata,
    SqlEventLogStorageMetadata,
)

_LOCK = "opening.lock"
_NEW = "new-"
# What Dagster keeps in SQLite, below the folder of the storage.
RUNS, EVENTS, SCHEDULES = "history/runs.db", "history/runs/index.db", "schedules/schedules.db"
_DATABASES: dict[str, MetaData] = {
    RUNS: RunStorageSqlMetadata,
    EVENTS: SqlEventLogStorageMetadata,
    SCHEDULES: ScheduleStorageSqlMetadata,
}
# Tables that Dagster fills when it creates a database, or may fill again at any time.
_VERSION, _INDEXES = "alembic_version", "secondary_indexes"
_REPLACEABLE = frozenset({_VERSION, _INDEXES, "instance_info", "daemon_heartbeats"})
_BUSY_S = 5.0
_FROM_CONFIG = "from_config"  # how Alembic reads the folder of the migrations
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_OUR_STORAGE = "bagassets.defs.sqlite_storage"
# Events are of one to three kB each: with pages of 4 kB, a quarter of the file stays empty.
_PAGE_BYTES = 8192


def are_files(home: Path) -> bool:
    """Return whether the databases of the instance in `home` are SQLite's, and have been created."""
    folder = storage_folder(home)
    return folder is not None and not _unfinished(folder)


def storage_folder(home: Path) -> Path | None:
    """Return the folder in which the instance of a Dagster home keeps SQLite databases; None if it has others."""
    try:
        storage = yaml.load((home / "dagster.yaml").read_text("utf-8"), Loader=_LOADER)["storage"]  # noqa: S506  (a safe loader)
        if "sqlite" in storage:
            return Path(storage["sqlite"]["base_dir"])
        is_ours = storage["custom"]["module"] == _OUR_STORAGE
        return Path(storage["custom"]["config"]["base_dir"]) if is_ours else None
    except (OSError, yaml.YAMLError, KeyError, TypeError):
        return None


def make_whole(folder: Path) -> None:
    """Create those databases below the folder of a storage that are missing, or were left unfinished and hold nothing.

    Raises:
        StoreError: a database is damaged, is read-only for this user, or cannot be created.
    """
    for path in (folder / name for name in _DATABASES):
        # Only to read it, SQLite would put files beside it, of this user, with which its owner could not write any more.
        if path.exists() and not os.access(path, os.W_OK):
            raise StoreError(
                f"{path}: this database of Dagster is read-only for this user; run this as its owner or as root, or fix its "
                "permissions."
            )
    try:
        with database_errors_explained(str(folder)):
            if _unfinished(folder):
                with LockFile.open(folder / _LOCK) as file:
                    file.lock()  # waits while another process creates them
                    _make(folder, _unfinished(folder))
    except OSError as err:
        raise StoreError(
            f"{err.filename or folder}: Dagster's database cannot be created ({err.strerror}); {disk_advice(err)}."
        ) from err


def read_settings(home: Path) -> InstanceRef:
    """Return the settings in a Dagster home folder; they are parsed again only if the text of the file has changed.

    Raises:
        BagAssetsError: they name modules of another version of bagassets.
    """
    config = home / "dagster.yaml"
    return _settings(str(home), config.read_bytes() if config.is_file() else b"")


@lru_cache(maxsize=8)
def _settings(home: str, _text: bytes) -> InstanceRef:
    settings = InstanceRef.from_dir(home)
    named = {str(getattr(part, "module_name", "")) for part in settings}
    for module in sorted(name for name in named if name.startswith("bagassets.") and not _exists(name)):
        raise BagAssetsError(
            f"{home}/dagster.yaml: there is no {module} in this version of bagassets, so another one wrote the file; use that, "
            f"or have this one write it anew: `bagassets init {shlex.quote(home)}`. Recipe and records stay."
        )
    storage = settings.storage_data
    if storage is not None and storage.class_name == DagsterSqliteStorage.__name__:
        # The same files, read and written faster.
        ours = ConfigurableClassData(_OUR_STORAGE, "ShardedStorage", storage.config_yaml)
        settings = settings._replace(storage_data=ours)
    return settings


def _exists(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # nor its package
        return False


@contextmanager
def database_errors_explained(place: str) -> Iterator[None]:
    """Turn errors of the database into ours: a full disk, missing permission, a server that is down, damage.

    Args:
        place: the Dagster home, for the message.

    Raises:
        StoreError: the database refused.
    """
    try:
        yield
    except OperationalError as err:
        raise StoreError(
            f"{place}: Dagster's database cannot be used ({err.orig}); free disk space, or fix the folder or server that "
            "dagster.yaml names. Nothing that is in the store is lost."
        ) from err
    except DatabaseError as err:
        if type(err.orig) is not sqlite3.DatabaseError:
            raise
        raise _damaged(Path(place), str(err.orig)) from err
    except sqlite3.DatabaseError as err:
        # Of a file of our own in the state folder, opened without SQLAlchemy.
        raise StoreError(
            f"{place}: a database of this project cannot be used ({err}); free disk space, or fix the permissions of its "
            "state folder. Nothing that is in the store is lost."
        ) from err


def _unfinished(folder: Path) -> list[str]:
    """Return the databases that are missing, or were left unfinished and hold nothing.

    Raises:
        StoreError: one is damaged.
    """
    try:
        return [name for name, schema in _DATABASES.items() if not _is_whole(folder / name, schema)]
    except sqlite3.DatabaseError as err:
        raise _damaged(folder, str(err)) from err


def _is_whole(path: Path, schema: MetaData) -> bool:
    """Return whether a database is finished, or holds something worth keeping."""
    if not path.exists():
        return False
    try:
        with closing(open_read_only(str(path), _BUSY_S)) as connection:
            rows = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
            tables = {name for (name,) in rows}
            if tables.issuperset({*schema.tables, _VERSION}) and all(
                _has_rows(connection, name) for name in (_VERSION, _INDEXES)
            ):
                return True
            return any(_has_rows(connection, name) for name in tables - _REPLACEABLE)
    except sqlite3.OperationalError:
        return True  # in use or unreadable: Dagster will report that itself


def _has_rows(connection: sqlite3.Connection, table: str) -> bool:
    quoted = table.replace('"', '""')
    return connection.execute(f'SELECT 1 FROM "{quoted}" LIMIT 1').fetchone() is not None  # noqa: S608  (quoted)


def _make(folder: Path, names: list[str]) -> None:
    """Put new databases in place; a process that is killed meanwhile leaves old or new ones, each of them whole."""
    for leftover in folder.glob(f"{_NEW}*"):
        shutil.rmtree(leftover, ignore_errors=True)
    if not names:
        return
    new = folder / f"{_NEW}{uuid4().hex}"
    try:
        with _unsynced(new), _migrations_read_once():
            DagsterSqliteStorage.from_local(str(new)).dispose()
        _lay_out(new / EVENTS)
        for name in names:
            path = folder / name
            with (new / name).open("rb") as file:
                os.fsync(file.fileno())
            path.parent.mkdir(parents=True, exist_ok=True)
            # First the files beside the old one: a log of another database would spoil the new one.
            for kind in ("wal", "shm", "journal"):
                path.with_name(f"{path.name}-{kind}").unlink(missing_ok=True)
            (new / name).replace(path)
    finally:
        shutil.rmtree(new, ignore_errors=True)


@contextmanager
def _unsynced(folder: Path) -> Iterator[None]:
    """Have SQLite write databases below a folder without waiting for the disk after each of a hundred statements."""

    def connected(connection: sqlite3.Connection, _: object) -> None:
        _, _, path = connection.execute("PRAGMA database_list").fetchone()
        if Path(path).is_relative_to(folder.resolve()):
            connection.execute("PRAGMA synchronous = OFF")

    event.listen(Engine, "connect", connected)
    try:
        yield
    finally:
        event.remove(Engine, "connect", connected)


@contextmanager
def _migrations_read_once() -> Iterator[None]:
    """Have Alembic read Dagster's migrations once for all databases, not seven times, which takes half of the time."""
    usual, read = vars(ScriptDirectory)[_FROM_CONFIG], dict[str | None, ScriptDirectory]()

    def from_config(config: Config) -> ScriptDirectory:
        place = config.get_main_option("script_location")
        if place not in read:
            read[place] = usual.__get__(None, ScriptDirectory)(config)
        return read[place]

    setattr(ScriptDirectory, _FROM_CONFIG, staticmethod(from_config))
    try:
        yield
    finally:
        setattr(ScriptDirectory, _FROM_CONFIG, usual)


def _lay_out(path: Path) -> None:
    """Choose the pages of a database of events that has none yet, and let it give back what deleted runs leave."""
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode = DELETE")  # else the size of pages cannot be changed
        connection.execute(f"PRAGMA page_size = {_PAGE_BYTES}")
        connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
        connection.execute("VACUUM")
        connection.execute("PRAGMA journal_mode = WAL")


def _first_damaged(home: Path) -> Path | None:
    """Return the database that SQLite finds damage in; None if it finds none."""
    folder = storage_folder(home) or home
    for path in (*(folder / name for name in _DATABASES), *sorted(folder.glob("history/runs/*.db"))):
        try:
            with closing(open_read_only(str(path), _BUSY_S)) as connection:
                if connection.execute("PRAGMA integrity_check(1)").fetchall() != [("ok",)]:
                    return path
        except sqlite3.OperationalError:
            continue
        except sqlite3.DatabaseError:
            return path
    return None


def _damaged(home: Path, reason: str) -> StoreError:
    """Return the error about what SQLite calls damage: it says the same of a read that failed."""
    path = _first_damaged(home)
    if path is None:
        return StoreError(
            f"{home}: a database of Dagster could not be read ({reason}), and is whole when it is read again; check its disk or file "
            "server, and try again."
        )
    aside = f"mv {shlex.quote(str(path))} {shlex.quote(f'{path}.damaged')}"
    return StoreError(
        f"{path}: this database of Dagster is damaged ({reason}). Stop `bagassets ui`, then restore it from a backup or "
        f"move it aside (`{aside}`), and build again: all artifacts in the store are safe and nothing is made again; "
        "only the history of runs in this file is lost."
    )
