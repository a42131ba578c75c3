"""Whether the files of a dataset are as they were published.

A record in the state folder has size, times and inode of every file that was put together (tables, splits, lock,
pages), and size and time of every file that was linked. Those that were put together are all looked at. Links may
be millions (a stat costs 2 µs): one that is replaced or removed shows in the time of its folder, so that, where no
folder changed, as many are looked at as cost nothing, others each time. Files of others beside ours do not count.

Of a link only size and time of writing hold: its inode is that of the store, whose time of change moves whenever
the file gets or loses another name.
"""

import json
import os
import random
from typing import TypedDict

from bagassets.quick.looks import Doubt, signature

__all__ = ["HEAD", "Head", "check", "differing", "folder_signature", "line_of", "load_head"]

HEAD = "published.json"
FORMAT = 1
# Of longer lists of links a piece of this size is read: some six hundred of them, which takes a millisecond.
_PIECE_BYTES = 1 << 16


class Head(TypedDict):
    """What is recorded of one dataset; the lists of its links are files beside it.

    Attributes:
        format: of the record.
        root: folder that names are relative to.
        files: name -> size, time of writing (ns), inode, time of change (ns) of a file that was put together.
        digests: name -> digest of its content.
        folders: name -> time of writing (ns) and inode of a folder with links.
        lists: recording's list of links -> its bytes.
    """

    format: int
    root: str
    files: dict[str, list[int]]
    digests: dict[str, str]
    folders: dict[str, list[int]]
    lists: dict[str, int]


def load_head(folder: str) -> Head:
    """Return the record in a folder.

    Raises:
        Doubt: there is none, or it is not readable.
    """
    path = f"{folder}/{HEAD}"
    try:
        with open(path, "rb") as stream:  # noqa: PTH123  (no pathlib here: its import costs 5 ms)
            head: Head = json.loads(stream.read())
        if head["format"] != FORMAT:
            raise Doubt(f"{path}: written by another version")
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise Doubt(f"{path}: {err}") from err
    return head


def check(folder: str) -> None:
    """Check that a dataset is as it was published.

    Raises:
        Doubt: it is not, or nothing is recorded.
    """
    head = load_head(folder)
    root = head["root"]
    for name, written in head["files"].items():
        if signature(f"{root}/{name}") != written:
            raise Doubt(f"{root}/{name} changed")
    for name, written in head["folders"].items():
        if folder_signature(f"{root}/{name}") != written:
            raise Doubt(f"{root}/{name} changed")
    for name in _links(folder, head, _PIECE_BYTES):
        raise Doubt(f"{root}/{name} changed")


def differing(folder: str) -> set[str]:
    """Return the files that are not as they were published; all links are looked at if a folder of theirs changed.

    Raises:
        Doubt: nothing is recorded.
    """
    head = load_head(folder)
    root = head["root"]
    found = {name for name, written in head["files"].items() if signature(f"{root}/{name}") != written}
    is_same = all(folder_signature(f"{root}/{name}") == written for name, written in head["folders"].items())
    found.update(_links(folder, head, _PIECE_BYTES * 16 if is_same else None))
    return found


def folder_signature(path: str) -> list[int]:
    """Return what tells whether entries of a folder came or went; empty if it is not there."""
    try:
        stat = os.stat(path)  # noqa: PTH116
    except OSError:
        return []
    return [stat.st_mtime_ns, stat.st_ino]


def line_of(root: str, name: str) -> bytes:
    """Return the entry of a link in a list: size, time of writing (ns), name."""
    stat = os.stat(f"{root}/{name}")  # noqa: PTH116
    return b"%d %d %s\n" % (stat.st_size, stat.st_mtime_ns, os.fsencode(name))


def _links(folder: str, head: Head, most_bytes: int | None) -> set[str]:
    """Return links that differ among so many bytes of the lists, taken at random, or among all."""
    lists = list(head["lists"].items())
    left = sum(size for _, size in lists) if most_bytes is None else most_bytes
    random.shuffle(lists)
    found: set[str] = set()
    root = head["root"]
    for name, size in lists:
        if left <= 0:
            break
        for line in _lines(f"{folder}/{name}", size, left):
            try:
                _, _, link = line.split(b" ", 2)
                if line_of(root, os.fsdecode(link)) != line + b"\n":
                    found.add(os.fsdecode(link))
            except OSError:
                found.add(os.fsdecode(link))
            except ValueError as err:
                raise Doubt(f"{folder}/{name}: damaged") from err
        left -= size
    return found


def _lines(path: str, size: int, most: int) -> list[bytes]:
    """Return the lines of a list, or those in a piece of it."""
    try:
        with open(path, "rb") as stream:  # noqa: PTH123
            if os.fstat(stream.fileno()).st_size != size:
                raise Doubt(f"{path}: damaged")
            if size <= most:
                return stream.read().splitlines()
            # No secret is at stake: any piece will do, as long as it is another each time.
            stream.seek(random.randrange(size - most))  # noqa: S311
            return stream.read(most).split(b"\n")[1:-1]
    except OSError as err:
        raise Doubt(f"{path}: {err}") from err
