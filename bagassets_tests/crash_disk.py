"""A disk that forgets: changes of files are recorded, and some of them laid out again, as a crash would leave them.

A journalling file system keeps the order of most changes to folders, but the bytes of a file that was not synced may be lost
although its name is not: the file is then empty, full of zeros, or torn. Others lose single changes of folders, too. (Pillai
et al., "All file systems are not created equal", OSDI 2014, call this the abstract persistence model.)

Databases are written by SQLite, not by us: they are taken as they were at that moment, or without Dagster's last commit, which
a loss of power may take although files that were written later are there.
"""

import contextlib
import copy
import errno
import hashlib
import io
import os
import shutil
import struct
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from bagassets.base import files, fingerprints

_DATABASE = (".db", ".db-wal", ".db-journal", ".sqlite", ".sqlite-wal", ".sqlite-journal")


@dataclass(eq=False)
class Node:
    """A file (`data`) or a folder (`entries`); two entries with one node are hard links."""

    data: bytes | None = None
    entries: dict[str, "Node"] = field(default_factory=dict)
    mode: int = 0o644
    mtime_ns: int = 0
    inode: int = 0
    ctime_ns: int = 0
    is_new: bool = False

    def note(self, stat):
        self.mtime_ns, self.inode, self.ctime_ns = stat
        return self


@dataclass(frozen=True)
class Change:
    """One change: what it does, to which paths (relative), with which bytes; then path -> times and inode afterwards."""

    kind: str
    paths: tuple[str, ...]
    data: bytes = b""
    mode: int = 0o644
    stats: dict[str, tuple[int, int, int]] = field(default_factory=dict)


@dataclass
class Recording:
    """The changes of a command, and what the databases were like before each of them, and at the end."""

    base: Node
    changes: list[Change] = field(default_factory=list)
    databases: list[dict[str, bytes]] = field(default_factory=list)


def stat_of(path):
    stat = os.stat(path)
    return stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns


def take(root, names):
    """The tree of some folders below a root."""
    seen = {}

    def node_of(path):
        stat = path.stat()
        if path.is_dir():
            node = Node(None, mode=stat.st_mode & 0o777)
            node.entries = {one.name: node_of(one) for one in path.iterdir() if one.is_dir() or one.is_file()}
        elif stat.st_ino in seen:
            return seen[stat.st_ino]
        else:
            node = seen[stat.st_ino] = Node(path.read_bytes(), mode=stat.st_mode & 0o777)
        return node.note((stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns))

    return Node(entries={name: node_of(root / name) for name in names if (root / name).exists()})


def find(tree, path):
    for name in Path(path).parts:
        tree = tree.entries[name]
    return tree


def _apply(tree, change):
    """Apply a change; one that rests on a change that was lost is lost with it (KeyError)."""
    first, last = change.paths[0], change.paths[-1]
    folder, name = find(tree, os.path.dirname(last)), os.path.basename(last)
    match change.kind:
        case "folder":
            folder.entries.setdefault(name, Node(mode=0o755))
        case "write":
            old = folder.entries.get(name)
            if old is None:
                folder.entries[name] = Node(change.data, mode=change.mode, is_new=True)
            else:
                old.data, old.is_new = change.data, True
        case "link":
            folder.entries[name] = find(tree, first)
        case "move":
            source = find(tree, os.path.dirname(first))
            folder.entries[name] = source.entries.pop(os.path.basename(first))
        case "exchange":
            source, own = find(tree, os.path.dirname(first)), os.path.basename(first)
            source.entries[own], folder.entries[name] = folder.entries[name], source.entries[own]
        case "remove":
            del folder.entries[name]
        case "mark" | "sync":
            find(tree, last)
    for path, stat in change.stats.items():
        find(tree, path).note(stat)


def _files(node):
    yield from {id(one): one for one in _all(node) if one.data is not None}.values()


def _all(node):
    yield node
    for one in node.entries.values():
        yield from _all(one)


