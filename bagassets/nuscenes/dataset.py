"""A nuScenes dataset put together from the tables of recordings.

Files appear first, under names that contain the digest of their content; then the folder of tables
is exchanged; then files that only the old tables named are removed. Killed at any point, it leaves
a complete dataset, the old or the new one, and the next run removes what the killed one left.
"""

import json
import os
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from uuid import uuid4

from bagassets.errors import DatasetError
from bagassets.nuscenes.blank_map import blank_png
from bagassets.nuscenes.dataset_tables import LOCK, BagPart, Entry, WrittenTables, write_tables
from bagassets.nuscenes.guard import guarded, refuse_unexpected
from bagassets.nuscenes.linking import Linker
from bagassets.nuscenes.shared_rows import MAP_FILE
from bagassets.nuscenes.stale import named_files, remove_files
from bagassets.nuscenes.swap import swap_in
from bagassets.nuscenes.table_file import json_bytes
from bagassets.recipe.model import NuScenes
from bagassets.recipe.model_splits import Splits
from bagassets.splits import SplitShare, deal, moves
from bagassets.store.canonical import digest_json
from bagassets.store.store import Store

__all__ = ["BagPart", "DatasetSummary", "assemble", "is_untouched", "read_lock"]

MAP_SIZE_PX = 64
_FOLDERS = ("samples", "sweeps", "maps")
# Times of files are as coarse as the kernel's clock; those of old file systems are coarser, then every
# file is looked at.
_TICK_S, _TICKS = 0.005, 20


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
        linker = Linker(output)
        known = {} if _touched_by_others(output, current) else _bags(current)
        _put_files(linker, [e for e in entries if known.get(e.part.key) != e.part.tables], store, output)
        _put_map(output)
        changed = not _same_tables(new, current)
        old = swap_in(new, current) if changed else new
        removed = _retire(output, current, [*leftovers, *([old] if old is not None else [])])
        _date_lock(output, current)
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
    )


def read_lock(output: Path, version: str) -> dict[str, Any] | None:
    """Return the lock file of a dataset, or None if there is no such dataset."""
    try:
        lock: dict[str, Any] = json.loads((output / version / LOCK).read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as err:
        raise DatasetError(
            f"{output / version / LOCK}: cannot be read ({err}); remove the folder and build the dataset again."
        ) from err
    return lock


def is_untouched(output: Path, version: str) -> bool:
    """Tell whether a dataset is there and no file of it came or went since it was made; its bytes are not read."""
    current = output / version
    return (current / LOCK).is_file() and not _touched_by_others(output, current)


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


def _put_files(linker: Linker, entries: Sequence[Entry], store: Store, output: Path) -> None:
    for folder in _FOLDERS:
        (output / folder).mkdir(exist_ok=True)
    for entry in entries:
        folders: dict[str, str] = {}
        for file in entry.files():
            digest = file["artifact"]
            if digest not in folders:
                folders[digest] = str(store.artifact(digest).files)
            linker.put(f"{folders[digest]}/{file['file']}", file["filename"])


def _put_map(output: Path) -> None:
    picture = blank_png(MAP_SIZE_PX, MAP_SIZE_PX)
    path = output / MAP_FILE
    if not path.is_file() or path.read_bytes() != picture:
        temporary = path.with_name(f".{path.name}.{uuid4().hex}")
        temporary.write_bytes(picture)
        temporary.replace(path)


def _same_tables(new: Path, current: Path) -> bool:
    """Tell whether `current` has all that `new` has; bytes that changed in place are found by `verify`."""
    try:
        same = (current / LOCK).read_bytes() == (new / LOCK).read_bytes()
        return same and all(
            (current / path.name).stat().st_size == path.stat().st_size for path in new.iterdir()
        )
    except FileNotFoundError:
        return False


def _date_lock(output: Path, current: Path) -> None:
    """Give the lock a time later than all that was done here: see `_touched_by_others`."""
    for _ in range(_TICKS):
        (current / LOCK).touch()
        if not _touched_by_others(output, current):
            return
        time.sleep(_TICK_S)


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


def _touched_by_others(output: Path, current: Path) -> bool:
    """Tell whether files may have come or gone since the dataset was made.

    If not, those of recordings that stay the same need no look: with millions of files that is
    what an update would cost. A folder's time of change is that of its last new or removed entry.
    """
    folders = [current, *(output / name for name in _FOLDERS)]
    try:
        made_ns = (current / LOCK).stat().st_mtime_ns
        channels = [Path(entry.path) for folder in folders for entry in os.scandir(folder) if entry.is_dir()]
        return any(folder.stat().st_mtime_ns >= made_ns for folder in (*folders, *channels))
    except FileNotFoundError:
        return True


def _refuse_foreign(current: Path) -> None:
    if current.exists() and not (current / LOCK).is_file() and any(current.iterdir()):
        raise DatasetError(
            f"{current}: this folder was not made by bagassets (it has no {LOCK}), so it is left alone; "
            "choose another nuscenes.output or nuscenes.version."
        )
