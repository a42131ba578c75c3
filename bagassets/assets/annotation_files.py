"""Boxes in files beside the recording: the part of the asset `annotations` that reads them."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from bagassets.assets.annotation_frames import ReadingParams, between_origins
from bagassets.assets.asset import Facts, by_digest, inlined, omitted
from bagassets.assets.boxes.collect import BoxCollector, Place
from bagassets.assets.boxes.files.box_files import read_json_boxes, read_parquet_boxes
from bagassets.assets.boxes.files.find import LabelSet
from bagassets.assets.boxes.files.kitti import read_kitti_labels, read_kitti_tracklets
from bagassets.assets.boxes.files.label import Label, LabelFile, UnreadableLabelsError
from bagassets.assets.boxes.files.nuscenes_tables import TableSet, read_table
from bagassets.assets.boxes.files.sustechpoints import read_sustechpoints
from bagassets.assets.boxes.files.times import FrameClock, named_frames, numbered_frames, read_times
from bagassets.assets.boxes.frames import DATASET_FRAME, BoxFrames
from bagassets.assets.channel import Counts
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.base.errors import ChangedWhileReadError, DecodeError, RecipeError, RecordingError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.geometry.se3 import SE3
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

Reader = Callable[[bytes], Iterator[Label]]


@dataclass(frozen=True)
class Labels:
    """An entry of the recipe's `annotation_files`, and a recording's label files for it.

    Attributes:
        folder: True if the files are in a folder of their own.
        span_ns: first and last time of the recording's channels, or of the part; None if unknown.
        entry: the entry in the recipe.
        found: the files.
        origin: where the recording's global frame begins: `origin` of `ego_poses.json`.
        logfile: log that rows of nuScenes tables must belong to.
        logfiles_of_parts: logs that count where there is none of the whole drive.
        part: key that the part of a series would have alone, if these are the labels of one.
        frames: number of that part's first message on the topic that gives the times, and how many it has.
        is_moved: rows of nuScenes tables are moved from where the global frame of their log begins.
        parts: of a series that has no label files but those of its parts, these.
        by_other_clock: the topic that gives the times is that of a channel with the other clock than the rig.
    """

    folder: bool
    span_ns: tuple[int, int] | None
    entry: AnnotationFiles = inlined(without=("path", "missing"))
    found: LabelSet = by_digest()
    origin: JsonMapping | None = by_digest()
    logfile: str | None = omitted()
    logfiles_of_parts: tuple[str, ...] = omitted(())
    part: str = omitted("")
    frames: tuple[int, int] | None = omitted()
    is_moved: bool = omitted(default=False)
    parts: tuple["Labels", ...] = omitted(())
    by_other_clock: bool = omitted(default=False)

    @property
    def frame(self) -> str | None:
        """The frame of all boxes, if it is known without reading them."""
        if self.entry.frame is None and isinstance(self.entry, NuScenesTables):
            return DATASET_FRAME
        return self.entry.frame

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that give their times."""
        return _topics_of(self.entry)


def labels_of(
    entries: Sequence[AnnotationFiles], params: ReadingParams, facts: Facts
) -> tuple[dict[str, Labels], tuple[str, ...]]:
    """Return path in the recipe -> labels of a recording, and the paths for which it has none.

    Args:
        entries: entries of the recipe's `annotation_files`.
        params: the topics of the rig's channels, and which time of a message counts.
        facts: facts about the recording.

    Raises:
        RecordingError: labels that the recipe requires are missing.
        RecipeError: the topic or file with their times is missing.
    """
    topics, clock, inventory = params.channels, params.clock, facts.inventory
    labels: dict[str, Labels] = {}
    absent = []
    span_ns, sets = _span_ns(topics, inventory, clock), facts.labels(entries)
    origin = None
    if any(found.files or found.parts for found in sets.values()):
        origin = facts.artifact(EGO_POSES.name).read_json("ego_poses.json")["origin"]

    def made(entry: AnnotationFiles, found: LabelSet, parts: tuple[Labels, ...] = ()) -> Labels:
        return Labels(
            found.is_folder,
            _span_of_part(found, span_ns, topics, clock, inventory),
            entry,
            found,
            origin,
            found.logfile,
            found.logfiles_of_parts,
            found.part,
            found.frames,
            isinstance(entry, NuScenesTables) and found.is_series,
            parts,
            not {*params.other_clock}.isdisjoint(_topics_of(entry)),
        )

    for entry in entries:
        found = sets[entry.path]
        lacking = next((one for one in found.parts or (found,) if not one.files), None)
        if entry.missing == "refuse" and lacking is not None:
            raise RecordingError(
                f"{lacking.place}: there are no labels of the format {entry.format}, which the recipe requires "
                "(`missing: refuse`); put them there, or correct rigs[].annotation_files[].path."
            )
        if found.files or found.parts:
            _require_times(entry, found, inventory)
            labels[entry.path] = made(
                entry, found, tuple(made(entry, one) for one in found.parts if one.files)
            )
        else:
            absent.append(entry.path)
    return labels, tuple(sorted(absent))


