"""The swapped folder of a dataset as it was when it was opened.

A build makes a new folder and exchanges it with the old one, which is then removed. So all files are opened at once, through
the folder rather than through its path; whatever is read later, and however often the dataset is built meanwhile, comes from
the same folder.
"""

import json
import os
import weakref
from collections import deque
from collections.abc import Collection
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path

from bagassets.base.errors import DatasetError
from bagassets.base.json_types import Json, JsonObject

LOCK = "dataset.lock.json"
# So often in a row, a folder may be swapped while it is being opened.
_TRIES = 20
_BLOCK = 1 << 24


class TableFolder:
    """The JSON files of a folder, all of one state.

    Attributes:
        path: the folder.
        identity: equal for equal content: a digest of the lock, which has the digests of all files; without a lock, of their
            sizes and times.
        recent: images that were decoded last. Freed at once, they would give their pages back, and new ones cost as much as decoding.

    Raises:
        DatasetError: the folder cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.recent: deque[object] = deque(maxlen=4)
        self._files = _open_all(path)
        weakref.finalize(self, _close, list(self._files.values()))
        self.identity = self._identity()

    @property
    def names(self) -> Collection[str]:
        """Names of the files."""
        return self._files.keys()

    def read(self, name: str) -> Json:
        """Return the content of a file.

        Raises:
            DatasetError: it is missing, or no JSON.
        """
        if name not in self._files:
            raise self.missing(self.path / name)
        try:
            return json.loads(_content(self._files[name]))
        except (OSError, ValueError) as err:
            raise self.unreadable(self.path / name, err) from err

    def rows(self, name: str) -> list[JsonObject]:
        """Return the rows of a file that is a list.

        Raises:
            DatasetError: it is missing, or no list.
        """
        rows = self.read(name)
        if not isinstance(rows, list):
            raise DatasetError(f"{self.path / name}: expected a list of rows; {self.remedy()}")
        return rows

    def missing(self, path: Path) -> DatasetError:
        """Return the error for a file that the dataset names and that is not there."""
        return DatasetError(f"{path}: this file of the dataset is missing; {self.remedy()}")

    def unreadable(self, path: Path, err: Exception) -> DatasetError:
        """Return the error for a file that cannot be read."""
        return DatasetError(f"{path}: this file of the dataset cannot be read ({err}); {self.remedy()}")

    def outdated(self, path: Path) -> DatasetError:
        """Return the error for a file that another build has removed."""
        name = path.relative_to(self.path.parent)
        return DatasetError(
            f"{self.path}: this dataset was built again since it was opened, and {name} is no longer part of it; open it again."
        )

    def is_current(self) -> bool:
        """Tell whether whoever opens the dataset now gets the same."""
        try:
            return TableFolder(self.path).identity == self.identity
        except DatasetError:
            return False

    def remedy(self) -> str:
        """Return the half sentence that says how to get files of the dataset back."""
        if LOCK in self._files:
            return (
                "`bagassets build` in its project makes it again, and so does "
                f"`bagassets dataset restore {self.path / LOCK}`."
            )
        return "get it from where the dataset comes from."

    def _identity(self) -> str:
        if LOCK in self._files:
            return blake2b(_content(self._files[LOCK]), digest_size=16).hexdigest()
        stats = {name: os.fstat(file) for name, file in sorted(self._files.items())}
        facts = [[name, stat.st_size, stat.st_mtime_ns] for name, stat in stats.items()]
        return blake2b(json.dumps(facts).encode(), digest_size=16).hexdigest()


def _open_all(path: Path) -> dict[str, int]:
    """Return name -> file descriptor of the JSON files of a folder."""
    try:
        for _ in range(_TRIES):
            files = _open_once(path)
            if files is not None:
                return files
    except OSError as err:
        raise DatasetError(f"{path}: the dataset cannot be opened ({err.strerror or err}).") from err
    raise DatasetError(f"{path}: this dataset is being replaced all the time; stop what builds it.")


def _open_once(path: Path) -> dict[str, int] | None:
    """Open the files of a folder; return None if it was swapped meanwhile."""
    folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    files: dict[str, int] = {}
    is_whole = False
    try:
        with suppress(FileNotFoundError):
            with os.scandir(folder) as entries:
                names = [entry.name for entry in entries if entry.name.endswith(".json")]
            for name in names:
                files[name] = os.open(name, os.O_RDONLY, dir_fd=folder)
            # Removal begins after the swap: if the folder is still in its place, nothing of it was removed.
            is_whole = os.path.samestat(os.stat(path), os.fstat(folder))
    finally:
        os.close(folder)
        if not is_whole:
            _close(list(files.values()))
    return files if is_whole else None


def _content(file: int) -> bytes:
    """Read a file without moving its position, which processes share after a fork."""
    size, parts, offset = os.fstat(file).st_size, [], 0
    while offset < size and (part := os.pread(file, min(_BLOCK, size - offset), offset)):
        parts.append(part)
        offset += len(part)
    return b"".join(parts)


def _close(files: list[int]) -> None:
    for file in files:
        os.close(file)
