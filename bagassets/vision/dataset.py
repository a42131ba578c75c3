"""The vision dataset put together from the sequences of recordings.

Layout::

    recordings/<key>-<id>/metadata.json, transforms.json, trajectories/…
    recordings/<key>-<id>/CAM_FRONT/0000/000000.jpg …, CAM_FRONT/0000.json
    annotations/train.json, train.manifest.json, val.json, …, dataset.lock.json

The folder of a recording never changes once it has its name; the folder `annotations` is exchanged in one
step; then folders of recordings that it no longer names are removed. Killed at any point, it leaves a
complete dataset, the old or the new one.
"""

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from uuid import uuid4

from bagassets.errors import DatasetError
from bagassets.nuscenes.guard import GUARD, guarded, refuse_unexpected
from bagassets.nuscenes.linking import Linker
from bagassets.nuscenes.swap import swap_in
from bagassets.nuscenes.table_file import json_bytes, rows_text, write_joined
from bagassets.recipe.model_splits import Splits
from bagassets.recipe.model_vision import Vision
from bagassets.splits import SplitShare, deal, moves, shares_of
from bagassets.store.artifact import Artifact
from bagassets.store.canonical import digest_bytes, digest_file, digest_json
from bagassets.store.store import Store

__all__ = [
    "ANNOTATIONS",
    "FACTS",
    "FILES",
    "LOCK",
    "SEQUENCES",
    "VisionPart",
    "VisionSummary",
    "assemble_vision",
    "read_vision_lock",
]

ANNOTATIONS = "annotations"
RECORDINGS = "recordings"
LOCK = "dataset.lock.json"
ONE_FILE = "all"
# Files of a `vision_sequences` artifact that the dataset is made from, and which are not part of it.
FACTS, FILES, SEQUENCES = "facts.json", "files.json", "sequences.json"


@dataclass(frozen=True)
class VisionPart:
    """A recording that may enter the dataset.

    Attributes:
        key: partition key.
        content: digest of the recording's content; equal content enters once.
        sequences: digest of its `vision_sequences` artifact.
    """

    key: str
    content: str
    sequences: str


@dataclass(frozen=True)
class VisionSummary:
    """What a vision dataset came to.

    Attributes:
        digest: digest of the merged files; equal digests mean equal datasets.
        folder: the dataset.
        sequences: split -> number of sequences.
        images: split -> number of images.
        shares: what each split got of the recorded time.
        files: way (linked, cloned, copied) -> number of files that were new.
        duplicates: recording that was left out -> recording with the same content.
        moved: recordings that are in another split than before -> the old one and the new one.
        published: files that were put together -> digest.
        entries: the recordings in it, whose files were linked.
    """

    digest: str
    folder: Path
    sequences: Mapping[str, int]
    images: Mapping[str, int]
    shares: Sequence[SplitShare]
    files: Mapping[str, int] = field(default_factory=dict)
    duplicates: Mapping[str, str] = field(default_factory=dict)
    moved: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    published: Mapping[str, str] = field(default_factory=dict)
    entries: Sequence["VisionEntry"] = ()


@dataclass(frozen=True)
class VisionEntry:
    """A recording that does enter."""

    part: VisionPart
    artifact: Artifact
    facts: Mapping[str, Any]
    split: str

    def files(self) -> Iterator[tuple[str, str, str]]:
        """Yield name below the recording's folder, artifact and name there of each file that is linked."""
        for file in self.artifact.entries():
            if file.path not in {FACTS, FILES, SEQUENCES}:
                yield file.path, self.artifact.digest, file.path
        for image in self.artifact.read_json(FILES):
            yield image["filename"], image["artifact"], image["file"]

    def names(self) -> Iterator[str]:
        """Yield the names of its files below the dataset's folder."""
        return (f"{RECORDINGS}/{self.facts['folder']}/{name}" for name, _, _ in self.files())


