"""Placing files of the store in a dataset, without copying them if the file system allows."""

import errno
import filecmp
import os
from collections import Counter
from contextlib import suppress
from pathlib import Path

from bagassets.base import files
from bagassets.base.disk_errors import disk_advice
from bagassets.base.errors import DatasetError

# Hard links do not cross file systems; some file systems have none, or limit their number per file.
_NO_HARD_LINK = {errno.EXDEV, errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EACCES}


class Linker:
    """Makes files appear in a dataset as hard links, else reflinks, else copies.

    A file is there whole or not at all. One that exists already is kept, because names in a dataset contain a digest of
    the content.

    Attributes:
        counts: `linked`, `cloned`, `copied`, or `kept` for existing files -> number of files.
        torn_since_s: see below.

    Args:
        root: the dataset's folder.
        scratch: a folder on its file system, which is removed if the process is killed; copies are made there.
        torn_since_s: existing files made since then (Unix seconds) may be torn, and are compared with the source; None if none
            are.
    """

    def __init__(self, root: Path, scratch: Path, torn_since_s: float | None = None) -> None:
        self.counts: Counter[str] = Counter()
        self.torn_since_s = torn_since_s
        self._root, self._scratch = str(root), scratch
        self._folders: set[str] = set()
        self._hard_links = True

    def put(self, source: str, filename: str, *, replaces: bool = False) -> None:
        """Make the file `source` appear as `filename` below the root.

        Args:
            source: the file.
            filename: its path below the root.
            replaces: replace any other file of that name; one that is no link to the source is compared with it.

        Raises:
            DatasetError: the source is gone, or the dataset cannot be written.
        """
        # Plain strings: datasets have millions of files, and a Path costs more than a link.
        target = f"{self._root}/{filename}"
        if replaces or self._may_be_torn(target):
            self._remove_other(source, target)
        folder = target.rpartition("/")[0]
        try:
            if folder not in self._folders:
                files.make_folder(folder)
                self._folders.add(folder)
            self.counts[self._put(source, target)] += 1
        except FileNotFoundError as err:
            raise DatasetError(
                f"{source}: this file of the store is gone, so {filename} cannot be made; build again to repair the store."
            ) from err
        except OSError as err:
            raise DatasetError(f"{target}: cannot be written ({err.strerror}); {disk_advice(err)}.") from err

    def _may_be_torn(self, target: str) -> bool:
        with suppress(FileNotFoundError):
            return self.torn_since_s is not None and os.stat(target).st_mtime >= self.torn_since_s
        return False

    @staticmethod
    def _remove_other(source: str, target: str) -> None:
        try:
            if os.path.lexists(target) and not _same_content(source, target):
                files.remove(target)
        except OSError as err:
            raise DatasetError(
                f"{target}: cannot be replaced by the file that belongs there ({err.strerror}); move it away."
            ) from err

    def _put(self, source: str, target: str) -> str:
        if self._hard_links:
            try:
                files.link(source, target)
            except FileExistsError:
                return "kept"
            except OSError as err:
                if err.errno in _NO_HARD_LINK:
                    self._hard_links = False
                elif err.errno != errno.EMLINK:  # too many links to this file: copy only this one
                    raise
            else:
                return "linked"
        if os.path.lexists(target):
            return "kept"
        with files.replacing(Path(target), self._scratch) as temporary:
            if files.clone(source, temporary):
                return "cloned"
            files.copy(source, temporary)
            return "copied"


def _same_content(source: str, target: str) -> bool:
    """Tell whether a target is its source or has the same bytes; whoever links the source reports a missing one."""
    try:
        return Path(source).samefile(target) or filecmp.cmp(source, target, shallow=False)
    except FileNotFoundError:
        return False
