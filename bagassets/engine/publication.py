"""The record of what was published: written when a dataset is, asked when the next build plans."""

import json
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

from bagassets.quick.looks import Doubt, signature
from bagassets.quick.published import FORMAT, HEAD, Head, differing, folder_signature, line_of, load_head
from bagassets.store.canonical import digest_file

__all__ = ["FOLDER", "Publication"]

FOLDER = "published"
_LIST = ".list"


class Publication:
    """What is recorded of one dataset; see `bagassets.quick.published`.

    Attributes:
        folder: where that is.
    """

    def __init__(self, state: Path, asset: str) -> None:
        self.folder = state / FOLDER / asset

    def differing(self, root: Path) -> frozenset[str] | None:
        """Return the files below `root` that are not as they were published; None if nothing is recorded of them."""
        try:
            if load_head(str(self.folder))["root"] != str(root):
                return None
            return frozenset(differing(str(self.folder)))
        except Doubt:
            return None

    def is_as_published(self, root: Path) -> bool:
        """Tell whether the dataset is as it was published.

        What was put together and has other times is read: if its bytes are the same, that is noted. So are other
        times of folders whose links are all there.
        """
        try:
            head = load_head(str(self.folder))
            # Before anything is looked at: what comes or goes meanwhile shows next time.
            folders = {name: folder_signature(str(root / name)) for name in head["folders"]}
            found = differing(str(self.folder))
            files = head["files"] | {name: signature(str(root / name)) for name in found}
            digests = head["digests"]
            if head["root"] != str(root) or any(
                name not in digests or digest_file(root / name) != digests[name] for name in found
            ):
                return False
        except (Doubt, OSError):
            return False
        if found or folders != head["folders"]:
            self._write_head(Head(**(head | {"files": files, "folders": folders})))
        return True

    def write(
        self,
        root: Path,
        files: Mapping[str, str],
        links: Mapping[str, Callable[[], Iterable[str]]],
        suspects: frozenset[str] | None,
    ) -> None:
        """Record a dataset that was just put together; where that cannot be, the next build looks closer.

        Args:
            root: its folder.
            files: name -> digest of what was put together.
            links: name of a recording's part -> gives its links; called only if they are not on record.
            suspects: what `differing` said before; None has all links looked at anew.
        """
        with suppress(OSError):
            self.folder.mkdir(parents=True, exist_ok=True)
            (self.folder / HEAD).unlink(missing_ok=True)  # killed from here on, nothing is on record
            lists: dict[str, int] = {}
            folders: set[str] = set()
            for part, names in links.items():
                path = self.folder / f"{part}{_LIST}"
                lines = None if suspects is None else self._kept(path, suspects)
                if lines is None:
                    lines = b"".join(line_of(str(root), name) for name in sorted(names()))
                    _replace(path, lines)
                lists[path.name] = len(lines)
                found = {line.split(b" ", 2)[2].rpartition(b"/")[0] for line in lines.splitlines()}
                folders |= {os.fsdecode(name) for name in found}
            for path in self.folder.glob(f"*{_LIST}"):
                if path.name not in lists:
                    path.unlink(missing_ok=True)
            self._write_head(
                Head(
                    format=FORMAT,
                    root=str(root),
                    files={name: signature(str(root / name)) for name in files},
                    digests=dict(files),
                    folders={name: folder_signature(str(root / name)) for name in sorted(folders)},
                    lists=lists,
                )
            )

    def distrust(self, since_s: float, *, links: bool) -> None:
        """Have the next look read what was put together, and links that were written lately.

        Args:
            since_s: what counts as lately, in Unix seconds.
            links: hard links as well, since files of the store were damaged; else copies only.
        """
        try:
            head = load_head(str(self.folder))
            for name in head["lists"]:
                path = self.folder / name
                lines = [
                    _distrusted(head["root"], line, since_s, links)
                    for line in path.read_bytes().splitlines(keepends=True)
                ]
                _replace(path, b"".join(lines))
                head["lists"][name] = sum(map(len, lines))
        except (Doubt, OSError, ValueError):
            with suppress(OSError):
                (self.folder / HEAD).unlink(missing_ok=True)
            return
        self._write_head(
            Head(
                **(
                    head
                    | {
                        "files": {key: [] for key in head["files"]},
                        "folders": {key: [] for key in head["folders"]},
                    }
                )
            )
        )

    @staticmethod
    def _kept(path: Path, suspects: frozenset[str]) -> bytes | None:
        """Return a list that holds still; None if there is none, or a link in it was looked at anew."""
        try:
            lines = path.read_bytes()
        except OSError:
            return None
        has_suspect = suspects and any(
            os.fsdecode(line).split(" ", 2)[2] in suspects for line in lines.splitlines()
        )
        return None if has_suspect else lines

    def _write_head(self, head: Head) -> None:
        with suppress(OSError):
            _replace(self.folder / HEAD, json.dumps(head).encode())


def _distrusted(root: str, line: bytes, since_s: float, hard_links: bool) -> bytes:
    """Return the entry of a link, or one that never holds if it is to be looked at."""
    _, _, name = line.rstrip(b"\n").split(b" ", 2)
    try:
        stat = os.stat(os.fsencode(root) + b"/" + name)  # noqa: PTH116  (twice as fast, for thousands)
    except OSError:
        return line
    is_doubtful = stat.st_mtime >= since_s and (hard_links or stat.st_nlink == 1)
    return b"-1 -1 %s\n" % name if is_doubtful else line


def _replace(path: Path, content: bytes) -> None:
    temporary = path.with_name(f".{path.name}.{uuid4().hex}")
    temporary.write_bytes(content)
    temporary.replace(path)