def assemble_vision(
    parts: Sequence[VisionPart],
    vision: Vision,
    splits: Splits,
    store: Store,
    *,
    dealt: Mapping[str, str] | None = None,
    skipped: Mapping[str, str] | None = None,
    failed: Mapping[str, str] | None = None,
    expected: Mapping[str, str] | None = None,
    suspects: AbstractSet[str] | None = None,
) -> VisionSummary:
    """Bring the dataset in `vision.output` up to date.

    The result depends neither on the order of `parts` nor on what was there before.

    Args:
        parts: the recordings to put in.
        vision: the recipe's `vision`.
        splits: the recipe's `splits`.
        store: where the artifacts are.
        dealt: recording -> its split; None: as the recipe deals just these.
        skipped: recordings that take no part -> why, for the lock file.
        failed: recordings that failed -> why, for the lock file.
        expected: digests of the files that must come out, by name; otherwise nothing is exchanged.
        suspects: files that are not as they were published, which are compared with what belongs there; all
            others are. None: that is not known.

    Raises:
        DatasetError: the folder holds something else, files cannot be written, or other files came out
            than expected.
        StoreError: an artifact is not in the store.
    """
    output = vision.output
    entries, duplicates = _entries(parts, splits, store, dealt)
    split_by_key = {entry.part.key: entry.split for entry in entries}
    durations_s = [(entry.part.key, entry.facts["duration_s"]) for entry in entries]
    shares = shares_of(durations_s, splits, split_by_key)
    _refuse_foreign(output)
    with guarded(output):
        moved = moves(_splits(output), split_by_key)
        linker = Linker(output)
        for entry in entries:
            _put_recording(linker, entry, suspects, store, output)
        new = output / f"{ANNOTATIONS}.tmp-{uuid4().hex}"
        new.mkdir()
        groups = {name: [e for e in entries if e.split == name] for name in sorted(splits.shares)}
        digests = _write_annotations(new, groups, shares, one_file=vision.files == "one")
        refuse_unexpected(new, digests, expected)
        left_out = {"duplicates": duplicates, "skipped": skipped or {}, "failed": failed or {}}
        lock = {
            "format": 1,
            "vision": vision.model_dump(mode="json", exclude={"output"}),
            "splits": splits.model_dump(mode="json"),
            "bags": [_lock_row(entry) for entry in entries],
            **{why: dict(sorted(keys.items())) for why, keys in left_out.items()},
            "files": digests,
        }
        (new / LOCK).write_bytes(json_bytes(lock))
        swap_in(new, output / ANNOTATIONS)
        _remove_leftovers(output, {entry.facts["folder"] for entry in entries})
    return VisionSummary(
        digest=digest_json(digests),
        folder=output,
        sequences={name: sum(e.facts["sequences"] for e in group) for name, group in groups.items()},
        images={name: sum(e.facts["images"] for e in group) for name, group in groups.items()},
        shares=shares,
        files=dict(sorted(linker.counts.items())),
        duplicates=duplicates,
        moved=moved,
        published={
            **{f"{ANNOTATIONS}/{name}": digest for name, digest in digests.items()},
            f"{ANNOTATIONS}/{LOCK}": digest_bytes(json_bytes(lock)),
        },
        entries=tuple(entries),
    )


