"""Marks: texts that change whenever files, code or records of a database do."""

import os
import site
import sqlite3
import sys
from collections.abc import Iterator
from contextlib import closing
from functools import cache
from hashlib import blake2b
from typing import Any

__all__ = [
    "Doubt",
    "Signature",
    "boot",
    "code_mark",
    "digest",
    "files_mark",
    "loaded_code",
    "places_mark",
    "project_mark",
    "recipe_mark",
    "records_mark",
    "signature",
    "signature_of",
    "site_folders",
    "texts_mark",
    "tree_mark",
]

_PACKAGE = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
_SOURCES = (".py", ".so", ".yaml", ".json", ".msg")
_DISTRIBUTIONS = (".dist-info", ".egg-info", ".pth", ".egg-link")

Signature = list[int]
"""Size, time of writing (ns), inode and time of change (ns) of a file; empty if it is not there."""


class Doubt(Exception):  # noqa: N818  (a reason to look closer, not an error)
    """Something differs, or cannot be seen; its text says what."""


def digest(lines: list[str]) -> str:
    """Return the digest of lines of text."""
    # Names that are no UTF-8 come as lone surrogates.
    return blake2b("\n".join(lines).encode("utf-8", "surrogateescape"), digest_size=32).hexdigest()


# --- files -------------------------------------------------------------------------------


def signature(path: str | os.PathLike[str]) -> Signature:
    """Return what tells whether a file, or the entries of a folder, changed; empty if it is not there.

    Inode and time of change (ctime) cannot be put back by whoever edits a file in place.
    """
    try:
        return signature_of(os.stat(path))
    except OSError:
        return []


def signature_of(stat: os.stat_result) -> Signature:
    """Return the signature of a file that was looked at."""
    return [stat.st_size, stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns]


def boot() -> str:
    """Return the name of this boot of the machine; empty where it has none."""
    try:
        with open("/proc/sys/kernel/random/boot_id", encoding="ascii") as stream:
            return stream.read().strip()
    except (OSError, ValueError):
        return ""


def files_mark(paths: list[str]) -> str:
    """Return the mark of files, whether they are there or not."""
    return digest([f"{path}\0{signature(path)}" for path in paths])


def texts_mark(paths: list[str]) -> str:
    """Return the mark of what small files say, in order: one that is written again, or moved, has not changed."""
    texts = []
    for path in paths:
        try:
            with open(path, "rb") as stream:
                texts.append(blake2b(stream.read()).hexdigest())
        except OSError:
            texts.append("")
    return digest(texts)


def places_mark(paths: list[str]) -> str:
    """Return the mark of where paths lead to: that changes when a link on the way to one is made or replaced."""
    return digest([f"{path}\0{os.path.realpath(path)}" for path in paths])


def tree_mark(root: str, *, hidden: bool = False) -> str:
    """Return the mark of everything below a folder.

    Links are followed as finding recordings does, and noted themselves.

    Args:
        root: the folder.
        hidden: look at what is hidden, too.

    Raises:
        Doubt: a folder cannot be read.
    """
    lines: list[str] = []
    _walk(root, (), lines, hidden=hidden)
    lines.sort()
    return digest(lines)


def _walk(folder: str, ancestors: tuple[tuple[int, int], ...], lines: list[str], *, hidden: bool) -> None:
    try:
        status = os.stat(folder)
        identity = (status.st_dev, status.st_ino)
        if identity in ancestors:
            return
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.startswith(".") and not hidden:
                    continue
                if entry.is_symlink():
                    lines.append(f"{entry.path}\0link\0{os.readlink(entry.path)}")
                try:
                    stat = entry.stat()
                except FileNotFoundError:  # a link that leads nowhere, or removed just now
                    lines.append(f"{entry.path}\0gone")
                    continue
                if entry.is_dir():
                    lines.append(f"{entry.path}\0folder")
                    _walk(entry.path, (*ancestors, identity), lines, hidden=hidden)
                else:
                    lines.append(
                        f"{entry.path}\0{stat.st_size}\0{stat.st_mtime_ns}\0{stat.st_ino}\0{stat.st_ctime_ns}"
                    )
    except OSError as err:
        raise Doubt(f"{folder}: {err}") from err


# --- code and recipe ---------------------------------------------------------------------


def recipe_mark(recipe: str | os.PathLike[str]) -> str:
    """Return the mark of a recipe's text and of the `.env` beside it."""
    return texts_mark([os.fspath(recipe), os.path.join(os.path.dirname(recipe), ".env")])


def project_mark(code: str, recipe: str, files: list[str], folders: list[str]) -> str:
    """Return the mark of all that every recording is decided from: code, recipe and the files that it names.

    The environment does not count: no result depends on it.

    Args:
        code: what `code_mark` gives, or `loaded_code` of a process that has imported it.
        recipe: what `recipe_mark` gave before the recipe was read.
        files: files that the recipe names, there or not.
        folders: folders that it names, for all that is in them.

    Raises:
        Doubt: a folder cannot be read.
    """
    return digest([code, recipe, files_mark(files), *(tree_mark(folder, hidden=True) for folder in folders)])


@cache
def loaded_code() -> str:
    """Return the mark of the code that this process decides with: as it was when first asked for.

    A process that lives long, as Dagster's daemon does, must not note what it decides under the mark of newer code.
    """
    return code_mark()


