"""Whether the files of a dataset are as they were published.

On record are size, times and inode of every file that was put together (tables, splits, lock, pages), and size and
time of every file that was linked. Those that were put together are all looked at. Links may be millions (a stat
costs 2 µs): one that is replaced or removed shows in the time of its folder, so that, where no folder changed, as many
are looked at as cost nothing, others each time. Files of others beside ours do not count.

Of a link only size and time of writing hold: its inode is that of the store, whose time of change moves whenever
the file gets or loses another name.
"""

import json
import os
import random
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TypedDict

from bagassets.freshness.cache import Cache, Changes
from bagassets.freshness.marks import Doubt, Signature, signature

__all__ = ["Publication"]

_HEAD, _LINKS = "published", "links"
# Lists of links are kept in pieces of about this size: some six hundred of them, which are looked at in a millisecond.
_PIECE_BYTES = 1 << 16
# So much is written at once.
_BATCH_BYTES = 1 << 20
# The signature of nothing, not even of a file that is not there: that one is to be looked at.
_NEVER = [-1]


class _Head(TypedDict):
    """What is on record of one dataset, but for its links.

    Attributes:
        root: folder that names are relative to.
        files: name -> signature of a file that was put together.
        digests: name -> digest of its content.
        folders: name -> time of writing (ns) and inode of a folder with links.
        lists: part of a recording -> bytes of each piece of the list of its links.
    """

    root: str
    files: dict[str, Signature]
    digests: dict[str, str]
    folders: dict[str, list[int]]
    lists: dict[str, list[int]]


