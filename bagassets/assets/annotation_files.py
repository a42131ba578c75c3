"""Boxes in files beside the recording: the part of the asset `annotations` that reads them."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

from bagassets.annotations.collect import BoxCollector, Place
from bagassets.annotations.files.box_files import read_json_boxes, read_parquet_boxes
from bagassets.annotations.files.find import LabelSet
from bagassets.annotations.files.kitti_labels import read_kitti_labels
from bagassets.annotations.files.kitti_tracklets import read_kitti_tracklets
from bagassets.annotations.files.label import Label, LabelFile, UnreadableLabelsError
from bagassets.annotations.files.nuscenes_tables import TableSet, read_tables
from bagassets.annotations.files.sustechpoints import read_sustechpoints
from bagassets.annotations.files.times import FrameClock, named_frames, numbered_frames, read_times
from bagassets.annotations.frames import DATASET_FRAME
from bagassets.assets.asset import Facts, by_digest, inlined, omitted
from bagassets.assets.channel import Counts
from bagassets.errors import ChangedWhileReadError, DecodeError, RecipeError, RecordingError
from bagassets.json_types import JsonObject
from bagassets.recipe.model_annotations import (
    AnnotationFiles,
    BoxFiles,
    FileTimes,
    FrameTimes,
    KittiLabels,
    KittiTracklets,
    NameTimes,
    NuScenesTables,
    SustechFolder,
    TopicTimes,
)
from bagassets.recipe.model_base import Clock
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.recording import Recording
from bagassets.store.canonical import digest_bytes

__all__ = ["Labels", "add_labels", "labels_of"]

Reader = Callable[[bytes], Iterator[Label]]


@dataclass(frozen=True)
class Labels:
    """An entry of the recipe's `annotation_files`, and a recording's label files for it.

    Attributes:
        folder: True if the files are in a folder of their own.
        span_ns: first and last time of the recording's channels; None if unknown.
        entry: the entry in the recipe.
        found: the files.
        logfile: log that rows of nuScenes tables must belong to.
    """

    folder: bool
    span_ns: tuple[int, int] | None
    entry: AnnotationFiles = inlined(without=("path", "missing"))
    found: LabelSet = by_digest()
    logfile: str | None = omitted()

    @property
    def frame(self) -> str | None:
        """The frame of all boxes, if it is known without reading them."""
        if self.entry.frame is None and isinstance(self.entry, NuScenesTables):
            return DATASET_FRAME
        return self.entry.frame

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that give their times."""
        times = _times_of(self.entry)
        return (times.topic,) if isinstance(times, TopicTimes) else ()


def labels_of(
    entries: Iterable[AnnotationFiles], topics: Iterable[str], clock: Clock, facts: Facts
) -> tuple[dict[str, Labels], tuple[str, ...]]:
    """Return path in the recipe -> labels of a recording, and the paths for which it has none.

    Args:
        entries: entries of the recipe's `annotation_files`.
        topics: topics of the rig's channels, whether or not the recording has them.
        clock: which time of a message counts.
        facts: facts about the recording.

    Raises:
        RecordingError: labels that the recipe requires are missing.
        RecipeError: the topic or file with their times is missing.
    """
    entries = tuple(entries)
    labels: dict[str, Labels] = {}
    absent = []
    span_ns = _span_ns(topics, facts.inventory, clock)
    sets = facts.labels(entries)
    for entry in entries:
        found = sets[entry.path]
        if found.files:
            _require_times(entry, found, facts.inventory)
            labels[entry.path] = Labels(found.is_folder, span_ns, entry, found, found.logfile)
        elif entry.missing == "refuse":
            raise RecordingError(
                f"{found.place}: there are no labels of the format {entry.format}, which the recipe requires "
                "(`missing: refuse`); put them there, or correct rigs[].annotation_files[].path."
            )
        else:
            absent.append(entry.path)
    return labels, tuple(sorted(absent))


def _times_of(entry: AnnotationFiles) -> FrameTimes | None:
    """Return where the times of frames come from; None if each box has its own."""
    return None if isinstance(entry, BoxFiles | NuScenesTables) else entry.times


def _require_times(entry: AnnotationFiles, found: LabelSet, inventory: Inventory) -> None:
    times = _times_of(entry)
    if isinstance(times, TopicTimes) and not inventory.has(times.topic):
        raise RecipeError(
            f"rigs[].annotation_files: the recording has no messages on {times.topic}, which gives the times of the "
            f"frames of {entry.path}; correct `times`."
        )
    if isinstance(times, FileTimes) and found.times is None:
        raise RecipeError(
            f"rigs[].annotation_files: there is no file of times {times.path} for {found.place}; correct `times`."
        )


def _span_ns(topics: Iterable[str], inventory: Inventory, clock: Clock) -> tuple[int, int] | None:
    """Return first and last time of messages in topics; None if no message has a header stamp."""
    records = [inventory.topics[topic] for topic in topics if inventory.has(topic)]
    if clock == "log":
        spans = [(record.first_ns, record.last_ns) for record in records]
    else:
        spans = [(record.first_stamp_ns, record.last_stamp_ns) for record in records]
    firsts = [first for first, _ in spans if first is not None]
    lasts = [last for _, last in spans if last is not None]
    return (min(firsts), max(lasts)) if firsts and lasts else None


