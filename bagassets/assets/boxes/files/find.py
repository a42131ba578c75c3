"""Finding the label files of a recording, with their digests."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from bagassets.assets.boxes.files.label import LabelFile
from bagassets.assets.boxes.files.nuscenes_tables import TABLES
from bagassets.base.errors import RecordingError
from bagassets.base.fingerprints import signature
from bagassets.recipe.model import Rig
from bagassets.recipe.model_annotations import AnnotationFiles, FileTimes, NuScenesTables, TopicTimes
from bagassets.recordings.model import RecordingFiles
from bagassets.store.canonical import digest_bytes

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
        is_series: True if the recording is a series.
        logfiles_of_parts: of a series, the logs that count where the tables have none of the whole drive.
        part: key that the part of a series would have alone, if these are the files of one.
        span_ns: first and last log time of that part; None if they are not known.
        frames: number of the first message of that part on the topic that gives the times, and how many it has; None if no
            topic does.
        parts: of a series without label files of its own, those of each part.
    """

    source: str
    place: Path
    files: tuple[LabelFile, ...]
    is_folder: bool = False
    times: LabelFile | None = None
    logfile: str | None = None
    is_series: bool = False
    logfiles_of_parts: tuple[str, ...] = ()
    part: str = ""
    span_ns: tuple[int, int] | None = None
    frames: tuple[int, int] | None = None
    parts: tuple["LabelSet", ...] = ()

    @property
    def inputs(self) -> dict[str, str]:
        """Name -> digest of each file that is read."""
        is_several = self.is_folder or len(self.files) > 1
        source = f"{self.source}/{self.part}" if self.part else self.source
        names = {file.name: f"{source}/{file.name}" if is_several else source for file in self.files}
        inputs = {f"labels:{names[file.name]}": file.digest for file in self.files}
        if self.times is not None:
            inputs[f"labels:{TIMES} of {source}"] = self.times.digest
        for part in self.parts:
            inputs |= part.inputs
        return inputs


def find_labels(sources: Iterable[AnnotationFiles], recording: RecordingFiles) -> dict[str, LabelSet]:
    """Return source -> label files beside a recording, with their digests.

    A series without label files of its own has those of its parts. A file is hashed once per process, as long as its
    signature stays the same.

    Raises:
        RecordingError: a part that has label files cannot be read.
    """
    found = {}
    for entry in sources:
        labels = _find(entry, recording)
        if not labels.files:
            labels = replace(labels, parts=_of_parts(entry, recording))
        found[entry.path] = labels
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
    logfiles = [expand(logfile or "", one) for one in (recording, *recording.parts)]
    return LabelSet(
        entry.path,
        place,
        tuple(_file(name, path) for name, path in _files_at(place, entry)),
        place.is_dir(),
        times,
        None if logfile is None else logfiles[0],
        bool(recording.parts),
        tuple(dict.fromkeys(name for name in logfiles if name != logfiles[0])),
    )


def _of_parts(entry: AnnotationFiles, recording: RecordingFiles) -> tuple[LabelSet, ...]:
    """Return the label files of each part of a series; nothing if there are none."""
    found = [replace(_find(entry, part), is_series=True, part=part.key) for part in recording.parts]
    if not any(labels.files for labels in found):
        return ()
    times, first = getattr(entry, "times", None), 0
    spans_ns = [_span_ns(part.path, tuple(signature(part.path))) for part in recording.parts]
    for number in sorted(range(len(found)), key=lambda number: spans_ns[number] or (0, 0)):
        labels, part = found[number], recording.parts[number].path
        if isinstance(times, TopicTimes):
            count = _counts(part, tuple(signature(part))).get(times.topic, 0)
            found[number] = replace(labels, frames=(first, count))
            first += count
        elif labels.files:
            found[number] = replace(labels, span_ns=spans_ns[number])
    return tuple(found)


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


@lru_cache(maxsize=1 << 12)
def _counts(part: Path, _signature: tuple[int, ...]) -> Mapping[str, int]:
    """Return topic -> number of messages of a part."""
    from bagassets.recordings.open import open_recording  # noqa: PLC0415  (few have label files of parts)

    with open_recording(part) as opened:
        return {name: topic.count for name, topic in opened.topics.items()}


@lru_cache(maxsize=1 << 12)
def _span_ns(part: Path, _signature: tuple[int, ...]) -> tuple[int, int] | None:
    """Return first and last log time of a part, or None if its index does not tell."""
    from bagassets.recordings.part_facts import ForNow, part_facts  # noqa: PLC0415  (few have label files of parts)

    facts = part_facts(part)
    if isinstance(facts, ForNow):
        raise RecordingError(f"{part}: it cannot be read at the moment ({facts}).")
    return None if isinstance(facts, str) else (facts.start_ns, facts.end_ns)
