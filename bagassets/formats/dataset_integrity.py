"""Verifying datasets against the store that they were linked from.

A hard link is the file in the store and is verified there; a copy is hashed. Damaged files are removed from the dataset,
so that the next build links them again.
"""

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn
from uuid import uuid4

from bagassets.base.errors import DatasetError, StoreError
from bagassets.base.files import move, remove, remove_all
from bagassets.base.quantities import count_text
from bagassets.engine.freshness.published import Publication
from bagassets.formats.catalogue import format_of
from bagassets.formats.dataset_build import dataset_folders
from bagassets.formats.dataset_lock import LOCK, DatasetLock, load_lock
from bagassets.formats.format import Entry, Link, Part, UnitFolders
from bagassets.recipe.model import Recipe
from bagassets.store.artifact import Artifact, FileEntry
from bagassets.store.canonical import digest_file
from bagassets.store.store import Store


@dataclass(frozen=True)
class DatasetDamage:
    """A damaged file of a dataset.

    Attributes:
        path: the file.
        reason: a clause that says what is wrong.
        unit: what to remove so that the next build makes it again: the file, or the folder of its recording; None if
            nothing may be removed.
    """

    path: Path
    reason: str
    unit: Path | None

    def __str__(self) -> str:
        return f"{self.path}: {self.reason}"


def find_damage(
    recipe: Recipe, store: Store, damaged: Collection[str] = (), *, others: bool = True
) -> Iterator[DatasetDamage]:
    """Yield the damaged files in the datasets of a recipe; nothing is changed.

    Args:
        recipe: the recipe.
        store: the store that the datasets were made from.
        damaged: artifacts that are damaged in the store.
        others: look at more than the files of these.

    Raises:
        DatasetError: a lock file cannot be read.
    """
    check = _Check(store, frozenset(damaged))
    for folder in sorted({*dataset_folders(recipe).values()}):
        for path in sorted(folder.glob(f"*/{LOCK}")):
            if ".tmp-" in path.parent.name:
                continue  # what a killed build left, or could not remove: the next one that has something to do removes it
            lock = load_lock(path)
            if others:
                yield from check.tables(path.parent, lock.files)
            try:
                for linked in _links(check, lock, folder):
                    if others or linked[1].artifact in damaged:
                        yield from check.file(*linked)
            except DatasetError as err:  # of a package whose format cannot say which files these are
                yield DatasetDamage(path, f"its files cannot be checked: {err}", None)
            yield from check.unchecked(path.parent)


def remove_changed_sources(recipe: Recipe, store: Store) -> list[str]:
    """Remove artifacts from the store that were changed through a dataset; return a sentence about each.

    A hard link in a dataset is the file in the store: writing into it damages both, and linking it again would repair
    nothing. Only links that changed since they were published are examined.
    """
    reasons: dict[str, str] = {}
    check = _Check(store, frozenset())
    for asset, folder in dataset_folders(recipe).items():
        differing = Publication(recipe.state, asset).changed_files(folder) or ()
        suspects = {folder / name for name in differing if _has_other_names(folder / name)}
        for lock_path in sorted(folder.glob(f"*/{LOCK}")) if suspects else ():
            with suppress(DatasetError):  # a torn lock is replaced with the tables
                lock = load_lock(lock_path)
                for path, link, _ in _links(check, lock, folder):
                    if path in suspects and check.is_changed_in_store(link):
                        reason = f"{path}: was changed in place, so it is made again"
                        reasons.setdefault(link.artifact, reason)
    for artifact in reasons:
        store.remove(artifact)
    return sorted(reasons.values())


def _has_other_names(path: Path) -> bool:
    try:
        return path.stat().st_nlink > 1
    except OSError:
        return False


def _links(check: "_Check", lock: DatasetLock, output: Path) -> Iterator[tuple[Path, Link, Path]]:
    """Yield path, link and `unit` of the linked files of a dataset, except those of parts that are damaged themselves."""
    kind = format_of(lock)
    for number, bag in enumerate(lock.bags.values()):
        with suppress(StoreError, KeyError, TypeError):  # the manifest is damaged itself
            part = check.artifact(bag.artifact)
            entry = Entry(Part(bag.key, bag.content, bag.artifact), part, bag.split, number, bag.row)
            unit = output / kind.places.unit(entry) if isinstance(kind.places, UnitFolders) else None
            below = lock.path.parent if kind.places is None else output
            for link in kind.links(entry):
                path = below / link.name
                yield path, link, unit or path


