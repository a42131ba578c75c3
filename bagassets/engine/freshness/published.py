"""Whether the files of a dataset are as they were published.

On record are size, times and inode of every file that was written for the dataset (tables, splits, lock, pages), and
size and modification time of every file that was linked. The written ones are all checked. There may be millions of
links (a stat costs 2 µs): one that is replaced or removed changes the time of its folder, so as long as no folder has
changed only a random sample is checked, small enough to cost nothing. Other people's files beside ours do not count.

For a link, only size and modification time count: its inode is shared with the store, and the change time moves whenever
the file gains or loses a name.
"""

import json
import os
import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import TYPE_CHECKING, NotRequired, TypedDict

from bagassets.base.cache import Cache, Changes
from bagassets.base.fingerprints import PlanNeeded, Signature, signature

if TYPE_CHECKING:
    from bagassets.base.json_types import Json

_HEAD, _LINKS, _GROUPS = "published", "links", "groups"
# Lists of links are stored in pieces of about this size, some six hundred links, which are checked in a millisecond.
_PIECE_BYTES = 1 << 16
# Of the links so many pieces are looked at where no folder has changed: a build does so five times, each time at others.
_SAMPLED = 4
# Changes are written whenever they exceed this size.
_BATCH_BYTES = 1 << 20
# A signature that matches nothing, not even a missing file: the file has to be checked.
_NEVER = [-1]


class _Head(TypedDict):
    """The record of one dataset, except for its links.

    Attributes:
        root: folder that names are relative to.
        files: name -> signature of a file that was written.
        digests: name -> digest of its content.
        folders: name -> modification time (ns) and inode of a folder with links.
        lists: part of a recording -> bytes of each piece of the list of its links.
        torn_since_s: see `Publication.torn_since_s`.
        left: folders that it had before.
    """

    root: str
    files: dict[str, Signature]
    digests: dict[str, str]
    folders: dict[str, list[int]]
    lists: dict[str, list[int]]
    torn_since_s: NotRequired[float]
    left: NotRequired[list[str]]


