"""Joining the recordings of a dataset into a new folder: files with their rows, files that exist once, and the lock."""

import json
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

from bagassets.base.fingerprints import loaded_code_fingerprint
from bagassets.base.json_types import JsonObject
from bagassets.engine.splits import SplitShare, shares_of
from bagassets.formats.dataset_lock import FORMAT, LOCK, LockedBag, locked_bag
from bagassets.formats.format import FACTS, ByGroups, Format, Joined, Kept, Member, Part
from bagassets.formats.groups import (
    Group,
    GroupRecord,
    GroupsRecord,
    Piece,
    Rows,
    RowsOnDisk,
    TornError,
    cut,
    read_rows,
    write_rows,
)
from bagassets.formats.json_files import Frame, framed, framed_row, write_hashed
from bagassets.recipe.model_base import DatasetSettings
from bagassets.recipe.model_splits import Splits
from bagassets.store.canonical import digest_json
from bagassets.store.store import Store

S = TypeVar("S", bound=DatasetSettings)


@dataclass(frozen=True)
class Joint(Generic[S]):
    """What is joined.

    Attributes:
        kind: the format.
        parts: the recordings in the order of their keys, each content once.
        settings: the format's section of the recipe.
        splits: the recipe's `splits`.
        dealt: recording -> split.
        left_out: `duplicates`, `skipped`, `failed` -> recording -> why it takes no part; `damaged` ->
            recording -> how much of it was read.
        store: has the artifacts.
        kept: files of the dataset on disk.
    """

    kind: Format[S]
    parts: Sequence[Part]
    settings: S
    splits: Splits
    dealt: Mapping[str, str]
    left_out: Mapping[str, Mapping[str, str]]
    store: Store
    kept: Kept = field(default_factory=Kept)

    @property
    def made_by(self) -> str:
        """Digest of what shapes rows besides the recordings and their splits."""
        settings = self.settings.model_dump(mode="json", exclude={"output"})
        return digest_json([loaded_code_fingerprint(), self.kind.name, self.kind.distribution, settings])

    def member(self, part: Part, number: int) -> Member:
        """Return a recording with its facts.

        Raises:
            StoreError: its part is not in the store, or damaged.
        """
        artifact = self.store.artifact(part.artifact)
        facts = artifact.read_json(FACTS)
        return Member(part, artifact, self.dealt[part.key], number, self.kind.row(facts), facts)


@dataclass(frozen=True)
class JoinedFolder:
    """The result of joining.

    Attributes:
        joined: the files, without the lock.
        lock: digest of the lock.
        shares: share of each split.
        members: the recordings that were joined again.
        before: recordings of the groups on disk that are no more.
        record: what is to be put on record of groups; None if the format has none.
    """

    joined: Joined
    lock: str
    shares: Sequence[SplitShare]
    members: Sequence[Member]
    before: Mapping[str, LockedBag]
    record: GroupsRecord | None


def join_into(new: Path, joint: Joint[S], on_disk: Path, record: GroupsRecord | None = None) -> JoinedFolder:
    """Write the joined files and the lock into an empty folder.

    Args:
        new: the folder.
        joint: what is joined.
        on_disk: the folder of the dataset on disk.
        record: what is on record of its groups; None has everything joined again.

    Raises:
        StoreError: an artifact is not in the store.
        TornError: the folder on disk is not the one on record.
    """
    kind, how = joint.kind, joint.kind.join
    groups = cut(joint.parts, joint.dealt)
    known = {} if record is None else record.groups
    members = {
        group.digest: [joint.member(part, group.first + number) for number, part in enumerate(group.parts)]
        for group in groups
        if group.digest not in known
    }
    again = [member for some in members.values() for member in some]
    before: Mapping[str, LockedBag] = {}
    if record is not None:
        before = _rows_gone(on_disk / LOCK, record, frozenset(group.digest for group in groups))
    durations_s = {
        digest: [kind.duration_s(member.facts) for member in some] for digest, some in members.items()
    } | {digest: one.durations_s for digest, one in known.items()}
    shares = shares_of(
        (
            (part.key, duration_s)
            for group in groups
            for part, duration_s in zip(group.parts, durations_s[group.digest], strict=True)
        ),
        joint.splits,
        joint.dealt,
    )
    files = _Files(new, groups, members, on_disk, record)
    facts: list[JsonObject] = []
    if isinstance(how, ByGroups):
        facts = [
            known[group.digest].facts
            if group.digest in known
            else how.facts(members[group.digest], joint.settings)
            for group in groups
        ]
        names = how.files(joint.settings, [share.name for share in shares])
        for name in names:
            rows = partial(how.rows, joint.settings, name)
            files.write(name, how.frame(name, facts, shares), rows)
        finished = how.finish(facts, joint.settings, shares, files.numbers)
        digests = files.digests | {
            name: write_hashed(new / name, content) for name, content in finished.files.items()
        }
        joined = Joined(dict(sorted(digests.items())), finished.facts, finished.beside)
    elif kind.rejoin is not None:
        joined = kind.rejoin(again, joint.settings, shares, new, joint.kept)
    else:
        joined = how(again, joint.settings, shares, new)
    needs = _needs(kind, again, before)
    files.write(
        LOCK,
        framed(_lock(joint, shares, joined), "bags"),
        lambda member: framed_row(_lock_row(kind, member, needs[member.part.artifact])),
    )
    found = files.record(joint.made_by, durations_s, facts) if isinstance(how, ByGroups) else None
    return JoinedFolder(joined, files.digests[LOCK], shares, again, before, found)