class _Untrusted(Artifact):
    """A damaged artifact: its files are known, but their content cannot be trusted."""

    def read_json(self, relative: str) -> NoReturn:
        raise StoreError(f"{self.path(relative)}: this artifact is damaged and is not read.")

    def read_table(self, relative: str, columns: Sequence[str] | None = None) -> NoReturn:
        del columns
        self.read_json(relative)


def remove_damaged(damages: Collection[DatasetDamage]) -> None:
    """Remove damaged files from their datasets."""
    for unit in sorted({damage.unit for damage in damages if damage.unit is not None}):
        if unit.is_dir():
            retired = unit.with_name(f"{unit.name}.tmp-{uuid4().hex}")
            move(unit, retired)
            remove_all(retired)
        else:
            remove(unit)


class _Check:
    """Compares files of datasets with the manifests of their artifacts; each manifest is read once."""

    def __init__(self, store: Store, damaged: frozenset[str]) -> None:
        self._store = store
        self._damaged = damaged
        self._entries: dict[str, Mapping[str, FileEntry] | None] = {}
        self._unchecked = 0

    def entries(self, artifact: str) -> Mapping[str, FileEntry] | None:
        """Return the files of an artifact by name; None if the store does not have it (any more)."""
        if artifact not in self._entries:
            self._entries[artifact] = None
            with suppress(StoreError, KeyError, TypeError):
                entries = self._store.artifact(artifact).entries()
                self._entries[artifact] = {entry.path: entry for entry in entries}
        return self._entries[artifact]

    def artifact(self, digest: str) -> Artifact:
        """Return an artifact; no file of a damaged one is read, because all are made again.

        Raises:
            StoreError: the store does not have it.
        """
        artifact = self._store.artifact(digest)
        return _Untrusted(artifact.digest, artifact.folder) if digest in self._damaged else artifact

    def tables(self, folder: Path, digests: Mapping[str, str]) -> Iterator[DatasetDamage]:
        """Check the files whose digests are in a lock."""
        for name, digest in sorted(digests.items()):
            path = folder / name
            reason = _difference(path, digest)
            if reason is not None:
                yield DatasetDamage(path, reason, path)

    def is_changed_in_store(self, link: Link) -> bool:
        """Tell whether a file in the store differs from its manifest."""
        entry = (self.entries(link.artifact) or {}).get(link.file)
        if entry is None:
            return False
        return _difference(self._store.artifact(link.artifact).path(link.file), entry.digest) is not None

    def file(self, path: Path, link: Link, unit: Path) -> Iterator[DatasetDamage]:
        """Check a file that was linked or copied from the store."""
        _, artifact, name = link
        try:
            stat = path.stat()
        except OSError as err:
            yield DatasetDamage(path, f"is missing ({err.strerror})", unit)
            return
        entries = self.entries(artifact)
        if entries is None or name not in entries:
            if artifact in self._damaged:
                yield DatasetDamage(path, f"comes from the damaged artifact {artifact[:16]}", unit)
            else:
                self._unchecked += 1
            return
        if artifact not in self._damaged:
            with suppress(OSError):
                if os.path.samestat(self._store.artifact(artifact).path(name).stat(), stat):
                    return
        reason = _difference(path, entries[name].digest)
        if reason is not None:
            yield DatasetDamage(path, reason, unit)

    def unchecked(self, output: Path) -> Iterator[DatasetDamage]:
        """Report the files whose artifacts are gone; they stay, since no other copy may be left."""
        if self._unchecked:
            whose = "its artifact is" if self._unchecked == 1 else "their artifacts are"
            reason = (
                f"{count_text(self._unchecked, 'file')} cannot be checked, because {whose} not in the store; build, then "
                "verify again"
            )
            yield DatasetDamage(output, reason, None)
        self._unchecked = 0


def _difference(path: Path, digest: str) -> str | None:
    try:
        return None if digest_file(path) == digest else "was changed"
    except OSError as err:
        return f"is missing or cannot be read ({err.strerror})"
