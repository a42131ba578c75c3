"""Assembling a dataset of any format from the parts of recordings.

First the files of recordings appear, under names that change with their content; then the folder of joined files is
swapped at once; then files that only the old folder named are removed. Killed at any point, this leaves a complete
dataset, old or new, and the next run removes the leftovers.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import TypeVar
from uuid import uuid4

from bagassets.base.errors import DatasetError, StoreError
from bagassets.base.files import (
    make_folder,
    move,
    remove,
    remove_all,
    remove_empty,
    swap_in,
    sync_folder,
    write_atomically,
)
from bagassets.base.json_types import JsonMapping
from bagassets.engine.splits import SplitShare, deal, moves
from bagassets.formats.dataset_lock import LOCK, LockedBag, read_lock
from bagassets.formats.format import FACTS, Entry, Format, Kept, Link, LooseFiles, Member, Part, UnitFolders
from bagassets.formats.groups import GroupsRecord, TornError
from bagassets.formats.guard import GUARD, guarded, refuse_unexpected
from bagassets.formats.joining import Joint, join_into
from bagassets.formats.linking import Linker
from bagassets.recipe.model_base import DatasetSettings
from bagassets.recipe.model_splits import Splits
from bagassets.store.artifact import Artifact
from bagassets.store.canonical import digest_bytes, digest_file, digest_json
from bagassets.store.store import Store

S = TypeVar("S", bound=DatasetSettings)


@dataclass(frozen=True)
class DatasetSummary:
    """The result of assembling a dataset.

    Attributes:
        digest: digest of all joined files; equal digests mean equal datasets.
        folder: the folder that users of the dataset open.
        facts: facts from the format.
        shares: each split's share of the driven time.
        files: linked, cloned, copied, removed, or kept (compared, and found in place) -> number of files.
        duplicates: left-out recording -> recording with the same content.
        changed: the folder was swapped; False if it was up to date.
        moved: recordings whose split changed -> old and new split.
        published: joined file -> digest.
        links: part of a recording that may be new -> function that yields the names of its links below the output.
        gone: parts that the dataset had, and has no more; None if all others than those in `links` are gone.
        record: what is to be put on record of groups of recordings, if the format has them.
    """

    digest: str
    folder: Path
    facts: JsonMapping
    shares: Sequence[SplitShare]
    files: Mapping[str, int] = field(default_factory=dict)
    duplicates: Mapping[str, str] = field(default_factory=dict)
    changed: bool = True
    moved: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    published: Mapping[str, str] = field(default_factory=dict)
    links: Mapping[str, Callable[[], Iterator[str]]] = field(default_factory=dict)
    gone: AbstractSet[str] | None = None
    record: GroupsRecord | None = None


def assemble(
    kind: Format[S],
    parts: Sequence[Part],
    settings: S,
    store: Store,
    output: Path,
    *,
    splits: Splits | None = None,
    dealt: Mapping[str, str] | None = None,
    skipped: Mapping[str, str] | None = None,
    failed: Mapping[str, str] | None = None,
    damaged: Mapping[str, str] | None = None,
    expected: Mapping[str, str] | None = None,
    suspects: AbstractSet[str] | None = None,
    torn_since_s: float | None = None,
    record: GroupsRecord | None = None,
    permit: Callable[[], None] = lambda: None,
) -> DatasetSummary:
    """Bring the dataset in `output` up to date.

    The result depends neither on the order of `parts` nor on what was there before. Without recordings the dataset is
    empty.

    Args:
        kind: the format.
        parts: the recordings to include.
        settings: the format's section of the recipe.
        store: has the artifacts.
        output: folder of the dataset.
        splits: the recipe's `splits`; None for the defaults.
        dealt: recording -> split; None to deal these recordings by `splits`.
        skipped: recordings that take no part -> reason, for the lock file.
        failed: recordings that failed -> reason, for the lock file.
        damaged: recordings that were read although they are damaged -> how much of them, for the lock file.
        expected: name -> digest of the joined files; if they differ, nothing is swapped.
        suspects: files that changed since they were published and are compared with their sources; all others are
            trusted. None if that is unknown.
        torn_since_s: since when (Unix seconds) a crash may have torn files that were not published yet; None if there was none.
        record: what is on record of groups of recordings; of use only without suspects.
        permit: called before anything is published; nothing is if it raises.

    Raises:
        DatasetError: the folder holds something else, files cannot be written, or joined files differ from those
            expected.
        StoreError: an artifact is not in the store.
    """
    splits = splits or Splits()
    chosen, duplicates = without_copies(parts)
    dealt = deal([part.key for part in chosen], splits) if dealt is None else dealt
    misfits = _misfits(kind, chosen, store)
    chosen = [part for part in chosen if part.key not in misfits]
    left_out = {
        "duplicates": duplicates,
        "skipped": {**(skipped or {}), **misfits},
        "failed": failed or {},
    }
    left_out |= {"damaged": damaged} if damaged else {}
    joint = Joint(kind, chosen, settings, splits, dealt, left_out, store)
    folder = kind.folder(settings)
    current = output / folder
    if suspects is None:  # otherwise it is on record that the folder is ours, even if its lock is lost
        _refuse_foreign(kind, output, current)
    with guarded(output):
        leftovers = sorted(output.glob(f"{folder}.tmp-*"))
        # What else changed, or what a killed build left behind, only a look at everything can tell.
        if suspects or suspects is None or leftovers or (record and record.made_by != joint.made_by):
            record = None
        if kind.rejoin is not None and suspects is not None:
            joint = replace(joint, kept=_kept(current, suspects))
        new = output / f"{folder}.tmp-{uuid4().hex}"
        make_folder(new, new=True)
        try:
            made = join_into(new, joint, current, record)
        except TornError:  # the record is older than the folder, or somebody changed a file unnoticed
            record = suspects = None
            remove_all(new)
            make_folder(new, new=True)
            made = join_into(new, joint, current)
        joined, members = made.joined, made.members
        before = made.before if record is not None else _bags_in(current)
        refuse_unexpected(new, joined.files, expected)
        has_links = kind.places is not None or (
            suspects is not None and not any(name.startswith(f"{folder}/") for name in suspects)
        )
        changed = not (has_links and _is_same(new, current, joined.files))
        permit()
        linker = Linker(output, new, torn_since_s)
        is_known = suspects is not None and f"{folder}/{LOCK}" not in suspects
        there = {key: bag.artifact for key, bag in before.items()} if is_known else {}
        _put_files(kind, linker, members, there, suspects, store, output, new if changed else None)
        for name, content in joined.beside.items():
            path = output / name
            if not path.is_file() or path.read_bytes() != content:
                write_atomically(path, content, within=new)
        old = swap_in(new, current) if changed else new
        retired = {one: _bags_in(one) for one in leftovers} | ({} if old is None else {old: before})
        removed = _retire(joint, output, current, retired, members, is_whole=record is None)
    files = dict(linker.counts) | ({"removed": removed} if isinstance(kind.places, LooseFiles) else {})
    return DatasetSummary(
        digest=digest_json(joined.files),
        folder=output if isinstance(kind.places, UnitFolders) else current,
        facts=joined.facts,
        shares=made.shares,
        files=dict(sorted(files.items())),
        duplicates=duplicates,
        changed=changed,
        moved=moves(
            {key: bag.split for key, bag in before.items()},
            {member.part.key: member.split for member in members},
        ),
        published={
            **{f"{folder}/{name}": digest for name, digest in joined.files.items()},
            f"{folder}/{LOCK}": made.lock,
            **{name: digest_bytes(content) for name, content in joined.beside.items()},
        },
        links={member.part.artifact: partial(_names, kind, member, folder) for member in members},
        gone=None if record is None else {bag.artifact for bag in before.values()},
        record=made.record,
    )


def without_copies(parts: Iterable[Part]) -> tuple[list[Part], dict[str, str]]:
    """Return the first part of each content in the order of their keys, and duplicate -> recording in its place."""
    ordered = sorted(parts, key=lambda part: part.key)
    copies = copies_of({part.key: part.content for part in ordered})
    return [part for part in ordered if part.key not in copies], copies


def copies_of(contents: Mapping[str, str]) -> dict[str, str]:
    """Return recording -> the first one, by key, of the same content, which a dataset has for both; without these first ones."""
    first: dict[str, str] = {}
    same = {key: first.setdefault(content, key) for key, content in sorted(contents.items())}
    return {key: other for key, other in same.items() if other != key}


def _misfits(kind: Format[S], parts: Sequence[Part], store: Store) -> Mapping[str, str]:
    """Return the recordings that the format cannot join with the others -> why."""
    if kind.misfits is None:
        return {}
    return kind.misfits({part.key: store.artifact(part.artifact).read_json(FACTS) for part in parts})


def _kept(current: Path, suspects: AbstractSet[str]) -> Kept:
    """Return the joined files of the dataset on disk that nobody has touched; none without its lock."""
    if f"{current.name}/{LOCK}" in suspects:
        return Kept()
    try:
        before = read_lock(current)
    except DatasetError:
        before = None
    files = {} if before is None else before.files
    return Kept(
        current, {name: one for name, one in files.items() if f"{current.name}/{name}" not in suspects}
    )


def _put_files(
    kind: Format[S],
    linker: Linker,
    members: Sequence[Member],
    there: Mapping[str, str],
    suspects: AbstractSet[str] | None,
    store: Store,
    output: Path,
    new: Path | None,
) -> None:
    """Link the files of recordings.

    Args:
        kind: the format.
        linker: makes files appear below the output.
        members: the recordings.
        there: recording -> part of which the dataset on disk has the files.
        suspects: see `assemble`.
        store: has the artifacts.
        output: folder of the dataset.
        new: the folder to be swapped in; None if the old one stays.
    """
    for folder in kind.folders:
        make_folder(output / folder)
    source = _sources(store)
    match kind.places:
        case UnitFolders() as units:
            for member in members:
                _put_unit(output, units.unit(member), kind.links(member), linker, suspects, source)
        case LooseFiles() as loose:
            suspicious = {loose.recording_of(name) for name in suspects or ()}
            for member in members:
                is_there = there.get(member.part.key) == member.part.artifact
                for link in kind.links(member) if not is_there or member.part.key in suspicious else ():
                    is_suspect = suspects is None or link.name in suspects
                    if is_suspect or not is_there:
                        linker.put(source(link), link.name, replaces=is_suspect)
        case None if new is not None:
            for member in members:
                for link in kind.links(member):
                    linker.put(source(link), f"{new.name}/{link.name}")
        case None:
            pass


def _put_unit(
    output: Path,
    unit: str,
    links: Iterable[Link],
    linker: Linker,
    suspects: AbstractSet[str] | None,
    source: Callable[[Link], str],
) -> None:
    """Make the folder of a recording appear whole; in an existing one, replace the suspects or, if unknown, all files."""
    if (output / unit).is_dir():
        if (
            suspects is None
            or linker.torn_since_s is not None
            or any(name.startswith(f"{unit}/") for name in suspects)
        ):
            for link in links:
                is_suspect = suspects is None or link.name in suspects
                if is_suspect or linker.torn_since_s is not None:
                    linker.put(source(link), link.name, replaces=is_suspect)
        return
    temporary = f"{unit}.tmp-{uuid4().hex}"
    make_folder(output / temporary, new=True)
    for link in links:
        linker.put(source(link), temporary + link.name.removeprefix(unit))
    move(output / temporary, output / unit)


def _sources(store: Store) -> Callable[[Link], str]:
    """Return a function that returns the path of a link's file in the store; each artifact is looked up once."""
    folder = cache(lambda artifact: str(store.artifact(artifact).files))
    return lambda link: f"{folder(link.artifact)}/{link.file}"


