"""Assembling a dataset of any format from the parts of recordings.

First the files of recordings appear, under names that change with their content; then the folder of joined files is
swapped at once; then files that only the old folder named are removed. Killed at any point, this leaves a complete
dataset, old or new, and the next run removes the leftovers.
"""

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import TypeVar
from uuid import uuid4

from bagassets.base.atomic import swap_in, write_atomically
from bagassets.base.errors import DatasetError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.engine.splits import SplitShare, deal, moves, shares_of
from bagassets.formats.dataset_lock import FORMAT, LOCK, DatasetLock, read_lock
from bagassets.formats.format import (
    FACTS,
    Entry,
    Format,
    Joined,
    Kept,
    Link,
    LooseFiles,
    Member,
    Part,
    UnitFolders,
)
from bagassets.formats.guard import GUARD, guarded, refuse_unexpected
from bagassets.formats.json_files import json_bytes
from bagassets.formats.linking import Linker
from bagassets.recipe.model_base import DatasetSettings
from bagassets.recipe.model_splits import Splits
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
        links: part of a recording -> function that yields the names of its links below the output.
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
    expected: Mapping[str, str] | None = None,
    suspects: AbstractSet[str] | None = None,
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
        expected: name -> digest of the joined files; if they differ, nothing is swapped.
        suspects: files that changed since they were published and are compared with their sources; all others are
            trusted. None if that is unknown.
        permit: called before anything is published; nothing is if it raises.

    Raises:
        DatasetError: the folder holds something else, files cannot be written, or joined files differ from those
            expected.
        StoreError: an artifact is not in the store.
    """
    splits = splits or Splits()
    members, duplicates = _members(kind, parts, splits, store, dealt)
    misfits = {} if kind.misfits is None else kind.misfits({one.part.key: one.facts for one in members})
    members = [
        replace(one, number=number)
        for number, one in enumerate(m for m in members if m.part.key not in misfits)
    ]
    shares = shares_of(
        [(member.part.key, kind.duration_s(member.facts)) for member in members],
        splits,
        {member.part.key: member.split for member in members},
    )
    folder = kind.folder(settings)
    current = output / folder
    if suspects is None:  # otherwise it is on record that the folder is ours, even if its lock is lost
        _refuse_foreign(kind, output, current)
    with guarded(output):
        before = _lock_of(current)
        leftovers = sorted(output.glob(f"{folder}.tmp-*"))
        new = output / f"{folder}.tmp-{uuid4().hex}"
        new.mkdir()
        if kind.rejoin is None:
            joined = kind.join(members, settings, shares, new)
        else:
            joined = kind.rejoin(members, settings, shares, new, _kept(current, before, suspects))
        refuse_unexpected(new, joined.files, expected)
        known = before if suspects is not None and f"{folder}/{LOCK}" not in suspects else None
        needs = _needs(kind, members, before)
        left_out = {
            "duplicates": duplicates,
            "skipped": {**(skipped or {}), **misfits},
            "failed": failed or {},
        }
        lock = json_bytes(_lock(kind, settings, splits, shares, members, needs, joined, left_out))
        (new / LOCK).write_bytes(lock)
        has_links = kind.places is not None or (
            suspects is not None and not any(name.startswith(f"{folder}/") for name in suspects)
        )
        changed = not (has_links and _is_same(new, current, joined.files))
        permit()
        linker = Linker(output)
        _put_files(kind, linker, members, known, suspects, store, output, new if changed else None)
        for name, content in joined.beside.items():
            path = output / name
            if not path.is_file() or path.read_bytes() != content:
                write_atomically(path, content)
        old = swap_in(new, current) if changed else new
        removed = _retire(kind, output, current, [*leftovers, *([old] if old is not None else [])], members)
    files = dict(linker.counts) | ({"removed": removed} if isinstance(kind.places, LooseFiles) else {})
    return DatasetSummary(
        digest=digest_json(joined.files),
        folder=output if isinstance(kind.places, UnitFolders) else current,
        facts=joined.facts,
        shares=shares,
        files=dict(sorted(files.items())),
        duplicates=duplicates,
        changed=changed,
        moved=moves({} if before is None else before.splits, {m.part.key: m.split for m in members}),
        published={
            **{f"{folder}/{name}": digest for name, digest in joined.files.items()},
            f"{folder}/{LOCK}": digest_bytes(lock),
            **{name: digest_bytes(content) for name, content in joined.beside.items()},
        },
        links={member.part.artifact: partial(_names, kind, member, folder) for member in members},
    )


def _members(
    kind: Format[S], parts: Sequence[Part], splits: Splits, store: Store, dealt: Mapping[str, str] | None
) -> tuple[list[Member], dict[str, str]]:
    """Return the recordings in the dataset in the order of their keys, and duplicate -> recording in its place."""
    chosen, duplicates = without_copies(parts)
    dealt = deal([part.key for part in chosen], splits) if dealt is None else dealt
    members = []
    for number, part in enumerate(chosen):
        artifact = store.artifact(part.artifact)
        facts = artifact.read_json(FACTS)
        members.append(Member(part, artifact, dealt[part.key], number, kind.row(facts), facts))
    return members, duplicates


def without_copies(parts: Iterable[Part]) -> tuple[list[Part], dict[str, str]]:
    """Return the first part of each content in the order of their keys, and duplicate -> recording in its place."""
    first: dict[str, Part] = {}
    for part in (ordered := sorted(parts, key=lambda part: part.key)):
        first.setdefault(part.content, part)
    copies = {part.key: first[part.content].key for part in ordered if first[part.content] is not part}
    return list(first.values()), copies


def _kept(current: Path, before: DatasetLock | None, suspects: AbstractSet[str] | None) -> Kept:
    """Return the joined files of the dataset on disk that nobody has touched; none if that is unknown."""
    if before is None or suspects is None or f"{current.name}/{LOCK}" in suspects:
        return Kept()
    untouched = {name: one for name, one in before.files.items() if f"{current.name}/{name}" not in suspects}
    return Kept(current, untouched)


def _needs(
    kind: Format[S], members: Sequence[Member], before: DatasetLock | None
) -> dict[str, Sequence[str]]:
    """Return part -> artifacts that the dataset needs: the part, and the artifacts that its files are linked from."""
    known: dict[str, Sequence[str]] = {}
    if before is not None and before.kind == kind.name:
        known = {bag.artifact: bag.needs for bag in before.bags.values() if bag.needs is not None}
    parts = {member.part.artifact: member for member in members}
    return {
        part: known.get(part) or [part, *sorted({link.artifact for link in kind.links(member)} - {part})]
        for part, member in parts.items()
    }


def _lock(
    kind: Format[S],
    settings: S,
    splits: Splits,
    shares: Sequence[SplitShare],
    members: Sequence[Member],
    needs: Mapping[str, Sequence[str]],
    joined: Joined,
    left_out: Mapping[str, Mapping[str, str]],
) -> JsonObject:
    """Return the lock: everything needed to restore the dataset, and what was left out and why."""
    return {
        "format": FORMAT,
        "dataset": kind.name,
        kind.name: settings.model_dump(mode="json", exclude={"output"}),
        "splits": splits.model_dump(mode="json"),
        "shares": {share.name: share.as_json() for share in shares},
        "bags": [
            {
                **member.row,
                "key": member.part.key,
                "content": member.part.content,
                "split": member.split,
                "counts": dict(kind.counts(member.facts)),
                "artifacts": list(needs[member.part.artifact]),
            }
            for member in members
        ],
        **{why: dict(sorted(keys.items())) for why, keys in left_out.items()},
        "files": dict(joined.files),
    }


def _put_files(
    kind: Format[S],
    linker: Linker,
    members: Sequence[Member],
    known: DatasetLock | None,
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
        known: the lock of the dataset on disk, if it can be trusted.
        suspects: see `assemble`.
        store: has the artifacts.
        output: folder of the dataset.
        new: the folder to be swapped in; None if the old one stays.
    """
    for folder in kind.folders:
        (output / folder).mkdir(exist_ok=True)
    source = _sources(store)
    match kind.places:
        case UnitFolders() as units:
            for member in members:
                _put_unit(output, units.unit(member), kind.links(member), linker, suspects, source)
        case LooseFiles() as loose:
            there = {} if known is None else {key: bag.artifact for key, bag in known.bags.items()}
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
        if suspects is None or any(name.startswith(f"{unit}/") for name in suspects):
            for link in links:
                if suspects is None or link.name in suspects:
                    linker.put(source(link), link.name, replaces=True)
        return
    temporary = f"{unit}.tmp-{uuid4().hex}"
    (output / temporary).mkdir(parents=True)
    for link in links:
        linker.put(source(link), temporary + link.name.removeprefix(unit))
    (output / temporary).rename(output / unit)


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
    kind: Format[S], output: Path, current: Path, retired: Sequence[Path], members: Sequence[Member]
) -> int:
    """Remove old folders, and files of recordings that nothing names any more; return the number of such files."""
    removed = 0
    if isinstance(kind.places, LooseFiles):
        removed = _remove_loose(kind.places, output, current, retired)
    elif isinstance(kind.places, UnitFolders):
        named = {kind.places.name(member) for member in members}
        for unit in sorted((output / kind.places.folder).glob("*")):
            if unit.name not in named:
                shutil.rmtree(unit, ignore_errors=True)
    for folder in retired:
        shutil.rmtree(folder, ignore_errors=True)
    return removed


