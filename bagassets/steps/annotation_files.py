"""Boxes in files beside the recording: the part of the step `annotations` that reads them."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from bagassets.annotations.collect import BoxCollector, Place
from bagassets.annotations.files.box_files import read_json_boxes, read_parquet_boxes
from bagassets.annotations.files.find import LabelSet
from bagassets.annotations.files.kitti_labels import read_kitti_labels
from bagassets.annotations.files.kitti_tracklets import read_kitti_tracklets
from bagassets.annotations.files.label import Label, LabelFile, UnreadableLabelsError
from bagassets.annotations.files.nuscenes_tables import TableSet, read_tables
from bagassets.annotations.files.sustechpoints import read_sustechpoints
from bagassets.annotations.files.times import FrameClock, NamedFrames, NumberedFrames, read_times
from bagassets.annotations.frames import DATASET_FRAME
from bagassets.bags.inventory import Inventory
from bagassets.bags.model import Recording
from bagassets.errors import ChangedWhileReadError, DecodeError, RecipeError, RecordingError
from bagassets.recipe.model import Rig
from bagassets.recipe.model_annotations import TopicTimes
from bagassets.recipe.model_base import Clock
from bagassets.steps.channel import Counts
from bagassets.store.canonical import digest_bytes

__all__ = ["FileRequest", "add_labels", "file_request"]

Reader = Callable[[bytes], Iterator[Label]]


@dataclass(frozen=True)
class FileRequest:
    """What is read of files: parameters per source, topics that tell times, and digests."""

    sources: Mapping[str, Any]
    absent: tuple[str, ...]
    topics: tuple[str, ...]
    inputs: Mapping[str, str]


def file_request(rig: Rig, clock: Clock, inventory: Inventory, labels: Mapping[str, LabelSet]) -> FileRequest:
    """Return what the step reads of label files.

    Args:
        rig: the rig that made the recording.
        clock: which time of a message counts.
        inventory: what is in the recording.
        labels: source -> files found for this recording.

    Raises:
        RecordingError: labels that the recipe insists on are not there.
        RecipeError: the topic or file that tells times is not there.
    """
    sources: dict[str, Any] = {}
    absent, topics = [], set()
    inputs: dict[str, str] = {}
    for entry in rig.annotation_files:
        found = labels[entry.path]
        if not found.files:
            if entry.missing == "refuse":
                raise RecordingError(
                    f"{found.place}: there are no labels of the format {entry.format}, on which the recipe insists "
                    "(`missing: refuse`); put them there, or correct rigs[].annotation_files[].path."
                )
            absent.append(entry.path)
            continue
        params = entry.model_dump(mode="json", exclude={"path", "missing"})
        params |= {"folder": found.is_folder, "span_ns": _span_ns(rig, inventory, clock)}
        if "logfile" in params:
            params["logfile"] = found.logfile
        times = getattr(entry, "times", None)
        if isinstance(times, TopicTimes):
            if not inventory.has(times.topic):
                raise RecipeError(
                    f"rigs[].annotation_files: the recording has no messages on {times.topic}, whose times the frames "
                    f"of {entry.path} have; correct `times`."
                )
            topics.add(times.topic)
        elif times is not None and times.by == "file" and found.times is None:
            raise RecipeError(
                f"rigs[].annotation_files: there is no file of times {times.path} for {found.place}; correct `times`."
            )
        sources[entry.path] = params
        inputs |= found.inputs
    return FileRequest(sources, tuple(sorted(absent)), tuple(sorted(topics)), inputs)


def _span_ns(rig: Rig, inventory: Inventory, clock: Clock) -> list[int] | None:
    """Return first and last time of the channels' messages; None if no header tells."""
    topics = {channel.topic for channel in rig.channels.values()}
    records = [inventory.topics[topic] for topic in sorted(topics) if inventory.has(topic)]
    if clock == "log":
        spans = [(record.first_ns, record.last_ns) for record in records]
    else:
        spans = [(record.first_stamp_ns, record.last_stamp_ns) for record in records]
    firsts = [first for first, _ in spans if first is not None]
    lasts = [last for _, last in spans if last is not None]
    return [min(firsts), max(lasts)] if firsts and lasts else None