def read_vision_lock(output: Path) -> dict[str, Any] | None:
    """Return the lock file of a dataset, or None if there is no such dataset."""
    try:
        lock: dict[str, Any] = json.loads((output / ANNOTATIONS / LOCK).read_bytes())
        lock["bags"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise DatasetError(
            f"{output / ANNOTATIONS / LOCK}: cannot be read ({err}); remove the folder and build the dataset again."
        ) from err
    return lock


def _splits(output: Path) -> dict[str, str]:
    """Return recording -> split of the dataset that is there; nothing if its lock was torn or replaced."""
    try:
        lock = read_vision_lock(output)
    except DatasetError:
        return {}
    return {} if lock is None else {bag["key"]: bag["split"] for bag in lock["bags"]}


def _entries(
    parts: Sequence[VisionPart], splits: Splits, store: Store, dealt: Mapping[str, str] | None
) -> tuple[list[VisionEntry], dict[str, str]]:
    """Return the recordings that enter in the order of their keys, and copies -> what stands for them."""
    chosen: dict[str, VisionPart] = {}
    duplicates: dict[str, str] = {}
    for part in sorted(parts, key=lambda part: part.key):
        first = chosen.setdefault(part.content, part)
        if first is not part:
            duplicates[part.key] = first.key
    entries = []
    dealt = deal([part.key for part in chosen.values()], splits) if dealt is None else dealt
    for part in chosen.values():
        artifact = store.artifact(part.sequences)
        entries.append(VisionEntry(part, artifact, artifact.read_json(FACTS), dealt[part.key]))
    return entries, duplicates


def _put_recording(
    linker: Linker, entry: VisionEntry, suspects: AbstractSet[str] | None, store: Store, output: Path
) -> None:
    """Make the folder of a recording appear, whole; of one that is there, mend the suspects, or all files."""
    folder = f"{RECORDINGS}/{entry.facts['folder']}"
    is_there = (output / folder).is_dir()
    if is_there and suspects is not None and not any(name.startswith(f"{folder}/") for name in suspects):
        return
    temporary = f"{folder}.tmp-{uuid4().hex}"
    if not is_there:
        (output / temporary).mkdir(parents=True)
    sources: dict[str, str] = {}
    for name, digest, file in entry.files():
        if digest not in sources:
            sources[digest] = str(store.artifact(digest).files)
        if not is_there:
            linker.put(f"{sources[digest]}/{file}", f"{temporary}/{name}")
        elif suspects is None or f"{folder}/{name}" in suspects:
            linker.mend(f"{sources[digest]}/{file}", f"{folder}/{name}")
    if not is_there:
        (output / temporary).rename(output / folder)


def _write_annotations(
    folder: Path, groups: Mapping[str, Sequence[VisionEntry]], shares: Sequence[SplitShare], *, one_file: bool
) -> dict[str, str]:
    """Write the merged files and a manifest for each split; return file -> digest."""
    merged = {ONE_FILE: [entry for group in groups.values() for entry in group]} if one_file else groups
    for name, group in merged.items():
        with (folder / f"{name}.json").open("wb") as file:
            ordered = sorted(group, key=lambda entry: entry.part.key)
            write_joined(file, (rows_text(entry.artifact.path(SEQUENCES)) for entry in ordered))
    digests = {f"{name}.json": digest_file(folder / f"{name}.json") for name in merged}
    for share in shares:
        manifest = json_bytes(_manifest(share, groups[share.name]))
        (folder / f"{share.name}.manifest.json").write_bytes(manifest)
        digests[f"{share.name}.manifest.json"] = digest_bytes(manifest)
    return dict(sorted(digests.items()))


def _manifest(share: SplitShare, entries: Sequence[VisionEntry]) -> dict[str, Any]:
    return {
        "split": share.name,
        **share.as_json(),
        "sequences": sum(entry.facts["sequences"] for entry in entries),
        "images": sum(entry.facts["images"] for entry in entries),
        "bags": [
            {
                "recording": entry.part.key,
                "rig": entry.facts["rig"],
                "folder": f"{RECORDINGS}/{entry.facts['folder']}",
                "sequences": entry.facts["sequences"],
                "images": entry.facts["images"],
                "duration_s": entry.facts["duration_s"],
                "daylight": entry.facts["daylight"],
                "start": entry.facts["start"],
            }
            for entry in entries
        ],
    }


def _lock_row(entry: VisionEntry) -> dict[str, Any]:
    return {
        "key": entry.part.key,
        "content": entry.part.content,
        "vision_sequences": entry.part.sequences,
        "split": entry.split,
        "folder": entry.facts["folder"],
        "sequences": entry.facts["sequences"],
    }


def _remove_leftovers(output: Path, current: set[str]) -> None:
    """Remove folders that the dataset does not name: old recordings, and what a killed run left."""
    for folder in sorted((output / RECORDINGS).glob("*")):
        if folder.name not in current:
            shutil.rmtree(folder, ignore_errors=True)
    for folder in sorted(output.glob(f"{ANNOTATIONS}.tmp-*")):
        shutil.rmtree(folder, ignore_errors=True)


def _refuse_foreign(output: Path) -> None:
    if (output / GUARD).exists():  # a run of ours was here, perhaps one that was killed
        return
    for folder in (output / ANNOTATIONS, output / RECORDINGS):
        if folder.exists() and any(folder.iterdir()):
            raise DatasetError(
                f"{folder}: this folder was not made by bagassets, so it is left alone; choose another vision.output."
            )
