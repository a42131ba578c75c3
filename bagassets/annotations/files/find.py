"""Finding the label files of a recording, with their digests."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from bagassets.annotations.files.label import LabelFile
from bagassets.annotations.files.nuscenes_tables import TABLES
from bagassets.errors import RecordingError
from bagassets.freshness.fingerprints import signature
from bagassets.recipe.model import Rig
from bagassets.recipe.model_annotations import AnnotationFiles, FileTimes, NameTimes, NuScenesTables
from bagassets.recordings.model import RecordingFiles
from bagassets.store.canonical import digest_bytes

__all__ = ["TIMES", "LabelSet", "expand", "find_labels", "label_paths"]

TIMES = "times"
_ENDINGS = {
    "boxes": (".json", ".parquet"),
    "sustechpoints": (".json",),
    "kitti_tracklets": (".xml",),
    "kitti_labels": (".txt",),
    "nuscenes": (".json",),
}


@dataclass(frozen=True)
class LabelSet:
    """The files of one entry of the recipe's `annotation_files` for one recording.

    Attributes:
        source: the path as written in the recipe, which names the source for all recordings.
        place: that path for this recording.
        files: label files sorted by name; empty if there are none.
        is_folder: True if `place` is a folder.
        times: file of stamps, if the recipe names one that exists.
        logfile: log that rows of nuScenes tables must belong to; None for all.
    """

    source: str
    place: Path
    files: tuple[LabelFile, ...]
    is_folder: bool = False
    times: LabelFile | None = None
    logfile: str | None = None

    @property
    def inputs(self) -> dict[str, str]:
        """Name -> digest of each file that is read."""
        is_several = self.is_folder or len(self.files) > 1
        names = {
            file.name: f"{self.source}/{file.name}" if is_several else self.source for file in self.files
        }
        inputs = {f"labels:{names[file.name]}": file.digest for file in self.files}
        if self.times is not None:
            inputs[f"labels:{TIMES} of {self.source}"] = self.times.digest
        return inputs


def find_labels(sources: Iterable[AnnotationFiles], recording: RecordingFiles) -> dict[str, LabelSet]:
    """Return source -> label files beside a recording, with their digests.

    A series without label files of its own has those of its parts. A file is hashed once per process, as long as its
    signature stays the same.

    Raises:
        RecordingError: label files of parts cannot be joined.
    """
    found = {}
    for entry in sources:
        labels = _find(entry, recording)
        found[entry.path] = labels if labels.files else _of_parts(entry, recording, labels)
    return found


def label_paths(rig: Rig, recording: RecordingFiles) -> list[Path]:
    """Return the paths of the files that `find_labels` would read, and paths where some might appear."""
    paths = []
    for entry in rig.annotation_files:
        for one in (recording, *recording.parts):
            place = one.path.parent / expand(entry.path, one)
            paths += [place, *(path for _, path in _files_at(place, entry))]
            times = getattr(entry, "times", None)
            if isinstance(times, FileTimes):
                paths.append(one.path.parent / expand(times.path, one))
    return paths


def expand(template: str, recording: RecordingFiles) -> str:
    """Return a path or name from the recipe with the names of a recording filled in."""
    name = recording.path.name
    # A folder, as in ROS 2, has no extension: `run.1` is its whole name.
    stem = Path(name).stem if recording.parts or recording.path in recording.files else name
    return template.replace("{stem}", stem).replace("{name}", name).replace("{key}", recording.key)


def _find(entry: AnnotationFiles, recording: RecordingFiles) -> LabelSet:
    place = recording.path.parent / expand(entry.path, recording)
    rule = getattr(entry, "times", None)
    times = None
    if isinstance(rule, FileTimes):
        path = recording.path.parent / expand(rule.path, recording)
        times = _file(TIMES, path) if path.is_file() else None
    logfile = getattr(entry, "logfile", None)
    return LabelSet(
        entry.path,
        place,
        tuple(_file(name, path) for name, path in _files_at(place, entry)),
        place.is_dir(),
        times,
        None if logfile is None else expand(logfile, recording),
    )


def _of_parts(entry: AnnotationFiles, recording: RecordingFiles, labels: LabelSet) -> LabelSet:
    """Return the label files of the parts of a recording, or `labels` if there are none.

    Raises:
        RecordingError: they cannot be joined.
    """
    found = [(part, _find(entry, part)) for part in recording.parts]
    found = [(part, one) for part, one in found if one.files]
    if not found:
        return labels
    part, first = found[0]
    times = getattr(entry, "times", None)
    if isinstance(entry, NuScenesTables) or not (times is None or isinstance(times, NameTimes)):
        raise RecordingError(
            f"{first.place}: these labels are those of {part.relative}, which is a part of {recording.relative}; write ones for "
            f"the whole drive to {labels.place}, or keep its parts apart with bags.series."
        )
    files = [replace(file, name=f"{part.path.stem}/{file.name}") for part, one in found for file in one.files]
    return replace(labels, files=tuple(files), is_folder=first.is_folder)


def _files_at(place: Path, entry: AnnotationFiles) -> list[tuple[str, Path]]:
    """Return name within the source and path of each label file, sorted by name."""
    if place.is_file():
        # The name in the recipe: it stays the same if a recording is renamed.
        return [(entry.path.rsplit("/", 1)[-1], place)]
    if not place.is_dir():
        return []
    wanted = TABLES if isinstance(entry, NuScenesTables) else None
    return [
        (path.name, path)
        for path in sorted(place.iterdir())
        if path.suffix.lower() in _ENDINGS[entry.format]
        and (wanted is None or path.name in wanted)
        and path.is_file()
    ]


def _file(name: str, path: Path) -> LabelFile:
    return LabelFile(name, path, _digest(path, tuple(signature(path))))


@lru_cache(maxsize=1 << 16)
def _digest(path: Path, _signature: tuple[int, ...]) -> str:
    return digest_bytes(path.read_bytes())
