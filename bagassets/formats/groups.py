"""Groups of recordings: where no recording changed, the rows of a dataset are copied from the one on disk.

A group is a run of recordings in the order of their keys. Whether a key begins one, its digest decides, so a recording that
comes or goes changes its own group, or that before it, and no other. On record are, for each group, what it was made from,
how many bytes each joined file has of it, and what the format has to know of it for files that exist once. A file is hashed
before it is copied from: if it is not the one on record, everything is joined again from the store.
"""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO, NamedTuple

from blake3 import blake3

from bagassets.base.cache import Cache, Changes
from bagassets.base.files import writer
from bagassets.base.fingerprints import PlanNeeded, loaded_code_fingerprint
from bagassets.base.json_types import Json, JsonObject
from bagassets.formats.format import Part
from bagassets.formats.json_files import SEPARATOR, Frame

# On average, a power of 2: half as many cost half as much where one changed, and twice as much to list and to copy.
RECORDINGS = 64
_BLOCK_BYTES = 1 << 20
_KIND = "found"


class TornError(Exception):
    """A joined file on disk is not the one on record."""


@dataclass(frozen=True)
class Group:
    """Some recordings of a dataset.

    Attributes:
        parts: the recordings.
        first: position of the first one among all.
        digest: of the recordings, their parts and their splits.
    """

    parts: Sequence[Part]
    first: int
    digest: str


class Rows(NamedTuple):
    """What a joined file has of one group, or of all."""

    size: int
    number: int


@dataclass(frozen=True)
class GroupRecord:
    """What is on record of a group.

    Attributes:
        rows: joined file -> what it has of the group.
        facts: what the format has to know of its recordings.
        durations_s: of each recording, which count for the shares of the splits.
    """

    rows: Mapping[str, Rows]
    facts: JsonObject
    durations_s: Sequence[float]


@dataclass(frozen=True)
class GroupsRecord:
    """What is on record of the joined files of a dataset.

    Attributes:
        made_by: digest of the code, the format and its settings.
        files: joined file -> digest, and size of what stands before its rows.
        groups: digest of a group -> its record, in order.
    """

    made_by: str
    files: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    groups: Mapping[str, GroupRecord] = field(default_factory=dict)

    def as_json(self) -> JsonObject:
        """Return it as JSON."""
        groups = {digest: [one.rows, one.facts, one.durations_s] for digest, one in self.groups.items()}
        return {"made_by": self.made_by, "files": self.files, "groups": groups}

    @classmethod
    def from_json(cls, value: Json) -> "GroupsRecord | None":
        """Inverse of `as_json`; None if it was none, or of another version."""
        try:
            groups = {
                digest: GroupRecord({name: Rows(*one) for name, one in rows.items()}, facts, durations_s)
                for digest, (rows, facts, durations_s) in value["groups"].items()
            }
            return cls(value["made_by"], value["files"], groups)
        except (AttributeError, KeyError, TypeError, ValueError):
            return None

    def starts(self, name: str) -> Iterator[tuple[str, int, Rows]]:
        """Yield each group with rows in a joined file, where these begin in it, and what they are."""
        start = self.files[name][1]
        for digest, group in self.groups.items():
            rows = group.rows[name]
            if rows.size:
                yield digest, start, rows
                start += rows.size + len(SEPARATOR)


def cut(parts: Sequence[Part], splits: Mapping[str, str]) -> list[Group]:
    """Return the groups of recordings, which come in the order of their keys.

    Args:
        parts: the recordings.
        splits: recording -> split.
    """
    begins = (number for number, part in enumerate(parts) if number and _begins_group(part.key))
    groups = []
    for first, end in pairwise([0, *begins, len(parts)]):
        some = parts[first:end]
        lines = [f"{part.key}\0{part.content}\0{part.artifact}\0{splits[part.key]}" for part in some]
        if some:
            groups.append(Group(some, first, blake3("\n".join(lines).encode()).hexdigest()))
    return groups


def _begins_group(key: str) -> bool:
    return blake3(key.encode()).digest(length=2)[0] % RECORDINGS == 0


class FoundInGroups:
    """What this code has found in groups of recordings; any of it may be lost, and is found again.

    Args:
        state: the state folder.
        what: what is looked for.
    """

    def __init__(self, state: str | os.PathLike[str], what: str) -> None:
        self._cache = Cache(state)
        self._what, self._below = what, f"{what}/{loaded_code_fingerprint()}/"
        self._before: dict[str, bytes] = {}

    def load(self) -> Mapping[str, bytes]:
        """Return digest of a group -> what was found."""
        with suppress(PlanNeeded):
            found = self._cache.all(_KIND)
            self._before = {
                key.removeprefix(self._below): of for key, of in found.items() if key.startswith(self._below)
            }
        return self._before

    def save(self, found: Mapping[str, bytes]) -> None:
        """Replace what was loaded."""
        changes = Changes()
        if not self._before:  # of other code
            changes.drop_below(_KIND, self._what)
        for group in self._before.keys() - found.keys():
            changes.drop(_KIND, self._below + group)
        for group, of in found.items():
            if self._before.get(group) != of:
                changes.put(_KIND, self._below + group, of)
        self._cache.write(changes)


def read_rows(path: Path, record: GroupsRecord, groups: AbstractSet[str]) -> bytes:
    """Return the rows that a joined file on disk has of some groups, as a JSON list. They are not compared with the record.

    Raises:
        OSError: it cannot be read.
    """
    texts = []
    with path.open("rb") as file:
        for digest, start, rows in record.starts(path.name):
            if digest in groups:
                file.seek(start)
                texts.append(file.read(rows.size))
    return b"[%b]" % SEPARATOR.join(texts)


def rows_on_disk(file: BinaryIO, start: int, size: int) -> Iterator[bytes]:
    """Yield rows of a joined file, a block at a time.

    Raises:
        TornError: it is too short.
    """
    file.seek(start)
    while size:
        block = file.read(min(_BLOCK_BYTES, size))
        if not block:
            raise TornError
        size -= len(block)
        yield block


class Piece(NamedTuple):
    """The rows of one group in a file that is written.

    Attributes:
        known: what the file on disk has of it; None if it is joined.
        texts: of a known group blocks of its rows, else the rows of each recording.
    """

    known: Rows | None
    texts: Iterable[bytes]


def write_rows(path: Path, frame: Frame, pieces: Iterable[Piece]) -> tuple[str, list[Rows]]:
    """Write a joined file; return its digest, and what it has of each group."""
    hasher, found, before = blake3(), [], frame.head
    with writer(path) as file:

        def write(data: bytes) -> None:
            file.write(data)
            hasher.update(data)

        for known, texts in pieces:
            size = number = 0
            for text in filter(None, texts):
                if known is None or not size:
                    write(before)
                    before = SEPARATOR
                write(text)
                size += len(text) + len(SEPARATOR) * (known is None and number > 0)
                number += known is not None or text.count(b"\n") + 1
            found.append(known or Rows(size, number))
        write(frame.empty if before is frame.head else frame.tail)
    return hasher.hexdigest(), found