class _Files:
    """Files with rows of recordings, written one after the other.

    Attributes:
        digests: file -> digest.
        numbers: file -> number of rows.
    """

    def __init__(
        self,
        new: Path,
        groups: Sequence[Group],
        members: Mapping[str, Sequence[Member]],
        on_disk: Path,
        record: GroupsRecord | None,
    ) -> None:
        self.digests: dict[str, str] = {}
        self.numbers: dict[str, int] = {}
        self._new, self._on_disk, self._record = new, on_disk, record
        self._groups, self._members = groups, members
        self._heads: dict[str, int] = {}
        self._rows: dict[str, dict[str, Rows]] = {group.digest: {} for group in groups}

    def write(self, name: str, frame: Frame, rows: Callable[[Member], bytes]) -> None:
        """Write a file; `rows` returns those of a recording.

        Raises:
            TornError: the file on disk is not the one on record.
        """
        record = self._record
        pieces = [
            Piece(group.digest, None, map(rows, self._members[group.digest]))
            if record is None or group.digest in self._members
            else Piece(group.digest, record.groups[group.digest].rows[name], ())
            for group in self._groups
        ]
        with nullcontext() if record is None else _opened(self._on_disk / name, record) as on_disk:
            self.digests[name], found = write_rows(self._new / name, frame, pieces, on_disk)
        self._heads[name] = len(frame.head)
        self.numbers[name] = sum(one.number for one in found)
        for group, one in zip(self._groups, found, strict=True):
            self._rows[group.digest][name] = one

    def record(
        self, made_by: str, durations_s: Mapping[str, Sequence[float]], facts: Sequence[JsonObject]
    ) -> GroupsRecord:
        """Return what is to be put on record of the groups."""
        return GroupsRecord(
            made_by,
            {name: (digest, self._heads[name]) for name, digest in self.digests.items()},
            {
                group.digest: GroupRecord(self._rows[group.digest], its, durations_s[group.digest])
                for group, its in zip(self._groups, facts, strict=True)
            },
        )


def _opened(path: Path, record: GroupsRecord) -> RowsOnDisk:
    try:
        return RowsOnDisk(path, record)
    except (OSError, KeyError) as err:
        raise TornError from err


def _rows_gone(path: Path, record: GroupsRecord, groups: AbstractSet[str]) -> dict[str, LockedBag]:
    """Return the recordings in a lock of the groups that are no more.

    Raises:
        TornError: the lock is not the one on record.
    """
    try:
        gone = read_rows(path, record, record.groups.keys() - groups)
        return {row["key"]: locked_bag(row) for row in json.loads(gone)}
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise TornError from err


def _needs(
    kind: Format[S], members: Sequence[Member], before: Mapping[str, LockedBag]
) -> dict[str, Sequence[str]]:
    """Return part -> artifacts that the dataset needs: the part, and the artifacts that its files are linked from."""
    known = {bag.artifact: bag.needs for bag in before.values() if bag.needs is not None}
    parts = {member.part.artifact: member for member in members}
    return {
        part: known.get(part) or [part, *sorted({link.artifact for link in kind.links(member)} - {part})]
        for part, member in parts.items()
    }


def _lock(joint: Joint[S], shares: Sequence[SplitShare], joined: Joined) -> JsonObject:
    """Return the lock, without its recordings: everything needed to restore the dataset, and what was left out and why."""
    settings = joint.settings.model_dump(mode="json", exclude={"output"})
    return {
        "format": FORMAT,
        "dataset": joint.kind.name,
        joint.kind.name: settings,
        "splits": joint.splits.model_dump(mode="json"),
        "shares": {share.name: share.as_json() for share in shares},
        "bags": [],
        **{why: dict(sorted(keys.items())) for why, keys in joint.left_out.items()},
        "files": dict(joined.files),
    }


def _lock_row(kind: Format[S], member: Member, needs: Sequence[str]) -> JsonObject:
    return {
        **member.row,
        "key": member.part.key,
        "content": member.part.content,
        "split": member.split,
        "counts": dict(kind.counts(member.facts)),
        "artifacts": list(needs),
    }