def _names(kind: Format[S], entry: Entry, folder: str) -> Iterator[str]:
    """Yield the names of the links of a recording below the output."""
    prefix = f"{folder}/" if kind.places is None else ""
    return (f"{prefix}{link.name}" for link in kind.links(entry))


def _is_same(new: Path, current: Path, digests: Mapping[str, str]) -> bool:
    """Tell whether `current` has the lock and the joined files of `new`, byte for byte."""
    try:
        return (current / LOCK).read_bytes() == (new / LOCK).read_bytes() and all(
            (here := (current / name).stat()).st_size == (there := (new / name).stat()).st_size
            and (here.st_ino == there.st_ino or digest_file(current / name) == digest)
            for name, digest in digests.items()
        )
    except OSError:
        return False


def _retire(
    joint: Joint[S],
    output: Path,
    current: Path,
    retired: Mapping[Path, Mapping[str, LockedBag]],
    members: Sequence[Member],
    *,
    is_whole: bool,
) -> int:
    """Remove old folders, and files of recordings that nothing names any more; return the number of such files.

    Args:
        joint: what was joined.
        output: folder of the dataset.
        current: the folder that was swapped in.
        retired: old folder -> recordings in it whose files may be of no more use.
        members: the recordings that were joined.
        is_whole: these are all.
    """
    places, removed = joint.kind.places, 0
    now = {part.artifact for part in joint.parts}
    gone = {
        folder: [(number, bag) for number, bag in enumerate(bags.values()) if bag.artifact not in now]
        for folder, bags in retired.items()
    }
    if isinstance(places, LooseFiles):
        stale = {name for folder, bags in gone.items() for name in _names_gone(joint, places, folder, bags)}
        keys = {bag.key for bags in gone.values() for _, bag in bags}
        for member in members if stale else ():
            if member.part.key in keys:
                stale.difference_update(link.name for link in joint.kind.links(member))
        others = (path for path in sorted(output.iterdir()) if path.is_dir() and path not in retired)
        for other in others if stale else ():
            if other != current:
                stale.difference_update(places.named_in(other))
        removed = remove_files(output, stale)
    elif isinstance(places, UnitFolders):
        named = {places.name(member) for member in members}
        if is_whole:
            there = {unit.name for unit in (output / places.folder).glob("*")}
        else:
            there = {places.name(_entry(joint.store, *one)) for bags in gone.values() for one in bags}
        for name in sorted(there - named):
            remove_all(output / places.folder / name)
        if there - named:
            sync_folder(output / places.folder)
    for folder in retired:
        remove_all(folder)
    return removed