def add_labels(
    sources: Mapping[str, Any],
    labels: Mapping[str, LabelSet],
    recording: Recording,
    clock: Clock,
    collector: BoxCollector,
) -> dict[str, Any]:
    """Hand the boxes of all label files to the collector; return counts of files and of entries that are no boxes.

    Raises:
        DecodeError: a file does not parse, or a box cannot be used, and the recipe refuses such.
        ChangedWhileReadError: a file is not the one that was digested.
    """
    counts = {}
    for source, params in sorted(sources.items()):
        found = labels[source]
        frames = _frame_clock(params, found, recording, clock)
        files, ignored = Counts(), 0
        first: dict[str, str] = {}
        for file, read in _readers(params, found):
            files.read += 1
            try:
                content = list(read(_content(file)))
            except UnreadableLabelsError as err:
                if params["bad_files"] == "refuse":
                    raise DecodeError(
                        f"{file.path}{_line(err)}: the file {err}; mend it, or say `bad_files: count` in the recipe."
                    ) from err
                files.lose(str(err))
                first.setdefault(str(err), f"{file.name}{_line(err)}")
                continue
            files.written += 1
            ignored += sum(_add(label, source, file, frames, params, collector) for label in content)
        counts[source] = {"files": {**files.as_json(), "first": first}, "ignored": ignored}
    return counts


def _content(file: LabelFile) -> bytes:
    """Return what is in a file, which must be what the action is keyed by."""
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
    source: str,
    file: LabelFile,
    frames: FrameClock | None,
    params: Mapping[str, Any],
    collector: BoxCollector,
) -> bool:
    """Hand one label to the collector; return True if it is no box by intent."""
    place = Place(f"{file.name}:{label.line}", f"{file.path}:{label.line}")
    if label.problem is not None:
        collector.lose_undecoded(source, label.problem, place)
        return False
    if label.box is None:
        return True
    stamp_ns: int | None = label.box.stamp_ns
    if frames is not None:
        stamp_ns = frames.stamp_ns(file.name, label.frame_number)
        if stamp_ns is None:
            collector.lose_undecoded(source, "its frame has no time", place)
            return False
    stamp_ns = (stamp_ns or 0) + round(params["offset_s"] * 1e9)
    frame = label.box.frame_id or (DATASET_FRAME if params["format"] == "nuscenes" else "")
    collector.add(replace(label.box, stamp_ns=stamp_ns, frame_id=frame, source=source), place)
    return False


def _readers(params: Mapping[str, Any], found: LabelSet) -> Iterator[tuple[LabelFile, Reader]]:
    """Yield the files of a source in order, each with the function that reads it."""
    if params["format"] == "nuscenes":
        tables = TableSet(params["logfile"])
        # The rows that others refer to come first.
        for file in sorted(found.files, key=lambda file: (file.name == "sample_annotation.json", file.name)):
            if file.name == "sample_annotation.json":
                yield file, partial(read_tables, tables)
            else:
                yield file, partial(_take_table, tables, file.name)
        return
    for file in found.files:
        match params["format"]:
            case "boxes":
                is_parquet = file.path.suffix.lower() == ".parquet"
                yield file, read_parquet_boxes if is_parquet else read_json_boxes
            case "sustechpoints":
                yield file, read_sustechpoints
            case "kitti_tracklets":
                yield file, read_kitti_tracklets
            case _:
                yield file, partial(read_kitti_labels, tracking=not params["folder"])


def _take_table(tables: TableSet, name: str, data: bytes) -> Iterator[Label]:
    tables.add(name, data)
    return iter(())


def _frame_clock(
    params: Mapping[str, Any], found: LabelSet, recording: Recording, clock: Clock
) -> FrameClock | None:
    """Return what tells the times of frames; None if each box says its own.

    Raises:
        DecodeError: the file of times does not parse.
    """
    times = params.get("times")
    if times is None:
        return None
    if times["by"] == "name":
        return NamedFrames(times["unit"])
    if times["by"] == "topic":
        return NumberedFrames(_stamps_ns(recording, times["topic"], clock), times["first"])
    if found.times is None:
        raise DecodeError(f"{found.place}: its file of times is gone; build again.")
    try:
        stamps = read_times(_content(found.times))
    except UnreadableLabelsError as err:
        raise DecodeError(f"{found.times.path}{_line(err)}: {err}; mend the file of times.") from err
    return NumberedFrames(stamps, times["first"])


def _stamps_ns(recording: Recording, topic: str, clock: Clock) -> list[int]:
    stamps = []
    for message in recording.messages([topic]):
        stamp_ns = None if clock == "log" else recording.header_stamp_ns(message)
        stamps.append(message.log_time_ns if stamp_ns is None else stamp_ns)
    return stamps
