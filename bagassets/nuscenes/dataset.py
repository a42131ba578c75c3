"""A nuScenes dataset put together from the tables of recordings.

Files appear first, under names that contain the digest of their content; then the folder of tables
is exchanged; then files that only the old tables named are removed. Killed at any point, it leaves
a complete dataset, the old or the new one, and the next run removes what the killed one left.
"""

import json
import shutil
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from uuid import uuid4

from bagassets.errors import DatasetError
from bagassets.nuscenes.blank_map import blank_png
from bagassets.nuscenes.dataset_tables import LOCK, BagPart, Entry, WrittenTables, write_tables
from bagassets.nuscenes.filenames import recording_of
from bagassets.nuscenes.guard import guarded, refuse_unexpected
from bagassets.nuscenes.linking import Linker
from bagassets.nuscenes.shared_rows import MAP_FILE
from bagassets.nuscenes.stale import named_files, remove_files
from bagassets.nuscenes.swap import swap_in
from bagassets.nuscenes.table_file import json_bytes
from bagassets.recipe.model import NuScenes
from bagassets.recipe.model_splits import Splits
from bagassets.splits import SplitShare, deal, moves
from bagassets.store.canonical import digest_bytes, digest_file, digest_json
from bagassets.store.store import Store

__all__ = ["BagPart", "DatasetSummary", "assemble", "read_lock"]

MAP_SIZE_PX = 64
_FOLDERS = ("samples", "sweeps", "maps")


@dataclass(frozen=True)
class DatasetSummary:
    """What a dataset came to.

    Attributes:
        digest: digest of all tables; equal digests mean equal datasets.
        folder: the version folder.
        rows: table -> number of rows.
        splits: name in splits.json -> number of scenes.
        shares: what each split of the recipe got of the driven time.
        files: way (linked, cloned, copied, removed; kept: looked at and found in place) -> number of files.
        duplicates: recording that was left out -> recording with the same content.
        changed: the tables were exchanged; False if they were the same already.
        moved: recordings that are in another split than before -> the old one and the new one.
        published: files that were put together -> digest.
        entries: the recordings in it, whose files were linked.
    """

    digest: str
    folder: Path
    rows: Mapping[str, int]
    splits: Mapping[str, int]
    shares: Sequence[SplitShare]
    files: Mapping[str, int] = field(default_factory=dict)
    duplicates: Mapping[str, str] = field(default_factory=dict)
    changed: bool = True
    moved: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    published: Mapping[str, str] = field(default_factory=dict)
    entries: Sequence[Entry] = ()


def assemble(
    parts: Sequence[BagPart],
    settings: NuScenes,
    store: Store,
    output: Path,
    *,
    splits: Splits | None = None,
    dealt: Mapping[str, str] | None = None,
    skipped: Mapping[str, str] | None = None,
    failed: Mapping[str, str] | None = None,
    expected: Mapping[str, str] | None = None,
    suspects: AbstractSet[str] | None = None,
) -> DatasetSummary:
    """Bring the dataset in the dataroot `output` up to date.

    The result does not depend on the order of `parts`, nor on what was in the dataroot before. Without
    any recording it is a dataset of empty tables, which the devkit loads.

    Args:
        parts: the recordings to put in.
        settings: the recipe's `nuscenes`.
        store: where the artifacts are.
        output: the dataroot.
        splits: the recipe's `splits`; None: its defaults.
        dealt: recording -> its split; None: as the recipe deals just these.
        skipped: recordings that take no part -> why, for the lock file.
        failed: recordings that failed -> why, for the lock file.
        expected: digests of the files that must come out, by name; otherwise nothing is exchanged.
        suspects: files that are not as they were published, which are compared with what belongs there; all
            others are. None: that is not known.

    Raises:
        DatasetError: the version folder holds something else, files cannot be written, or other tables
            came out than expected.
        StoreError: an artifact is not in the store.
    """
    splits = splits or Splits()
    chosen, duplicates = _without_copies(parts)
    dealt = deal([part.key for part in chosen], splits) if dealt is None else dealt
    entries = [Entry(part, store.artifact(part.tables)) for part in chosen]
    current = output / settings.version
    with guarded(output):
        if suspects is None:  # else it is on record that the folder is ours, whatever became of its lock
            _refuse_foreign(current)
        split_before = _splits(current)
        leftovers = sorted(output.glob(f"{settings.version}.tmp-*"))
        new = output / f"{settings.version}.tmp-{uuid4().hex}"
        new.mkdir()
        written = write_tables(new, entries, settings, splits, dealt)
        refuse_unexpected(new, written.digests, expected)
        left_out = {"duplicates": duplicates, "skipped": skipped or {}, "failed": failed or {}}
        lock = _lock(settings, splits, entries, written, left_out)
        (new / LOCK).write_bytes(json_bytes(lock))
        linker = Linker(output, compares=suspects is None)
        is_known = suspects is not None and _name(current / LOCK) not in suspects
        _put_files(
            linker, entries, _bags(current) if is_known else {}, suspects or frozenset(), store, output
        )
        _put_map(output)
        changed = not _same_tables(new, current, written.digests)
        old = swap_in(new, current) if changed else new
        removed = _retire(output, current, [*leftovers, *([old] if old is not None else [])])
    files = {**linker.counts, "removed": removed}
    return DatasetSummary(
        digest=digest_json(written.digests),
        folder=current,
        rows=written.rows,
        splits={name: len(scenes) for name, scenes in written.splits.items()},
        shares=written.shares,
        files=dict(sorted(files.items())),
        duplicates=duplicates,
        changed=changed,
        moved=moves(split_before, written.split_of),
        published={
            **{f"{settings.version}/{name}": digest for name, digest in written.digests.items()},
            f"{settings.version}/{LOCK}": digest_bytes(json_bytes(lock)),
            MAP_FILE: digest_bytes(_map_picture()),
        },
        entries=tuple(entries),
    )


