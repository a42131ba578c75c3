"""Files that only old tables name."""

from collections.abc import Set as AbstractSet
from contextlib import suppress
from pathlib import Path

from bagassets.nuscenes.filenames import recording_of
from bagassets.nuscenes.table_file import copy_rows

__all__ = ["named_files", "remove_files"]

_FIELD = b'"filename":"'


def named_files(tables: Path, keys: AbstractSet[str]) -> set[str]:
    """Return the files of some recordings that a folder of tables names; none if the table is not there.

    Rows are one per line and file names need no escapes, so that nothing has to be parsed: an old
    dataset may have millions of rows.

    Args:
        tables: a version folder.
        keys: partition keys of the recordings.
    """
    path = tables / "sample_data.json"
    if not path.is_file():
        return set()
    names = set()
    for row in copy_rows(path):
        _, found, rest = row.partition(_FIELD)
        name = rest.partition(b'"')[0].decode()
        if found and recording_of(name) in keys:
            names.add(name)
    return names


def remove_files(dataroot: Path, names: set[str]) -> int:
    """Remove files below the dataroot, and folders of channels that become empty; return their number."""
    removed = 0
    for name in sorted(names):
        with suppress(FileNotFoundError):
            (dataroot / name).unlink()
            removed += 1
    for folder in sorted({(dataroot / name).parent for name in names}):
        with suppress(OSError):  # not empty, or gone
            folder.rmdir()
    return removed