def code_mark(sources: tuple[str, ...] = (_PACKAGE,)) -> str:
    """Return the mark of the interpreter, the installed distributions and our code as they are now.

    Of code it is size and time of writing, not inode and time of change: installers link one file into many
    environments, and each of them would change the others.

    Args:
        sources: files and folders of source code.
    """
    lines = [sys.executable, sys.version, *_distributions()]
    for root in sources:
        lines += [root, *sorted(_source_lines(root))]
    return digest(lines)


@cache
def site_folders() -> tuple[str, ...]:
    """Return the folders that this interpreter installs packages into, whatever the current folder is."""
    names = site.getsitepackages()
    if site.ENABLE_USER_SITE:
        names.append(site.getusersitepackages())
    return tuple(dict.fromkeys(os.path.realpath(name) for name in names))


def _distributions() -> list[str]:
    """Return name and time of each installed distribution; an upgrade changes one or the other.

    Those in PYTHONPATH count too: a decoder plug-in may be among them.
    """
    lines = []
    beside = [name for name in os.environ.get("PYTHONPATH", "").split(os.pathsep) if name]
    for folder in (*site_folders(), *beside):
        try:
            with os.scandir(folder) as entries:
                lines += [
                    f"{entry.name}\0{entry.stat().st_mtime_ns}"
                    for entry in entries
                    if entry.name.endswith(_DISTRIBUTIONS)
                ]
        except OSError:
            continue
    return sorted(lines)


def _source_lines(root: str) -> Iterator[str]:
    """Yield path, size and time of writing of the source files at or below `root`, in no order."""
    if os.path.isfile(root):
        stat = os.stat(root)
        yield f"{root}\0{stat.st_size}\0{stat.st_mtime_ns}"
        return
    try:
        with os.scandir(root) as entries:
            for entry in entries:
                if entry.name == "__pycache__" or entry.name.startswith("."):
                    continue
                if entry.is_dir():
                    yield from _source_lines(entry.path)
                elif entry.name.endswith(_SOURCES):
                    stat = entry.stat()
                    yield f"{entry.path}\0{stat.st_size}\0{stat.st_mtime_ns}"
    except FileNotFoundError:  # an editor's passing file
        return


# --- records -----------------------------------------------------------------------------

# The schema that these were written for: `alembic_version` of Dagster 1.13. PostgreSQL keeps the events of runs in the
# table of those about assets, which alone count.
_QUERIES = (
    "SELECT version_num FROM alembic_version",
    "SELECT max(id), count(*) FROM event_logs {chosen}",
    "SELECT id, run_id, timestamp FROM event_logs {chosen} ORDER BY id DESC LIMIT 1",
    "SELECT asset_key, last_run_id, last_materialization_timestamp, wipe_timestamp FROM asset_keys ORDER BY asset_key",
)
_PARTITIONS = "SELECT partition FROM dynamic_partitions WHERE partitions_def_name = {mark} ORDER BY partition"


def records_mark(place: str, partitions: str) -> str:
    """Return a mark that changes with every event about an asset, wipe, deleted run or partition.

    Ids alone would not do: SQLite gives those of deleted events away again.

    Args:
        place: the database of Dagster's event log: a file of SQLite, or the URL of a PostgreSQL database.
        partitions: name of the dynamic partitions.

    Raises:
        Doubt: it cannot be read, or has another schema.
    """
    adapter = _postgres if "://" in place else _sqlite
    return digest([repr(rows) for rows in adapter(place, partitions)])


def _sqlite(path: str, partitions: str) -> list[Any]:
    try:
        with closing(open_read_only(path)) as connection:
            return _rows(connection.cursor(), partitions, mark="?")
    except sqlite3.Error as err:
        raise Doubt(f"{path}: {err}") from err


def _postgres(url: str, partitions: str) -> list[Any]:
    try:
        import psycopg2
    except ImportError as err:
        raise Doubt("psycopg2 is not installed") from err
    scheme, _, rest = url.partition("://")
    try:
        with closing(
            psycopg2.connect(f"{scheme.partition('+')[0]}://{rest}", connect_timeout=2)
        ) as connection:
            return _rows(connection.cursor(), partitions, mark="%s", chosen="WHERE asset_key IS NOT NULL")
    except psycopg2.Error as err:
        raise Doubt(f"PostgreSQL: {err}") from err


def open_read_only(path: str) -> sqlite3.Connection:
    """Open a database of SQLite without ever making or changing one.

    Raises:
        sqlite3.Error: that is not possible.
    """
    quoted = path.replace("%", "%25").replace("?", "%3f").replace("#", "%23")
    return sqlite3.connect(f"file:{quoted}?mode=ro", timeout=1.0, uri=True)


def _rows(cursor: Any, partitions: str, *, mark: str, chosen: str = "") -> list[Any]:
    """Return what each query gives; `mark` stands for a value, `chosen` picks the events that count."""
    rows: list[Any] = []
    for query in _QUERIES:
        cursor.execute(query.format(chosen=chosen))
        rows.append(cursor.fetchall())
    cursor.execute(_PARTITIONS.format(mark=mark), (partitions,))
    rows.append(cursor.fetchall())
    return rows