def _times_of(entry: AnnotationFiles) -> FrameTimes | None:
    """Return where the times of frames come from; None if each box has its own."""
    return None if isinstance(entry, BoxFiles | NuScenesTables) else entry.times


def _topics_of(entry: AnnotationFiles) -> tuple[str, ...]:
    times = _times_of(entry)
    return (times.topic,) if isinstance(times, TopicTimes) else ()


def _require_times(entry: AnnotationFiles, found: LabelSet, inventory: Inventory) -> None:
    times = _times_of(entry)
    if isinstance(times, TopicTimes) and not inventory.has(times.topic):
        raise RecipeError(
            f"rigs[].annotation_files: the recording has no messages on {times.topic}, which gives the times of the "
            f"frames of {entry.path}; correct `times`."
        )
    for one in (found, *found.parts):
        if isinstance(times, FileTimes) and one.files and one.times is None:
            raise RecipeError(
                f"rigs[].annotation_files: there is no file of times {times.path} for {one.place}; correct `times`."
            )
    counts = [part.frames[1] for part in found.parts if part.frames is not None]
    if isinstance(times, TopicTimes) and counts and sum(counts) != inventory.topic(times.topic).count:
        raise RecordingError(
            f"{found.parts[0].place}: frames of a part are counted in messages on {times.topic}, but the recorder repeated some of "
            f"them in later parts; write labels for the whole drive to {found.place}, or keep its parts apart with bags.series."
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


def _span_of_part(
    part: LabelSet,
    span_ns: tuple[int, int] | None,
    topics: Iterable[str],
    clock: Clock,
    inventory: Inventory,
) -> tuple[int, int] | None:
    """Return first and last time of what was labelled, given those of the recording; of a part at most too wide."""
    if part.span_ns is None or span_ns is None:
        return span_ns
    offsets = [inventory.topics[topic].header_offset_s for topic in topics if inventory.has(topic)]
    known = [offset for offset in offsets if offset is not None and clock != "log"]
    earlier_s = max((offset.max for offset in known), default=0.0)
    later_s = min((offset.min for offset in known), default=0.0)
    first_ns, last_ns = part.span_ns
    return max(span_ns[0], first_ns - round(earlier_s * 1e9)), min(span_ns[1], last_ns - round(later_s * 1e9))


def add_labels(
    sources: Mapping[str, Labels],
    recording: Recording,
    clock: Clock,
    collector: BoxCollector,
) -> JsonObject:
    """Add the boxes of all label files to the collector; return counts of files and of entries that are no boxes.

    Raises:
        DecodeError: a file does not parse, or a box cannot be used, and the recipe says `refuse`; nobody knows where boxes are.
        ChangedWhileReadError: a file is not the one that was digested.
    """
    counts = {}
    for source, labels in sorted(sources.items()):
        files, ignored = Counts(), 0
        first: dict[str, str] = {}
        stamps_ns = _stamps_ns(labels, recording, clock)
        for one in labels.parts or (labels,):
            collector.limit(source, one.span_ns)
            frames = _frame_clock(one, stamps_ns)
            for file, read in _readers(one, collector.frames):
                files.read += 1
                try:
                    content = list(read(_content(file)))
                except UnreadableLabelsError as err:
                    if labels.entry.bad_files == "refuse":
                        raise DecodeError(
                            f"{file.path}{_line(err)}: the file {err}; fix it, or say `bad_files: count` in the recipe."
                        ) from err
                    files.lose(str(err))
                    first.setdefault(str(err), f"{_name(one, file)}{_line(err)}")
                    continue
                files.written += 1
                ignored += sum(_add(label, file, frames, one, collector) for label in content)
        counts[source] = {"files": {**files.as_json(), "first": first}, "ignored": ignored}
    return counts


def _name(labels: Labels, file: LabelFile) -> str:
    """Return the name of a file within its source."""
    return f"{labels.part}/{file.name}" if labels.part else file.name


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
    labels: Labels,
    collector: BoxCollector,
) -> bool:
    """Add one label to the collector; return True if it is deliberately no box.

    Raises:
        DecodeError: it is given in a global frame of which nobody knows where it begins.
    """
    entry, source = labels.entry, labels.entry.path
    place = Place(f"{_name(labels, file)}:{label.line}", f"{file.path}:{label.line}")
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
    if labels.part and not labels.is_moved and _has_origin(entry.frame or frame, labels, collector.frames):
        raise _unknown_origin(str(file.path), labels)
    # Whoever labels one part knows nothing of the tracks of others.
    track_id = label.box.track_id and "/".join(filter(None, (labels.part, label.box.track_id)))
    box = replace(label.box, stamp_ns=stamp_ns, frame_id=frame, source=source, track_id=track_id)
    collector.add(box, place)
    return False


