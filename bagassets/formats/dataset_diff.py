"""How two datasets differ in recordings, scenes, samples and settings, by their lock files and the store."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeVar

from bagassets.base.errors import DatasetError, StoreError
from bagassets.base.json_types import Json, JsonObject
from bagassets.engine.differences import flatten
from bagassets.formats.catalogue import installed_format
from bagassets.formats.dataset_lock import DatasetLock, LockedBag
from bagassets.formats.format import AnyFormat
from bagassets.store.store import Store

_V = TypeVar("_V")
_LEFT_OUT = ("skipped", "failed", "duplicates")


@dataclass(frozen=True)
class SceneDiff:
    """A scene that differs.

    Attributes:
        name: name of the scene.
        change: what happened to it.
        added: tokens of samples that only the second dataset has.
        removed: tokens of samples that only the first has.
        changed: token of a sample in both -> its parts that differ (readings, poses, calibration, boxes).
    """

    name: str
    change: Literal["added", "removed", "changed"]
    added: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    changed: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class BagDiff:
    """A recording that differs.

    Attributes:
        key: partition key.
        change: what happened to it; `renamed` if the same content had another key.
        before: its entry in the first dataset.
        after: its entry in the second.
        scenes: scenes that differ; None if unknown, because an artifact is not in the store or the format has no
            samples.
    """

    key: str
    change: Literal["added", "removed", "changed", "renamed"]
    before: LockedBag | None
    after: LockedBag | None
    scenes: tuple[SceneDiff, ...] | None = ()


@dataclass(frozen=True)
class DatasetDiff:
    """The differences between two datasets.

    Attributes:
        bags: recordings that differ.
        left_out: `skipped`, `failed` or `duplicates` -> partition key -> reason before and after; None where it was not.
        settings: field of the recipe -> value before and after.
        files: tables whose bytes differ.
        has_samples: the format has samples.
    """

    bags: tuple[BagDiff, ...]
    left_out: Mapping[str, Mapping[str, tuple[str | None, str | None]]]
    settings: Mapping[str, tuple[Json, Json]]
    files: tuple[str, ...]
    has_samples: bool = True

    @property
    def is_empty(self) -> bool:
        """True if both are the same dataset."""
        return not (self.bags or self.settings or self.files or any(self.left_out.values()))


def diff_datasets(before: DatasetLock, after: DatasetLock, store: Store) -> DatasetDiff:
    """Return how two datasets differ.

    Args:
        before: lock of the first.
        after: lock of the second.
        store: has their artifacts.

    Raises:
        DatasetError: they are of different formats.
    """
    if before.kind != after.kind:
        raise DatasetError(
            f"{before.path} is a {before.kind} dataset and {after.path} a {after.kind} one; name two of one kind."
        )
    kind = installed_format(before.kind)
    names = before.files.keys() | after.files.keys()
    return DatasetDiff(
        bags=tuple(_bags(before, after, store, kind)),
        left_out={why: _changes(before.value.get(why, {}), after.value.get(why, {})) for why in _LEFT_OUT},
        settings=_changes(_settings(before), _settings(after)),
        files=tuple(sorted(name for name in names if before.files.get(name) != after.files.get(name))),
        has_samples=kind is not None and kind.samples is not None,
    )


def _bags(before: DatasetLock, after: DatasetLock, store: Store, kind: AnyFormat | None) -> list[BagDiff]:
    gone = {bag.content: bag for key, bag in before.bags.items() if key not in after.bags}
    diffs, renamed = [], set()
    for key, bag in after.bags.items():
        old = before.bags.get(key)
        if old is None and bag.content in gone:
            old = gone[bag.content]
            renamed.add(old.key)
            diffs.append(BagDiff(key, "renamed", old, bag))
        elif old is None:
            diffs.append(BagDiff(key, "added", None, bag, _scenes(None, bag, store, kind)))
        elif old != bag:
            diffs.append(BagDiff(key, "changed", old, bag, _scenes(old, bag, store, kind)))
    for key, bag in before.bags.items():
        if key not in after.bags and key not in renamed:
            diffs.append(BagDiff(key, "removed", bag, None, _scenes(bag, None, store, kind)))
    return sorted(diffs, key=lambda diff: diff.key)


def _scenes(
    before: LockedBag | None, after: LockedBag | None, store: Store, kind: AnyFormat | None
) -> tuple[SceneDiff, ...] | None:
    if kind is None or kind.samples is None:
        return None
    if before is not None and after is not None and before.artifact == after.artifact:
        return ()
    try:
        old, new = (
            {} if bag is None else kind.samples(store.artifact(bag.artifact)) for bag in (before, after)
        )
    except StoreError:
        return None
    diffs = []
    for name in sorted(old.keys() | new.keys()):
        was, now = old.get(name, {}), new.get(name, {})
        added = tuple(token for token in now if token not in was)
        removed = tuple(token for token in was if token not in now)
        changed = {
            token: tuple(part for part in sorted(now[token]) if now[token][part] != was[token].get(part))
            for token in now
            if token in was and now[token] != was[token]
        }
        if name not in old:
            diffs.append(SceneDiff(name, "added", added=added))
        elif name not in new:
            diffs.append(SceneDiff(name, "removed", removed=removed))
        elif added or removed or changed:
            diffs.append(SceneDiff(name, "changed", added, removed, changed))
    return tuple(diffs)


def _settings(lock: DatasetLock) -> JsonObject:
    """Return recipe field -> value, nested ones with dots."""
    return dict(flatten({name: lock.value[name] for name in (lock.kind, "splits") if name in lock.value}))


def _changes(before: Mapping[str, _V], after: Mapping[str, _V]) -> dict[str, tuple[_V | None, _V | None]]:
    return {
        name: (before.get(name), after.get(name))
        for name in sorted(before.keys() | after.keys())
        if before.get(name) != after.get(name)
    }