def torn(data, how):
    """What may be left of the bytes of a file that were not synced."""
    return {"empty": b"", "zeros": bytes(len(data)), "half": data[: len(data) // 2], "whole": data}[how]


def crashed(recording, number, *, how="whole", lost=(), dice=None, without=""):
    """The tree after a crash before change `number`.

    Args:
        recording: what the command did.
        number: how many changes came before the crash.
        how: what is left of new files: `whole`, `empty`, `zeros`, `half`, or `any`, by dice.
        lost: numbers of changes that are lost, with all that rests on them.
        dice: for `any`.
        without: `Dagster`: without the last commit to its databases; `all`: they and the caches are as before the last that
            was written to any of them.
    """
    tree = copy.deepcopy(recording.base)
    lost = _not_synced(recording.changes[:number], lost)
    for index, change in enumerate(recording.changes[:number]):
        if index not in lost:
            try:
                _apply(tree, change)
            except KeyError:
                if not lost:
                    raise
    for node in _files(tree):
        if node.is_new:
            node.data = torn(
                node.data, dice.choice(["empty", "zeros", "half", "whole"]) if how == "any" else how
            )
    _forget_databases(tree)
    for path, data in databases_at(recording, number, without).items():
        folder = tree
        for name in Path(path).parent.parts:
            folder = folder.entries.setdefault(name, Node(mode=0o755))
        # Who looks at its times finds them changed, as it was written to.
        folder.entries[Path(path).name] = Node(data)
    return tree


def state_of(tree):
    """A digest of all that a build finds in a tree: names, links, bytes, modes, times and inodes."""
    seen = {}

    def told(node, path):
        stat = node.mode, node.mtime_ns, node.inode, node.ctime_ns
        if node.data is None:
            return (
                "folder",
                stat,
                [(name, told(node.entries[name], f"{path}/{name}")) for name in sorted(node.entries)],
            )
        return (
            ("link", seen[id(node)])
            if id(node) in seen
            else ("file", stat, _sha256(node.data), seen.setdefault(id(node), path))
        )

    return hashlib.sha256(repr(told(tree, "")).encode()).hexdigest()


@lru_cache(maxsize=256)
def _sha256(data):
    return hashlib.sha256(data).hexdigest()


def databases_at(recording, number, without=""):
    """Path -> bytes of the databases before change `number`, as `crashed` has them."""
    now, before = recording.databases[number], reversed(recording.databases[:number])
    if without == "all":
        return next((one for one in before if one != now), now)
    if without != "Dagster":
        return now
    return {
        path: without_last_commit(data) if path.endswith(".db-wal") else data for path, data in now.items()
    }


def without_last_commit(log):
    """A write-ahead log of SQLite without the last commit in it (https://sqlite.org/fileformat2.html#walformat)."""
    page_bytes, salts = struct.unpack_from(">8xI4x8s", log) if len(log) >= 32 else (0, b"")
    ends, at = [32], 32
    while len(log) - at >= 24 + page_bytes > 24:
        pages, salts_of_frame = struct.unpack_from(">4xI8s", log, at)
        if salts_of_frame != salts:
            break  # of a log that was begun anew, the rest is older
        at += 24 + page_bytes
        if pages:
            ends.append(at)
    return log[: ends[-2]] if len(ends) > 1 else log


def _not_synced(changes, lost):
    """Those of lost changes whose folders were not synced later."""
    synced = {change.paths[0]: index for index, change in enumerate(changes) if change.kind == "sync"}
    return {index for index in lost if index > synced.get(os.path.dirname(changes[index].paths[-1]), -1)}


def _forget_databases(folder):
    for name, node in list(folder.entries.items()):
        if name.endswith(_DATABASE):
            del folder.entries[name]
        _forget_databases(node)


def lay_out(tree, root):
    """Write a tree below a root; files seem to have the inodes and times that they had, unless they change again."""
    known = {}
    written = {}

    def write(node, path):
        if node.data is None:
            os.makedirs(path, exist_ok=True)
            for name, one in node.entries.items():
                write(one, f"{path}/{name}")
            if node.mtime_ns:
                os.utime(path, ns=(node.mtime_ns, node.mtime_ns))
        elif id(node) in written:
            os.link(written[id(node)], path)
        else:
            with open(os.open(path, os.O_WRONLY | os.O_CREAT, 0o600), "wb", buffering=0) as file:
                file.write(node.data)
            os.chmod(path, node.mode)
            if node.mtime_ns:
                os.utime(path, ns=(node.mtime_ns, node.mtime_ns))
            written[id(node)] = path

    def remember(node, path):
        if node.inode:
            stat = os.stat(path)
            known[stat.st_ino] = (stat.st_ctime_ns, stat.st_mtime_ns, node)
        for name, one in node.entries.items():
            remember(one, f"{path}/{name}")

    for name, node in tree.entries.items():
        shutil.rmtree(root / name, ignore_errors=True)
        write(node, f"{root}/{name}")
    for name, node in tree.entries.items():
        remember(node, f"{root}/{name}")

    def signature_of(stat):
        ctime_ns, mtime_ns, node = known.get(stat.st_ino, (0, 0, None))
        if node is None or (stat.st_ctime_ns, stat.st_mtime_ns) != (ctime_ns, mtime_ns):
            return [stat.st_size, stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns]
        return [stat.st_size, stat.st_mtime_ns, node.inode, node.ctime_ns]

    fingerprints.signature_of = signature_of


def databases(root, state):
    """Path -> bytes of the databases in the state folder."""
    found = {}
    for folder, folders, names in os.walk(root / state):
        folders[:] = [one for one in folders if one not in ("store", "compute_logs", "locks", "unsettled")]
        for name in names:
            if name.endswith(_DATABASE):
                path = Path(folder, name)
                found[path.relative_to(root).as_posix()] = path.read_bytes()
    return found


def _paths_below(folder):
    return [f"{one}/{name}" for one, _, names in os.walk(folder) for name in names]


class Disk:
    """Stands in for the `os` of `bagassets.base.files`: records changes, lets one fail, or ends the process before one.

    Attributes:
        count: number of changes so far.
        links: `hard`, `reflinks` or `copies`: what files of a dataset may be.
    """

    def __init__(self, root, *, recording=None, fails_at=None, error=errno.EIO, dies_at=None, links="hard"):
        self.root, self.recording, self.links = str(root), recording, links
        self.fails_at, self.error, self.dies_at = fails_at, error, dies_at
        self.count = 0
        self._open = {}
        self._known = {}
        self.failed = ""

    def __getattr__(self, name):
        return getattr(os, name)

    def install(self):
        files.os = files.shutil = self
        files.open = self.open_writer
        self._rename, files._rename = files._rename, self.exchange
        if self.links == "reflinks":
            files.ioctl = self.clone
        if self.recording is not None:
            self._ours = {os.stat(path).st_ino for path in _paths_below(self.root)}
        return self

    def _change(self, kind, paths, do, data=b"", mode=0o644):
        texts = [os.fspath(path) for path in paths]
        if not texts[-1].startswith(self.root):
            return do()
        names = tuple(os.path.relpath(text, self.root) for text in texts)
        if self.recording is not None and kind in ("move", "exchange") and os.path.isdir(texts[0]):
            self._take_in(texts[0])
        if self.recording is not None and kind != "write more":
            # Few changes are also ones of databases, which are large.
            now = databases(Path(self.root), ".bagassets")
            self.recording.databases.append(
                {path: self._known.setdefault(data, data) for path, data in now.items()}
            )
        self.count += 1
        if self.count == self.dies_at:
            os._exit(9)
        if self.count == self.fails_at:
            self.failed = f"{kind} {' '.join(names)}"
            raise OSError(self.error, os.strerror(self.error), *[texts[-1]] * (kind != "write more"))
        done = do()
        if self.recording is not None and kind != "write more":
            stats = {}
            for name in {*names, *map(os.path.dirname, names)} - {""}:
                with contextlib.suppress(FileNotFoundError):
                    stats[name] = stat_of(f"{self.root}/{name}")
                    self._ours.add(stats[name][1])
            self.recording.changes.append(Change(kind, names, data, mode, stats))
        return done

    def _take_in(self, folder):
        """Record the files in a folder that others wrote, such as PyAV, before it gets its name."""
        for path in sorted(_paths_below(folder)):
            stat = os.stat(path)
            if stat.st_ino not in self._ours and not path.endswith(_DATABASE):
                self._change("write", [path], lambda: None, Path(path).read_bytes(), stat.st_mode & 0o777)

    # --- single changes ---

    def makedirs(self, path, exist_ok=False):
        parent = os.path.dirname(path)
        if parent and not os.path.isdir(parent):
            self.makedirs(parent, exist_ok=True)
        if exist_ok and os.path.isdir(path):
            return
        self._change("folder", [path], lambda: os.mkdir(path))

    def rename(self, one, other):
        self._change("move", [one, other], lambda: os.rename(one, other))

    def exchange(self, one, other, flag):
        self._change(
            "exchange" if flag == 2 else "move", [one, other], lambda: self._rename(one, other, flag)
        )
        return True

    def link(self, one, other):
        if self.links != "hard" and "/store/" not in str(other):
            raise OSError(errno.EXDEV, os.strerror(errno.EXDEV), str(other))
        self._change("link", [one, other], lambda: os.link(one, other))

    def clone(self, target, request, source):
        """Stands in for the `ioctl` that makes a reflink, of which a crash may leave anything, as of a copy."""
        paths = [os.readlink(f"/proc/self/fd/{one}") for one in (source, target)]
        assert request == files.FICLONE
        self._change("write more", [paths[1]], lambda: shutil.copyfile(*paths))

    def unlink(self, path):
        if self.recording is not None and os.stat(path, follow_symlinks=False).st_nlink == 1:
            self._ours.discard(os.stat(path, follow_symlinks=False).st_ino)
        self._change("remove", [path], lambda: os.unlink(path))

    def rmdir(self, path):
        self._change("remove", [path], lambda: os.rmdir(path))

    def utime(self, path):
        self._change("mark", [path], lambda: os.utime(path))

    def fsync(self, descriptor):
        path = os.readlink(f"/proc/self/fd/{descriptor}")
        self._change("sync", [path], lambda: os.fsync(descriptor))

    def rmtree(self, folder, ignore_errors=True):
        try:
            for entry in sorted(os.scandir(folder), key=lambda one: one.name):
                if entry.is_dir(follow_symlinks=False):
                    self.rmtree(entry.path)
                else:
                    self.unlink(entry.path)
            self.rmdir(folder)
        except OSError:
            if not ignore_errors:
                raise

    # --- writing: the file counts as one change once it is closed, of which any part may be lost ---

    def open(self, path, flags, mode=0o777):
        if not flags & os.O_CREAT or (os.path.exists(path) and not flags & (os.O_TRUNC | os.O_EXCL)):
            return os.open(path, flags, mode)
        if self.fails_at is not None:
            descriptor = self._change("create", [path], lambda: os.open(path, flags, mode))
        else:
            descriptor = os.open(path, flags, mode)
            if not flags & (os.O_TRUNC | os.O_WRONLY):  # a lock file, which stays open
                self._change("write", [path], lambda: None, b"", mode)
                return descriptor
        self._open[descriptor] = (path, mode)
        return descriptor

    def write(self, descriptor, data):
        if self.fails_at is not None and self.count + 1 == self.fails_at:  # a part of it is written
            os.write(descriptor, data[: len(data) // 2])
        return self._change("write more", [self._open[descriptor][0]], lambda: os.write(descriptor, data))

    def close(self, descriptor):
        os.close(descriptor)
        path, mode = self._open.pop(descriptor, (None, 0))
        if path is not None and self.recording is not None:
            self._change("write", [path], lambda: None, Path(path).read_bytes(), mode)

    def copyfile(self, source, target):
        descriptor = self.open(target, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        try:
            self.write(descriptor, Path(source).read_bytes())
        finally:
            self.close(descriptor)

    def open_writer(self, path, mode, buffering):
        return io.BufferedWriter(_Raw(self, path), buffering)


class _Raw(io.RawIOBase):
    """A file that is written bit by bit through a `Disk`."""

    def __init__(self, disk, path):
        self._disk = disk
        self._descriptor = disk.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)

    def writable(self):
        return True

    def fileno(self):
        return self._descriptor

    def write(self, data):
        return self._disk.write(self._descriptor, bytes(data))

    def close(self):
        if not self.closed:
            super().close()
            self._disk.close(self._descriptor)