def _has_origin(frame: str, labels: Labels, frames: BoxFrames) -> bool:
    """Tell whether coordinates in a frame depend on where the recording begins."""
    if labels.origin is None:
        return False
    return frame == DATASET_FRAME or (frame == frames.global_frame and labels.origin["kind"] == "wgs84")


def _unknown_origin(place: str, labels: Labels) -> DecodeError:
    of_part = labels.part or " or ".join(labels.logfiles_of_parts)
    return DecodeError(
        f"{place}: its boxes are in a global frame that begins where {of_part} did, and the files do not say where that is; give them "
        "in the frame of a sensor, label the whole drive, or keep its parts apart with bags.series."
    )


def _place_log(labels: Labels, log: JsonMapping) -> SE3:
    """Return `global_SE3_log`, by where the global frames of the recording and of a log in nuScenes tables begin.

    Raises:
        DecodeError: the log is that of a part, and does not say it.
    """
    is_known = labels.origin is None or "origin" in log
    global_SE3_log = between_origins(labels.origin, log.get("origin")) if is_known else None
    if global_SE3_log is None and (labels.part or log.get("logfile") in labels.logfiles_of_parts):
        raise _unknown_origin(str(labels.found.place / "log.json"), labels)
    return global_SE3_log or SE3()


def _readers(labels: Labels, frames: BoxFrames) -> Iterator[tuple[LabelFile, Reader]]:
    """Yield the files of a source in order, each with the function that reads it."""
    files = labels.found.files
    match labels.entry:
        case NuScenesTables():
            is_moved = labels.is_moved and _has_origin(labels.frame or DATASET_FRAME, labels, frames)
            place_log = partial(_place_log, labels) if is_moved else None
            tables = TableSet(labels.logfile, labels.logfiles_of_parts, place_log)
            # The tables that others refer to come first.
            for file in sorted(files, key=lambda file: (file.name == "sample_annotation.json", file.name)):
                yield file, partial(read_table, tables, file.name)
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


def _frame_clock(labels: Labels, stamps_ns: Sequence[int]) -> FrameClock | None:
    """Return the times of frames, given those of messages on the topic; None if each box has its own.

    Raises:
        DecodeError: the file of times does not parse.
    """
    times, found = _times_of(labels.entry), labels.found
    if times is None:
        return None
    if isinstance(times, NameTimes):
        return named_frames(times.unit)
    if isinstance(times, TopicTimes):
        first, count = labels.frames or (0, len(stamps_ns))
        return numbered_frames(stamps_ns[first : first + count], times.first)
    if found.times is None:
        raise DecodeError(f"{found.place}: its file of times is gone; build again.")
    try:
        stamps = read_times(_content(found.times))
    except UnreadableLabelsError as err:
        raise DecodeError(f"{found.times.path}{_line(err)}: {err}; fix the file of times.") from err
    return numbered_frames(stamps, times.first)


def _stamps_ns(labels: Labels, recording: Recording, clock: Clock) -> list[int]:
    """Return the times of the messages on the topic that gives those of frames; none if no topic does."""
    stamps, by_log = [], (clock == "log") != labels.by_other_clock
    for message in recording.messages(labels.topics) if labels.topics else ():
        header = None if by_log else recording.topics[message.topic].header(message.data)
        stamps.append(message.log_time_ns if header is None else header[0])
    return stamps