def _remove_loose(loose: LooseFiles, output: Path, current: Path, retired: Sequence[Path]) -> int:
    others = [path for path in sorted(output.iterdir()) if path.is_dir() and path not in retired]
    now = _parts(current)
    stale: set[str] = set()
    for folder in retired:
        # Recordings whose part did not change have the same files.
        gone = {key for key, part in _parts(folder).items() if now.get(key) != part}
        stale |= (
            {name for name in loose.named_in(folder) if loose.recording_of(name) in gone} if gone else set()
        )
    for other in others if stale else ():
        stale.difference_update(loose.named_in(other))
    return remove_files(output, stale)


def remove_files(output: Path, names: AbstractSet[str]) -> int:
    """Remove files, and folders that become empty; return the number of files."""
    removed = 0
    for name in sorted(names):
        with suppress(FileNotFoundError):
            (output / name).unlink()
            removed += 1
    for folder in sorted({(output / name).parent for name in names}):
        with suppress(OSError):  # not empty, or gone
            folder.rmdir()
    return removed


def _parts(folder: Path) -> dict[str, str]:
    """Return recording -> part, as in the lock of a folder; empty if it has none."""
    lock = _lock_of(folder)
    return {} if lock is None else {key: bag.artifact for key, bag in lock.bags.items()}


def _lock_of(folder: Path) -> DatasetLock | None:
    try:
        return read_lock(folder)
    except DatasetError:  # torn by a power loss, in a folder that is swapped anyway
        return None


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