class Publication:
    """What is on record of one dataset.

    Args:
        state: the state folder.
        asset: the dataset.
    """

    def __init__(self, state: str | os.PathLike[str], asset: str) -> None:
        self._cache = Cache(state)
        self._asset = asset

    def check(self) -> None:
        """Check that the dataset is as it was published.

        Raises:
            Doubt: it is not, or nothing is on record.
        """
        head = self._head()
        root = head["root"]
        for name, written in head["files"].items():
            if signature(f"{root}/{name}") != written:
                raise Doubt(f"{root}/{name} changed")
        for name, written in head["folders"].items():
            if _folder_signature(f"{root}/{name}") != written:
                raise Doubt(f"{root}/{name} changed")
        for name in self._differing_links(head, _PIECE_BYTES):
            raise Doubt(f"{root}/{name} changed")

    def differing(self, root: str | os.PathLike[str]) -> frozenset[str] | None:
        """Return the files below `root` that are not as they were published; None if nothing is on record of them.

        All links are looked at if a folder of theirs changed.
        """
        try:
            head = self._head()
            return self._differing(head) if head["root"] == os.fspath(root) else None
        except Doubt:
            return None

    def is_as_published(self, root: str | os.PathLike[str], digest_of: Callable[[str], str]) -> bool:
        """Tell whether the dataset is as it was published.

        What was put together and has other times is read: if its bytes are the same, that is noted. So are other
        times of folders whose links are all there.

        Args:
            root: its folder.
            digest_of: returns the digest of a file; may raise OSError.
        """
        root = os.fspath(root)
        try:
            head = self._head()
            # Before anything is looked at: what comes or goes meanwhile shows next time.
            folders = {name: _folder_signature(f"{root}/{name}") for name in head["folders"]}
            found = self._differing(head)
            files = head["files"] | {name: signature(f"{root}/{name}") or _NEVER for name in found}
            digests = head["digests"]
            if head["root"] != root or any(
                name not in digests or digest_of(f"{root}/{name}") != digests[name] for name in found
            ):
                return False
        except (Doubt, OSError):
            return False
        if found or folders != head["folders"]:
            self._put_head({**head, "files": files, "folders": folders})
        return True

    def write(
        self,
        root: str | os.PathLike[str],
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
        root = os.fspath(root)
        changes = Changes()
        try:
            before = self._head()["lists"]
        except Doubt:
            before = {}
            changes.drop_below(_LINKS, self._asset)
        # Killed from here on, nothing is on record.
        changes.drop(_HEAD, self._asset)
        if not self._cache.write(changes):
            return
        changes = Changes()
        lists: dict[str, list[int]] = {}
        folders: set[bytes] = set()
        try:
            for part, names in links.items():
                lines = None if suspects is None else self._kept(part, before.get(part), suspects)
                if lines is None:
                    lines = [_line_of(root, name) for name in sorted(names())]
                    lists[part] = self._put_list(changes, part, lines)
                    self._drop_pieces(
                        changes, part, before.get(part, ())[len(lists[part]) :], len(lists[part])
                    )
                else:
                    lists[part] = before[part]
                folders.update(line.split(b" ", 2)[2].rpartition(b"/")[0] for line in lines)
                if changes.size > _BATCH_BYTES:
                    self._cache.write(changes)
                    changes = Changes()
        except OSError:  # somebody takes files away
            return
        for part in before.keys() - lists.keys():
            self._drop_pieces(changes, part, before[part])
        self._put_head(
            _Head(
                root=root,
                files={name: signature(f"{root}/{name}") or _NEVER for name in files},
                digests=dict(files),
                folders={
                    name: _folder_signature(f"{root}/{name}") or _NEVER
                    for name in sorted(map(os.fsdecode, folders))
                },
                lists=lists,
            ),
            changes,
        )

    def distrust(self, since_s: float, *, links: bool) -> None:
        """Have the next look read what was put together, and links that were written lately.

        Args:
            since_s: what counts as lately, in Unix seconds.
            links: hard links as well, since files of the store were damaged; else copies only.
        """
        changes = Changes()
        try:
            head = self._head()
            root = os.fsencode(head["root"])
            for part, sizes in head["lists"].items():
                lines = self._lines(part, sizes)
                doubted = [_distrusted(root, line, since_s, links) for line in lines]
                if doubted != lines:
                    head["lists"][part] = self._put_list(changes, part, doubted)
                    self._drop_pieces(
                        changes, part, sizes[len(head["lists"][part]) :], len(head["lists"][part])
                    )
        except Doubt:
            changes = Changes()
            changes.drop(_HEAD, self._asset)
            self._cache.write(changes)
            return
        files = dict.fromkeys(head["files"], _NEVER)
        folders = dict.fromkeys(head["folders"], _NEVER)
        self._put_head({**head, "files": files, "folders": folders}, changes)

    # --- what is on record ---------------------------------------------------------------

    def _head(self) -> _Head:
        """Return what is on record.

        Raises:
            Doubt: nothing is.
        """
        (content,) = self._cache.get(_HEAD, self._asset)
        head: _Head = json.loads(content)
        return head

    def _put_head(self, head: _Head, changes: Changes | None = None) -> None:
        changes = changes or Changes()
        changes.put(_HEAD, self._asset, json.dumps(head).encode())
        self._cache.write(changes)

    def _piece(self, part: str, number: int) -> str:
        return f"{self._asset}/{part}/{number}"

    def _put_list(self, changes: Changes, part: str, lines: list[bytes]) -> list[int]:
        """Have a list written, and return the bytes of its pieces."""
        sizes: list[int] = []
        for piece in _pieces(lines):
            changes.put(_LINKS, self._piece(part, len(sizes)), piece)
            sizes.append(len(piece))
        return sizes

    def _drop_pieces(self, changes: Changes, part: str, sizes: Iterable[int], start: int = 0) -> None:
        for number, _ in enumerate(sizes, start):
            changes.drop(_LINKS, self._piece(part, number))

    def _lines(self, part: str, sizes: list[int]) -> list[bytes]:
        """Return a list.

        Raises:
            Doubt: it is not there, or damaged.
        """
        pieces = self._cache.get(_LINKS, *(self._piece(part, number) for number in range(len(sizes))))
        return [line for piece in pieces for line in piece.splitlines(keepends=True)]

    def _kept(self, part: str, sizes: list[int] | None, suspects: frozenset[str]) -> list[bytes] | None:
        """Return a list that holds still; None if there is none, or a link in it was looked at anew."""
        if sizes is None:
            return None
        try:
            lines = self._lines(part, sizes)
        except Doubt:
            return None
        has_suspect = suspects and any(_name_in(line) in suspects for line in lines)
        return None if has_suspect else lines

    # --- looking -------------------------------------------------------------------------

    def _differing(self, head: _Head) -> frozenset[str]:
        root = head["root"]
        found = {name for name, written in head["files"].items() if signature(f"{root}/{name}") != written}
        is_same = all(
            _folder_signature(f"{root}/{name}") == written for name, written in head["folders"].items()
        )
        found.update(self._differing_links(head, _PIECE_BYTES * 16 if is_same else None))
        return frozenset(found)

    def _differing_links(self, head: _Head, most_bytes: int | None) -> set[str]:
        """Return links that differ among so many bytes of the lists, taken at random, or among all."""
        pieces = [
            (self._piece(part, number), size)
            for part, sizes in head["lists"].items()
            for number, size in enumerate(sizes)
        ]
        random.shuffle(pieces)
        chosen, left = [], sum(size for _, size in pieces) if most_bytes is None else most_bytes
        for piece, size in pieces:
            if left <= 0:
                break
            chosen.append(piece)
            left -= size
        found: set[str] = set()
        root, look = os.fsencode(head["root"]) + b"/", os.stat
        for links in self._cache.get(_LINKS, *chosen):
            for line in links.splitlines():
                number, time_ns, link = line.split(b" ", 2)
                try:
                    stat = look(root + link)
                except OSError:
                    found.add(os.fsdecode(link))
                    continue
                if stat.st_mtime_ns != int(time_ns) or stat.st_size != int(number):
                    found.add(os.fsdecode(link))
        return found


def _folder_signature(path: str) -> list[int]:
    """Return what tells whether entries of a folder came or went; empty if it is not there."""
    found = signature(path)
    return found[1:3]


def _line_of(root: str, name: str) -> bytes:
    """Return the entry of a link in a list: size, time of writing (ns), name."""
    stat = os.stat(f"{root}/{name}")
    return b"%d %d %s\n" % (stat.st_size, stat.st_mtime_ns, os.fsencode(name))


def _name_in(line: bytes) -> str:
    return os.fsdecode(line.rstrip(b"\n").split(b" ", 2)[2])


def _pieces(lines: list[bytes]) -> Iterator[bytes]:
    """Yield lines joined to pieces of `_PIECE_BYTES`, the last one shorter."""
    start = size = 0
    for number, line in enumerate(lines):
        size += len(line)
        if size >= _PIECE_BYTES:
            yield b"".join(lines[start : number + 1])
            start, size = number + 1, 0
    if start < len(lines):
        yield b"".join(lines[start:])


def _distrusted(root: bytes, line: bytes, since_s: float, hard_links: bool) -> bytes:
    """Return the entry of a link, or one that never holds if it is to be looked at."""
    _, _, name = line.rstrip(b"\n").split(b" ", 2)
    try:
        stat = os.stat(root + b"/" + name)
    except OSError:
        return line
    is_doubtful = stat.st_mtime >= since_s and (hard_links or stat.st_nlink == 1)
    return b"-1 -1 %s\n" % name if is_doubtful else line