def read_lock(output: Path, version: str) -> dict[str, Any] | None:
    """Return the lock file of a dataset, or None if there is no such dataset."""
    try:
        lock: dict[str, Any] = json.loads((output / version / LOCK).read_bytes())
        lock["bags"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise DatasetError(
            f"{output / version / LOCK}: cannot be read ({err}); remove the folder and build the dataset again."
        ) from err
    return lock


def _without_copies(parts: Sequence[BagPart]) -> tuple[list[BagPart], dict[str, str]]:
    """Return the parts in the order of their keys, and those left out -> the one that stands for them."""
    chosen: dict[str, BagPart] = {}
    duplicates: dict[str, str] = {}
    for part in sorted(parts, key=lambda part: part.key):
        first = chosen.setdefault(part.content, part)
        if first is not part:
            duplicates[part.key] = first.key
    return list(chosen.values()), duplicates


def _lock(
    settings: NuScenes,
    splits: Splits,
    entries: Sequence[Entry],
    written: WrittenTables,
    left_out: Mapping[str, Mapping[str, str]],
) -> dict[str, Any]:
    """Return everything that this dataset can be made from again, and what is not in it and why."""
    return {
        "format": 1,
        "nuscenes": settings.model_dump(mode="json", exclude={"output"}),
        "splits": splits.model_dump(mode="json"),
        "shares": {share.name: share.as_json() for share in written.shares},
        "bags": [
            {
                "key": entry.part.key,
                "content": entry.part.content,
                "nuscenes_tables": entry.part.tables,
                "rig": entry.facts["rig"],
                "split": written.split_of[entry.part.key],
                "scenes": entry.facts["counts"]["scenes"],
                "samples": entry.facts["counts"]["samples"],
            }
            for entry in entries
        ],
        **{why: dict(sorted(keys.items())) for why, keys in left_out.items()},
        "tables": written.digests,
    }


def _put_files(
    linker: Linker,
    entries: Sequence[Entry],
    known: Mapping[str, str],
    suspects: AbstractSet[str],
    store: Store,
    output: Path,
) -> None:
    """Link the files of recordings that are not `known` to be there with the same tables, and mend suspects of all."""
    for folder in _FOLDERS:
        (output / folder).mkdir(exist_ok=True)
    suspicious = {recording_of(name) for name in suspects}
    for entry in entries:
        is_there = known.get(entry.part.key) == entry.part.tables
        if is_there and entry.part.key not in suspicious:
            continue
        folders: dict[str, str] = {}
        for file in entry.files():
            digest, name = file["artifact"], file["filename"]
            if is_there and name not in suspects:
                continue
            if digest not in folders:
                folders[digest] = str(store.artifact(digest).files)
            put = linker.mend if name in suspects else linker.put
            put(f"{folders[digest]}/{file['file']}", name)


def _put_map(output: Path) -> None:
    picture = _map_picture()
    path = output / MAP_FILE
    if not path.is_file() or path.read_bytes() != picture:
        temporary = path.with_name(f".{path.name}.{uuid4().hex}")
        temporary.write_bytes(picture)
        temporary.replace(path)


def _map_picture() -> bytes:
    return blank_png(MAP_SIZE_PX, MAP_SIZE_PX)


def _same_tables(new: Path, current: Path, digests: Mapping[str, str]) -> bool:
    """Tell whether `current` has all that `new` has, byte for byte."""
    try:
        return (current / LOCK).read_bytes() == (new / LOCK).read_bytes() and all(
            (current / name).stat().st_size == (new / name).stat().st_size
            and digest_file(current / name) == digest
            for name, digest in digests.items()
        )
    except OSError:
        return False


def _retire(output: Path, current: Path, retired: Sequence[Path]) -> int:
    """Remove folders of old tables and the files that no tables name any more; return their number."""
    others = [path.parent for path in sorted(output.glob("*/sample_data.json")) if path.parent not in retired]
    now = _bags(current)
    removed = 0
    for folder in retired:
        # Recordings whose tables are the same now as then have the same files.
        gone = {key for key, tables in _bags(folder).items() if now.get(key) != tables}
        stale = named_files(folder, gone) if gone else set()
        for other in others if stale else ():
            stale -= named_files(other, gone)
        removed += remove_files(output, stale)
        shutil.rmtree(folder, ignore_errors=True)
    return removed


def _bags(folder: Path) -> dict[str, str]:
    """Return recording -> digest of its tables of a version folder; nothing if it never got its lock."""
    return {bag["key"]: bag["nuscenes_tables"] for bag in _locked(folder)}


def _splits(folder: Path) -> dict[str, str]:
    """Return recording -> split of a version folder; nothing if it never got its lock."""
    return {bag["key"]: bag["split"] for bag in _locked(folder)}


def _locked(folder: Path) -> Sequence[Mapping[str, Any]]:
    try:
        lock = read_lock(folder.parent, folder.name)
    except DatasetError:  # torn by a power loss, in a folder that is removed anyway
        return ()
    return () if lock is None else lock["bags"]


def _name(path: Path) -> str:
    """Return the name of a file in a version folder as seen from the dataroot."""
    return f"{path.parent.name}/{path.name}"


def _refuse_foreign(current: Path) -> None:
    if current.exists() and not (current / LOCK).is_file() and any(current.iterdir()):
        raise DatasetError(
            f"{current}: this folder was not made by bagassets (it has no {LOCK}), so it is left alone; "
            "choose another nuscenes.output or nuscenes.version."
        )