def _names_gone(
    joint: Joint[S], loose: LooseFiles, folder: Path, bags: Sequence[tuple[int, LockedBag]]
) -> Iterable[str]:
    """Return the names of the files that a folder names of some recordings."""
    try:
        return [link.name for one in bags for link in joint.kind.links(_entry(joint.store, *one))]
    except StoreError:  # a part was removed from the store
        keys = {bag.key for _, bag in bags}
        return [name for name in loose.named_in(folder) if loose.recording_of(name) in keys]


def _entry(store: Store, number: int, bag: LockedBag) -> Entry:
    artifact = Artifact(bag.artifact, store.artifact_folder(bag.artifact))
    return Entry(Part(bag.key, bag.content, bag.artifact), artifact, bag.split, number, bag.row)


def remove_files(output: Path, names: AbstractSet[str]) -> int:
    """Remove files, and folders that become empty; return the number of files."""
    removed = 0
    for name in sorted(names):
        removed += remove(output / name)
    for folder in sorted({(output / name).parent for name in names}):
        sync_folder(folder)  # after a crash nothing would name what came back
        remove_empty(folder)
    return removed


def _bags_in(folder: Path) -> Mapping[str, LockedBag]:
    """Return the recordings in the lock of a folder; empty if it has none."""
    try:
        lock = read_lock(folder)
    except DatasetError:  # torn by a power loss, in a folder that is swapped anyway
        return {}
    return {} if lock is None else lock.bags


def _refuse_foreign(kind: Format[S], output: Path, current: Path) -> None:
    """Refuse to write into a folder that is not ours."""
    folders = [current]
    what = f"it has no {LOCK}"
    if isinstance(kind.places, UnitFolders):
        if (output / GUARD).exists():  # one of our runs was here, perhaps a killed one
            return
        folders.append(output / kind.places.folder)
        what = f"there is no {GUARD} in {output}"
    for folder in folders:
        if folder.exists() and any(folder.iterdir()) and not (folder / LOCK).is_file():
            fields = " or ".join(f"{kind.section}.{field}" for field in kind.named_by)
            raise DatasetError(
                f"{folder}: this folder was not made by bagassets ({what}), so nothing is written into it; choose another {fields}."
            )
