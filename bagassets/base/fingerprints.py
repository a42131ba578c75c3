"""Fingerprints: texts that change whenever files, code or records of a database do."""

import os
import site
import sqlite3
import sys
from collections.abc import Iterator
from contextlib import closing
from functools import cache
from hashlib import blake2b
from typing import Any

_PACKAGE = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
_SOURCES = (".py", ".so", ".yaml", ".json", ".msg")
_DISTRIBUTIONS = (".dist-info", ".egg-info", ".pth", ".egg-link")

Signature = list[int]
"""Size, time of writing (ns), inode and time of change (ns) of a file; empty if it is not there."""


class PlanNeeded(Exception):  # noqa: N818  (a reason to plan in full, not an error)
    """Something differs or cannot be read, so only a full plan can decide; the message names it."""


def digest_lines(lines: list[str]) -> str:
    """Return the digest of lines of text."""
    # Names that are not UTF-8 come as lone surrogates.
    return blake2b("\n".join(lines).encode("utf-8", "surrogateescape"), digest_size=32).hexdigest()


# --- files -------------------------------------------------------------------------------


def signature(path: str | os.PathLike[str]) -> Signature:
    """Return what changes when a file or the entries of a folder do; empty if the path does not exist.

    Whoever edits a file in place cannot reset its inode and change time (ctime).
    """
    try:
        return signature_of(os.stat(path))
    except OSError:
        return []


def signature_of(stat: os.stat_result) -> Signature:
    """Return the signature of a file from its `os.stat`."""
    return [stat.st_size, stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns]


def boot_id() -> str:
    """Return the id of the current boot of the machine; empty where the system has none."""
    try:
        with open("/proc/sys/kernel/random/boot_id", encoding="ascii") as stream:
            return stream.read().strip()
    except (OSError, ValueError):
        return ""


def booted_at_s() -> float | None:
    """Return when the machine was booted (Unix seconds), or None where the system does not say."""
    try:
        with open("/proc/stat", encoding="ascii") as stream:
            return next((float(line.split()[1]) for line in stream if line.startswith("btime ")), None)
    except (OSError, ValueError):
        return None


def files_fingerprint(paths: list[str]) -> str:
    """Return the fingerprint of files, whether they exist or not."""
    return digest_lines([f"{path}\0{signature(path)}" for path in paths])


def contents_fingerprint(paths: list[str]) -> str:
    """Return the fingerprint of the contents of small files, in order: rewriting or moving one changes nothing."""
    texts = []
    for path in paths:
        try:
            with open(path, "rb") as stream:
                texts.append(blake2b(stream.read()).hexdigest())
        except OSError:
            texts.append("")
    return digest_lines(texts)


def paths_fingerprint(paths: list[str]) -> str:
    """Return the fingerprint of what paths resolve to: it changes when a link on the way is made or replaced."""
    return digest_lines([f"{path}\0{os.path.realpath(path)}" for path in paths])


def tree_fingerprint(root: str, *, hidden: bool = False) -> str:
    """Return the fingerprint of everything below a folder; see `tree_lines`."""
    return digest_lines(tree_lines(root, hidden=hidden))


def tree_lines(root: str, *, hidden: bool = False) -> list[str]:
    """Return a line for everything below a folder, in order: its path, up to the first NUL, and what changes with it.

    Links are followed, as in the search for recordings, and their targets count, too.

    Args:
        root: the folder.
        hidden: include hidden files and folders.

    Raises:
        PlanNeeded: a folder cannot be read.
    """
    lines: list[str] = []
    _walk(root, (), lines, hidden=hidden)
    lines.sort()
    return lines


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
                except FileNotFoundError:  # a dangling link, or removed just now
                    lines.append(f"{entry.path}\0gone")
                    continue
                if entry.is_dir():
                    lines.append(f"{entry.path}\0folder")
                    _walk(entry.path, (*ancestors, identity), lines, hidden=hidden)
                else:
                    # No inode: some file systems give a file another one whenever the kernel has forgotten it.
                    lines.append(f"{entry.path}\0{stat.st_size}\0{stat.st_mtime_ns}\0{stat.st_ctime_ns}")
    except OSError as err:
        raise PlanNeeded(f"{folder}: {err}") from err


# --- code and recipe ---------------------------------------------------------------------


def recipe_fingerprint(recipe: str | os.PathLike[str]) -> str:
    """Return the fingerprint of a recipe's text and of the `.env` beside it."""
    return contents_fingerprint([os.fspath(recipe), os.path.join(os.path.dirname(recipe), ".env")])


def project_fingerprint(code: str, recipe: str, files: list[str], folders: list[str]) -> str:
    """Return the fingerprint of what every plan depends on: the code, the recipe and the files that it names.

    The environment does not count: no result depends on it.

    Args:
        code: from `code_fingerprint`, or `loaded_code_fingerprint` in a process that has imported the code.
        recipe: from `recipe_fingerprint`, taken before the recipe was read.
        files: files that the recipe names, whether they exist or not.
        folders: folders that it names; everything in them counts.

    Raises:
        PlanNeeded: a folder cannot be read.
    """
    trees = [tree_fingerprint(folder, hidden=True) for folder in folders]
    return digest_lines([code, recipe, files_fingerprint(files), *trees])


