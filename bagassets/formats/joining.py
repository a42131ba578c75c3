"""Joining the recordings of a dataset into a new folder: files with their rows, files that exist once, and the lock."""

import json
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Generic, TypeVar

from bagassets.base.fingerprints import loaded_code_fingerprint
from bagassets.base.json_types import JsonObject
from bagassets.engine.splits import SplitShare, shares_of
from bagassets.formats.dataset_lock import FORMAT, LOCK, LockedBag, locked_bag
from bagassets.formats.format import FACTS, ByGroups, Format, Joined, Kept, Member, Part
from bagassets.formats.groups import (
    GroupRecord,
    GroupsRecord,
    Piece,
    Rows,
    TornError,
    cut,
    read_rows,
    rows_on_disk,
    write_rows,
)
from bagassets.formats.json_files import Frame, framed, framed_row, write_hashed
from bagassets.recipe.model_base import DatasetSettings
from bagassets.recipe.model_splits import Splits
from bagassets.store.canonical import digest_file, digest_json
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
    groups, before = cut(joint.parts, joint.dealt), {}
    if record is None:
        record = GroupsRecord(joint.made_by)
    else:
        before = _rows_gone(on_disk / LOCK, record, frozenset(group.digest for group in groups))
    known = record.groups
    members = {
        group.digest: None
        if group.digest in known
        else [joint.member(part, group.first + number) for number, part in enumerate(group.parts)]
        for group in groups
    }
    again = [member for some in members.values() for member in some or ()]
    durations_s = {
        digest: known[digest].durations_s
        if some is None
        else [kind.duration_s(member.facts) for member in some]
        for digest, some in members.items()
    }
    keys = (part.key for part in joint.parts)
    shares = shares_of(zip(keys, chain(*durations_s.values()), strict=True), joint.splits, joint.dealt)
    files, facts = _Files(new, members, on_disk, record), {}
    if isinstance(how, ByGroups):
        facts = {
            digest: known[digest].facts if some is None else how.facts(some, joint.settings)
            for digest, some in members.items()
        }
        of_all = list(facts.values())
        for name in how.files(joint.settings, [share.name for share in shares]):
            files.write(name, how.frame(name, of_all, shares), partial(how.rows, joint.settings, name))
        finished = how.finish(of_all, joint.settings, shares, files.numbers)
        digests = {name: digest for name, (digest, _) in files.digests.items()}
        for name, content in finished.files.items():
            digests[name] = write_hashed(new / name, content)
        joined = Joined(dict(sorted(digests.items())), finished.facts, finished.beside)
    elif kind.rejoin is not None:
        joined = kind.rejoin(again, joint.settings, shares, new, joint.kept)
    else:
        joined = how(again, joint.settings, shares, new)
    needs = _needs(kind, again, before)
    row = partial(_lock_row, kind, needs)
    files.write(LOCK, framed(_lock(joint, shares, joined)), row)
    found = {
        digest: GroupRecord(files.rows[digest], its, durations_s[digest]) for digest, its in facts.items()
    }
    now = GroupsRecord(joint.made_by, files.digests, found) if isinstance(how, ByGroups) else None
    return JoinedFolder(joined, files.digests[LOCK][0], shares, again, before, now)


class _Files:
    """Files with rows of recordings, written one after the other.

    Attributes:
        numbers: file -> number of rows.
        digests: file -> its digest, and the size of what stands before its rows.
        rows: digest of a group -> file -> what it has of the group.
    """

    def __init__(
        self, new: Path, members: Mapping[str, Sequence[Member] | None], on_disk: Path, record: GroupsRecord
    ) -> None:
        self.numbers: dict[str, int] = {}
        self.digests: dict[str, tuple[str, int]] = {}
        self.rows: dict[str, dict[str, Rows]] = {digest: {} for digest in members}
        self._new, self._members, self._on_disk, self._record = new, members, on_disk, record

    def write(self, name: str, frame: Frame, rows: Callable[[Member], bytes]) -> None:
        """Write a file; `rows` returns those of a recording.

        Raises:
            TornError: the file on disk is not the one on record.
        """
        with ExitStack() as stack:
            file, starts = None, {}
            if self._record.groups:
                try:
                    starts = {digest: start for digest, start, _ in self._record.starts(name)}
                    file = stack.enter_context((self._on_disk / name).open("rb", buffering=0))
                    if digest_file(self._on_disk / name) != self._record.files[name][0]:
                        raise TornError
                except (OSError, KeyError) as err:
                    raise TornError from err

            def piece(digest: str, members: Sequence[Member] | None) -> Piece:
                if members is not None or file is None:
                    return Piece(None, map(rows, members or ()))
                known = self._record.groups[digest].rows[name]
                return Piece(known, rows_on_disk(file, starts.get(digest, 0), known.size))

            pieces = (piece(digest, some) for digest, some in self._members.items())
            digest, found = write_rows(self._new / name, frame, pieces)
        self.digests[name] = digest, len(frame.head)
        self.numbers[name] = sum(one.number for one in found)
        for its, one in zip(self.rows.values(), found, strict=True):
            its[name] = one


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
    known = {bag.artifact: bag.needs for bag in before.values()}
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


def _lock_row(kind: Format[S], needs: Mapping[str, Sequence[str]], member: Member) -> bytes:
    row = {
        **member.row,
        "key": member.part.key,
        "content": member.part.content,
        "split": member.split,
        "counts": dict(kind.counts(member.facts)),
        "artifacts": list(needs[member.part.artifact]),
    }
    return framed_row(row)