def add_labels(
    sources: Mapping[str, Labels],
    recording: Recording,
    clock: Clock,
    collector: BoxCollector,
) -> JsonObject:
    """Add the boxes of all label files to the collector; return counts of files and of entries that are no boxes.

    Raises:
        DecodeError: a file does not parse, or a box cannot be used, and the recipe says `refuse`.
        ChangedWhileReadError: a file is not the one that was digested.
    """
    counts = {}
    for source, labels in sorted(sources.items()):
        frames = _frame_clock(labels, recording, clock)
        files, ignored = Counts(), 0
        first: dict[str, str] = {}
        for file, read in _readers(labels):
            files.read += 1
            try:
                content = list(read(_content(file)))
            except UnreadableLabelsError as err:
                if labels.entry.bad_files == "refuse":
                    raise DecodeError(
                        f"{file.path}{_line(err)}: the file {err}; fix it, or say `bad_files: count` in the recipe."
                    ) from err
                files.lose(str(err))
                first.setdefault(str(err), f"{file.name}{_line(err)}")
                continue
            files.written += 1
            ignored += sum(_add(label, file, frames, labels.entry, collector) for label in content)
        counts[source] = {"files": {**files.as_json(), "first": first}, "ignored": ignored}
    return counts


def _content(file: LabelFile) -> bytes:
    """Return the content of a file, which must match the digest in the action."""
    try:
        data = file.path.read_bytes()
    except OSError as err:
        raise ChangedWhileReadError(
            f"{file.path}: the labels cannot be read ({err.strerror}); build again."
        ) from err
    if digest_bytes(data) != file.digest:
        raise ChangedWhileReadError(f"{file.path}: the labels changed while they were read; build again.")
    return data


def _line(err: UnreadableLabelsError) -> str:
    return f":{err.line}" if err.line else ""


def _add(
    label: Label,
    file: LabelFile,
    frames: FrameClock | None,
    entry: AnnotationFiles,
    collector: BoxCollector,
) -> bool:
    """Add one label to the collector; return True if it is deliberately no box."""
    source = entry.path
    place = Place(f"{file.name}:{label.line}", f"{file.path}:{label.line}")
    if label.problem is not None:
        collector.lose_undecoded(source, label.problem, place)
        return False
    if label.box is None:
        return True
    stamp_ns: int | None = label.box.stamp_ns
    if frames is not None:
        stamp_ns = frames(file.name, label.frame_number)
        if stamp_ns is None:
            collector.lose_undecoded(source, "its frame has no time", place)
            return False
    stamp_ns = (stamp_ns or 0) + round(entry.offset_s * 1e9)
    frame = label.box.frame_id or (DATASET_FRAME if isinstance(entry, NuScenesTables) else "")
    collector.add(replace(label.box, stamp_ns=stamp_ns, frame_id=frame, source=source), place)
    return False


def _readers(labels: Labels) -> Iterator[tuple[LabelFile, Reader]]:
    """Yield the files of a source in order, each with the function that reads it."""
    files = labels.found.files
    match labels.entry:
        case NuScenesTables():
            tables = TableSet(labels.logfile)
            # The tables that others refer to come first.
            for file in sorted(files, key=lambda file: (file.name == "sample_annotation.json", file.name)):
                if file.name == "sample_annotation.json":
                    yield file, partial(read_tables, tables)
                else:
                    yield file, partial(_take_table, tables, file.name)
        case BoxFiles():
            for file in files:
                is_parquet = file.path.suffix.lower() == ".parquet"
                yield file, read_parquet_boxes if is_parquet else read_json_boxes
        case SustechFolder():
            yield from ((file, read_sustechpoints) for file in files)
        case KittiTracklets():
            yield from ((file, read_kitti_tracklets) for file in files)
        case KittiLabels():
            reader = partial(read_kitti_labels, tracking=not labels.folder)
            yield from ((file, reader) for file in files)


def _take_table(tables: TableSet, name: str, data: bytes) -> Iterator[Label]:
    tables.add(name, data)
    return iter(())


def _frame_clock(labels: Labels, recording: Recording, clock: Clock) -> FrameClock | None:
    """Return the times of frames; None if each box has its own.

    Raises:
        DecodeError: the file of times does not parse.
    """
    times, found = _times_of(labels.entry), labels.found
    if times is None:
        return None
    if isinstance(times, NameTimes):
        return named_frames(times.unit)
    if isinstance(times, TopicTimes):
        return numbered_frames(_stamps_ns(recording, times.topic, clock), times.first)
    if found.times is None:
        raise DecodeError(f"{found.place}: its file of times is gone; build again.")
    try:
        stamps = read_times(_content(found.times))
    except UnreadableLabelsError as err:
        raise DecodeError(f"{found.times.path}{_line(err)}: {err}; fix the file of times.") from err
    return numbered_frames(stamps, times.first)


def _stamps_ns(recording: Recording, topic: str, clock: Clock) -> list[int]:
    stamps = []
    for message in recording.messages([topic]):
        header = None if clock == "log" else recording.topics[topic].header(message.data)
        stamps.append(message.log_time_ns if header is None else header[0])
    return stamps