class Publication:
    """The record of one dataset's files.

    Attributes:
        state: the state folder.
        asset: the dataset.
    """

    def __init__(self, state: str | os.PathLike[str], asset: str) -> None:
        self.state, self.asset = state, asset
        self._cache = Cache(state)

    @property
    def torn_since_s(self) -> float | None:
        """Since when (Unix seconds) a crash may have torn files that are not on record, until the next `write`; else None."""
        try:
            return self._head().get("torn_since_s")
        except PlanNeeded:
            return None

    def places(self) -> tuple[Sequence[str], Mapping[str, str]]:
        """Return its folder with those that it had before, and name -> digest of each written file; empty if none are on record."""
        try:
            head = self._head()
            return [head["root"], *head.get("left", ())], head["digests"]
        except PlanNeeded:
            return (), {}

    def check(self) -> None:
        """Check that the dataset is as it was published.

        Raises:
            PlanNeeded: it has changed, or nothing is on record.
        """
        head = self._head()
        root = head["root"]
        for name, written in head["files"].items():
            if signature(f"{root}/{name}") != written:
                raise PlanNeeded(f"{root}/{name} changed")
        for name, written in head["folders"].items():
            if _folder_signature(f"{root}/{name}") != written:
                raise PlanNeeded(f"{root}/{name} changed")
        for name in self._changed_links(head, _PIECE_BYTES):
            raise PlanNeeded(f"{root}/{name} changed")

    def changed_files(self, root: str | os.PathLike[str]) -> frozenset[str] | None:
        """Return the files below `root` that are not as they were published; None if none are on record.

        All links are checked if one of their folders changed.
        """
        try:
            head = self._head()
            return self._changed_files(head) if head["root"] == os.fspath(root) else None
        except PlanNeeded:
            return None

    def is_as_published(self, root: str | os.PathLike[str], digest_of: Callable[[str], str]) -> bool:
        """Return whether the dataset is as it was published.

        Written files with other times are read; if their bytes are the same, the new times are recorded. So are new
        times of folders whose links are all there.

        Args:
            root: its folder.
            digest_of: returns the digest of a file; may raise OSError.
        """
        root = os.fspath(root)
        try:
            head = self._head()
            # Before anything is checked: a file added or removed meanwhile then shows next time.
            folders = {name: _folder_signature(f"{root}/{name}") for name in head["folders"]}
            changed = self._changed_files(head)
            files = head["files"] | {name: signature(f"{root}/{name}") or _NEVER for name in changed}
            digests = head["digests"]
            if head["root"] != root or any(
                name not in digests or digest_of(f"{root}/{name}") != digests[name] for name in changed
            ):
                return False
        except (PlanNeeded, OSError):
            return False
        if changed or folders != head["folders"]:
            self._put_head({**head, "files": files, "folders": folders})
        return True

    def groups(self) -> "Json":
        """Return what is on record of groups of recordings, which only holds while no file has changed; None without it."""
        try:
            (content,) = self._cache.get(_GROUPS, self.asset)
        except PlanNeeded:
            return None
        return json.loads(content)

    def write(
        self,
        root: str | os.PathLike[str],
        files: Mapping[str, str],
        links: Mapping[str, Callable[[], Iterable[str]]],
        suspects: frozenset[str] | None,
        gone: AbstractSet[str] | None = None,
        groups: object = None,
    ) -> None:
        """Record a dataset that was just published; if that fails, the next build checks it in full.

        Args:
            root: its folder.
            files: name -> digest of each written file.
            links: name of a recording's part -> function that returns its links, called only if they are not on record.
            suspects: result of an earlier `changed_files`; None has all links checked again.
            gone: parts that may be no more; the others on record stay. None: only those in `links` stay.
            groups: what is to be on record of groups of recordings, as JSON.
        """
        root = os.fspath(root)
        changes = Changes()
        try:
            head = self._head()
        except PlanNeeded:
            if gone is not None:
                return  # of the others nothing is on record any more
            head = _Head(root=root, files={}, digests={}, folders={}, lists={})
            changes.drop_below(_LINKS, self.asset)
        before = head["lists"]
        left = {*head.get("left", ()), head["root"]} - {root}
        # If the process is killed from here on, nothing is on record.
        changes.drop(_HEAD, self.asset)
        if not self._cache.write(changes):
            return
        changes = Changes()
        changes.put(_GROUPS, self.asset, json.dumps(groups).encode())
        lists: dict[str, list[int]] = {}
        folders: set[bytes] = set()
        if gone is not None:
            lists = {part: sizes for part, sizes in before.items() if part not in gone}
            folders = {os.fsencode(name) for name in head["folders"] if os.path.isdir(f"{root}/{name}")}
        try:
            with self._cache.kept_open():
                for part, names in links.items():
                    lines = self._trusted_lines(part, before.get(part), suspects)
                    if lines is None:
                        lines = [_line_of(root, name) for name in sorted(names())]
                        lists[part] = self._put_list(changes, part, lines, before.get(part, ()))
                    else:
                        lists[part] = before[part]
                    folders.update(line.split(b" ", 2)[2].rpartition(b"/")[0] for line in lines)
                    if changes.size > _BATCH_BYTES:
                        self._cache.write(changes)
                        changes = Changes()
        except OSError:  # somebody is removing files
            return
        for part in before.keys() - lists.keys():
            self._put_list(changes, part, [], before[part])
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
                left=sorted(filter(os.path.isdir, left)),
            ),
            changes,
        )

    def distrust(self, since_s: float, *, links: bool) -> None:
        """Have the next check read all written files, and links that were made recently; see also `torn_since_s`.

        Args:
            since_s: links made since this time (Unix seconds) are read.
            links: hard links as well, since files of the store were damaged; else copies only.
        """
        changes = Changes()
        try:
            head = self._head()
            root = os.fsencode(head["root"])
            for part, sizes in head["lists"].items():
                lines = self._lines(part, sizes)
                distrusted = [_distrusted(root, line, since_s, links) for line in lines]
                if distrusted != lines:
                    head["lists"][part] = self._put_list(changes, part, distrusted, sizes)
        except PlanNeeded:
            changes = Changes()
            changes.drop(_HEAD, self.asset)
            self._cache.write(changes)
            return
        files = dict.fromkeys(head["files"], _NEVER)
        folders = dict.fromkeys(head["folders"], _NEVER)
        since_s = min(since_s, head.get("torn_since_s", since_s))
        self._put_head({**head, "files": files, "folders": folders, "torn_since_s": since_s}, changes)

    # --- the record ----------------------------------------------------------------------

    def _head(self) -> _Head:
        """Return the record, without links.

        Raises:
            PlanNeeded: there is none.
        """
        (content,) = self._cache.get(_HEAD, self.asset)
        head: _Head = json.loads(content)
        return head

    def _put_head(self, head: _Head, changes: Changes | None = None) -> None:
        changes = changes or Changes()
        changes.put(_HEAD, self.asset, json.dumps(head).encode())
        self._cache.write(changes)

    def _piece(self, part: str, number: int) -> str:
        return f"{self.asset}/{part}/{number}"

    def _put_list(self, changes: Changes, part: str, lines: list[bytes], before: Sequence[int]) -> list[int]:
        """Write a list in place of one of `before` pieces, and return the size of each piece in bytes."""
        sizes: list[int] = []
        for piece in _pieces(lines):
            changes.put(_LINKS, self._piece(part, len(sizes)), piece)
            sizes.append(len(piece))
        for number in range(len(sizes), len(before)):
            changes.drop(_LINKS, self._piece(part, number))
        return sizes

    def _lines(self, part: str, sizes: list[int]) -> list[bytes]:
        """Return the list of a part.

        Raises:
            PlanNeeded: it is missing or damaged.
        """
        pieces = self._cache.get(_LINKS, *(self._piece(part, number) for number in range(len(sizes))))
        return [line for piece in pieces for line in piece.splitlines(keepends=True)]

    def _trusted_lines(
        self, part: str, sizes: list[int] | None, suspects: frozenset[str] | None
    ) -> list[bytes] | None:
        """Return the list of a part if it is still valid; None if there is none, or it names a suspect, or any may be one."""
        if sizes is None or suspects is None:
            return None
        try:
            lines = self._lines(part, sizes)
        except PlanNeeded:
            return None
        has_suspect = suspects and any(_name_in(line) in suspects for line in lines)
        return None if has_suspect else lines

    # --- checks --------------------------------------------------------------------------

    def _changed_files(self, head: _Head) -> frozenset[str]:
        root = head["root"]
        changed = {name for name, written in head["files"].items() if signature(f"{root}/{name}") != written}
        is_same = all(
            _folder_signature(f"{root}/{name}") == written for name, written in head["folders"].items()
        )
        changed.update(self._changed_links(head, _PIECE_BYTES * _SAMPLED if is_same else None))
        return frozenset(changed)

    def _changed_links(self, head: _Head, most_bytes: int | None) -> set[str]:
        """Return the links that changed, among all or in a random sample of `most_bytes` of the lists."""
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
        changed: set[str] = set()
        root, stat_of = os.fsencode(head["root"]) + b"/", os.stat
        for links in self._cache.get(_LINKS, *chosen):
            for line in links.splitlines():
                size_bytes, time_ns, link = line.split(b" ", 2)
                try:
                    stat = stat_of(root + link)
                except OSError:
                    changed.add(os.fsdecode(link))
                    continue
                if stat.st_mtime_ns != int(time_ns) or stat.st_size != int(size_bytes):
                    changed.add(os.fsdecode(link))
        return changed


def on_record(state: str | os.PathLike[str]) -> AbstractSet[str]:
    """Return the names of all datasets, and of the map, that builds with this state folder have published."""
    return Cache(state).keys(_HEAD)


def _folder_signature(path: str) -> list[int]:
    """Return what changes when entries of a folder are added or removed; empty if it does not exist."""
    return signature(path)[1:3]


def _line_of(root: str, name: str) -> bytes:
    """Return the line of a link in a list: size, modification time (ns), name."""
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
    """Return the line of a link, or one that never matches if the link has to be checked."""
    _, _, name = line.rstrip(b"\n").split(b" ", 2)
    try:
        stat = os.stat(root + b"/" + name)
    except OSError:
        return line
    is_recent = stat.st_mtime >= since_s and (hard_links or stat.st_nlink == 1)
    return b"-1 -1 %s\n" % name if is_recent else line