@cache
def loaded_code_fingerprint() -> str:
    """Return the fingerprint of the code that this process runs, as it was at the first call.

    A long-lived process such as Dagster's daemon must not note its decisions under the fingerprint of newer code.
    """
    return code_fingerprint()


def code_fingerprint(sources: tuple[str, ...] = (_PACKAGE,)) -> str:
    """Return the fingerprint of the interpreter, the installed distributions and our code as they are now.

    For code, size and modification time count, not inode and change time: installers link one file into many
    environments, and each installation would change the fingerprints of the others.

    Args:
        sources: files and folders of source code.
    """
    lines = [sys.executable, sys.version, *_distributions()]
    for root in sources:
        lines += [root, *sorted(_source_lines(root))]
    return digest_lines(lines)


@cache
def site_folders() -> tuple[str, ...]:
    """Return the folders into which packages are installed for this interpreter."""
    names = site.getsitepackages()
    if site.ENABLE_USER_SITE:
        names.append(site.getusersitepackages())
    return tuple(dict.fromkeys(os.path.realpath(name) for name in names))


def _distributions() -> list[str]:
    """Return name and modification time of each installed distribution; an upgrade changes one or the other.

    Those in PYTHONPATH count, too: a plug-in may be among them.
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
    """Yield path, size and modification time of the source files at or below `root`, in no order."""
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
    except FileNotFoundError:  # a temporary file of an editor
        return


# --- records -----------------------------------------------------------------------------

# Written for the schema of Dagster 1.13, which `alembic_version` names. PostgreSQL keeps events of runs and events of
# assets in one table; only the latter count.
_QUERIES = (
    "SELECT version_num FROM alembic_version",
    "SELECT max(id), count(*) FROM event_logs {chosen}",
    "SELECT id, run_id, timestamp FROM event_logs {chosen} ORDER BY id DESC LIMIT 1",
    "SELECT asset_key, last_run_id, last_materialization_timestamp, wipe_timestamp FROM asset_keys ORDER BY asset_key",
)
_PARTITIONS = (
    "SELECT partition FROM dynamic_partitions WHERE partitions_def_name = {placeholder} ORDER BY partition"
)


def records_fingerprint(place: str, partitions: str) -> str:
    """Return a fingerprint that changes with every asset event, wipe, deleted run or partition.

    Ids alone would not do: SQLite reuses those of deleted events.

    Args:
        place: the database of Dagster's event log: an SQLite file, or the URL of a PostgreSQL database.
        partitions: name of the dynamic partitions.

    Raises:
        PlanNeeded: the database cannot be read, or has another schema.
    """
    adapter = _postgres if "://" in place else _sqlite
    return digest_lines([repr(rows) for rows in adapter(place, partitions)])


def _sqlite(path: str, partitions: str) -> list[object]:
    try:
        with closing(open_read_only(path)) as connection:
            return _rows(connection.cursor(), partitions, placeholder="?")
    except sqlite3.Error as err:
        raise PlanNeeded(f"{path}: {err}") from err


def _postgres(url: str, partitions: str) -> list[object]:
    try:
        import psycopg2
    except ImportError as err:
        raise PlanNeeded("psycopg2 is not installed") from err
    scheme, _, rest = url.partition("://")
    try:
        with closing(
            psycopg2.connect(f"{scheme.partition('+')[0]}://{rest}", connect_timeout=2)
        ) as connection:
            cursor = connection.cursor()
            return _rows(cursor, partitions, placeholder="%s", chosen="WHERE asset_key IS NOT NULL")
    except psycopg2.Error as err:
        raise PlanNeeded(f"PostgreSQL: {err}") from err


def open_read_only(path: str, busy_s: float = 1.0) -> sqlite3.Connection:
    """Open an SQLite database without ever creating or changing it.

    Raises:
        sqlite3.Error: it does not exist, or cannot be opened.
    """
    quoted = path.replace("%", "%25").replace("?", "%3f").replace("#", "%23")
    return sqlite3.connect(f"file:{quoted}?mode=ro", timeout=busy_s, uri=True)


def _rows(cursor: Any, partitions: str, *, placeholder: str, chosen: str = "") -> list[object]:
    """Return the rows of each query; `placeholder` stands for a value, `chosen` selects the events that count."""
    rows: list[object] = []
    for query in _QUERIES:
        cursor.execute(query.format(chosen=chosen))
        rows.append(cursor.fetchall())
    cursor.execute(_PARTITIONS.format(placeholder=placeholder), (partitions,))
    rows.append(cursor.fetchall())
    return rows
