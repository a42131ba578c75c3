"""The asset `annotations`: boxes from topics and from files beside the recording, in one global table.

Files: `annotations.parquet` and `annotations.json`, which counts messages, files and boxes, and those that were lost.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace

from bagassets.assets.annotation_files import Labels, add_labels, labels_of
from bagassets.assets.annotation_frames import (
    BoxPlaces,
    ReadingParams,
    box_frames,
    box_places,
    frames_of_topic,
)
from bagassets.assets.asset import Asset, Facts, Inputs, Summary, Use, inlined, omitted
from bagassets.assets.boxes.collect import UNKNOWN_FRAME, BoxCollector, Place, Source
from bagassets.assets.boxes.frames import BoxFrames
from bagassets.assets.boxes.table import SCHEMA, BoxTable
from bagassets.assets.calibration import CALIBRATION
from bagassets.assets.channel import Counts
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.face import Face, Loss, losses_of
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.quality.box_rules import boxes_plausible
from bagassets.assets.quality.check import RecordingCheck
from bagassets.assets.quality.evidence import Evidence
from bagassets.assets.quality.finding import Finding
from bagassets.assets.track import TRACK
from bagassets.base.errors import DecodeError, LossLimitError, RecipeError
from bagassets.base.json_types import JsonMapping
from bagassets.decode.boxes import BoxDecoder
from bagassets.decode.loading import keyed_decoder
from bagassets.decode.registry import advice, decoder_key, own_types
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Recipe, Rig
from bagassets.recipe.model_annotations import AnnotationFiles, AnnotationTopic
from bagassets.recipe.model_base import Clock
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import ArtifactWriter

TABLE = "annotations.parquet"
COUNTS = "annotations.json"
# Packages of messages with cylinders, footprints, …
_SHAPES = {
    "autoware_auto_perception_msgs",
    "autoware_perception_msgs",
    "derived_object_msgs",
    "visualization_msgs",
}


@dataclass(frozen=True)
class AnnotationParams:
    """Parameters of `annotations`.

    Attributes:
        topics: topics of boxes, sorted by name.
        files: files of boxes, sorted by path.
        reading: further parameters; None without topics and files.
    """

    topics: tuple[AnnotationTopic, ...]
    files: tuple[AnnotationFiles, ...]
    reading: ReadingParams | None

    @classmethod
    def of(cls, recipe: Recipe, rig: Rig) -> "AnnotationParams":
        """Return the parameters of a rig; the last entry of a topic or path counts."""
        topics = {source.topic: source for source in rig.annotations}
        files = {entry.path: entry for entry in rig.annotation_files}
        if not topics and not files:
            return cls((), (), None)
        clocks = {one.topic: recipe.clock_of(rig, one) for one in rig.channels.values()} if files else {}
        reading = ReadingParams(
            (clock := recipe.clock_of(rig)),
            recipe.limits.lost_messages,
            rig.ego_frame,
            rig.tf_static,
            rig.tf,
            tuple(sorted(clocks)),
            tuple(sorted(topic for topic, own in clocks.items() if own != clock)),
        )
        return cls(
            tuple(topics[name] for name in sorted(topics)),
            tuple(files[path] for path in sorted(files)),
            reading,
        )


@dataclass(frozen=True)
class BoxTopic:
    """A topic of boxes that a recording has.

    Attributes:
        rules: its entry in the recipe.
        decoder: the plug-in that decodes its messages, if one does.
        shapes: objects of its type may have other shapes than boxes, which were counted as lost once.
    """

    rules: AnnotationTopic = inlined(without=("topic",))
    decoder: Mapping[str, str] | None = omitted()
    shapes: bool = omitted(default=False)


@dataclass(frozen=True)
class BoxSources:
    """The sources of a recording's boxes.

    Attributes:
        clock: which time of a message counts.
        lost_messages: share of messages and boxes that may be lost to decoding.
        sources: topic -> how its boxes are read.
        files: path in the recipe -> how the boxes of its files are read.
        places: the frames and transforms of the boxes.
    """

    clock: Clock
    lost_messages: float
    sources: Mapping[str, BoxTopic]
    files: Mapping[str, Labels]
    places: BoxPlaces = inlined()


@dataclass(frozen=True)
class AnnotationUse:
    """What shapes the annotations of a recording.

    Attributes:
        absent: topics and paths of the recipe that the recording lacks.
        boxes: the boxes that it has; None if it has none at all.
    """

    absent: tuple[str, ...]
    boxes: BoxSources | None = inlined()


def use(params: AnnotationParams, facts: Facts) -> dict[str, Use[AnnotationUse]]:
    """Return what the annotations of a recording depend on.

    Without a topic or file of boxes they read nothing at all, so a change of poses does not make them stale.

    Raises:
        PluginError: several decoder plug-ins claim the type of a topic.
        RecordingError: label files that the recipe requires are missing.
        RecipeError: the times of labelled frames are missing.
    """
    reading, inventory = params.reading, facts.inventory
    if reading is None:
        return {"": Use(AnnotationUse((), None))}
    topics = {source.topic: source for source in params.topics if inventory.has(source.topic)}
    absent = [source.topic for source in params.topics if source.topic not in topics]
    labels, without = labels_of(params.files, reading, facts)
    if not topics and not labels:
        return {"": Use(AnnotationUse((*absent, *without), None))}
    frames = [entry.frame for entry in labels.values()]
    for name, source in topics.items():
        frames += frames_of_topic(name, source.frame, inventory)
    places = box_places(facts, frames, reading)
    sources = {}
    for name, source in topics.items():
        msgtype = inventory.topic(name).msgtype
        shapes = msgtype.partition("/")[0] in _SHAPES
        sources[name] = BoxTopic(source, decoder_key("boxes", msgtype), shapes)
    boxes = BoxSources(reading.clock, reading.lost_messages, sources, labels, places)
    read = {
        *topics,
        *places.tf_static,
        *places.tf,
        *(topic for entry in labels.values() for topic in entry.topics),
    }
    inputs = {EGO_POSES.name: facts.artifact(EGO_POSES.name).digest}
    for entry in labels.values():
        inputs |= entry.found.inputs
    return {"": Use(AnnotationUse((*absent, *without), boxes), tuple(sorted(read)), inputs)}


def make_annotations(
    use: AnnotationUse, recording: Recording, out: ArtifactWriter, *, trajectory: Trajectory
) -> Summary:
    """Write `annotations.parquet` and `annotations.json`; return the summary.

    Args:
        use: the topics and files that the recording has.
        recording: has the topics of boxes.
        out: the artifact.
        trajectory: `global_SE3_ego`, the content of `ego_poses`.

    Raises:
        RecipeError: a topic carries no boxes.
        DecodeError: a box or label file cannot be used, and the recipe says `refuse`.
        LossLimitError: more messages or boxes were lost to decoding than the recipe allows.
    """
    boxes = use.boxes
    if boxes is None:
        nothing = BoxCollector(BoxFrames("", "", {}, trajectory), {})
        return _write(nothing.finish(), {}, use.absent, out)
    sources, files, clock = boxes.sources, boxes.files, boxes.clock
    decoders = {topic: _decoder(topic, source, recording) for topic, source in sources.items()}
    entries: dict[str, Source] = {topic: source.rules for topic, source in sources.items()}
    entries |= {path: labels.entry for path, labels in files.items()}
    collector = BoxCollector(box_frames(boxes.places, clock, recording, trajectory), entries)
    messages = {topic: Counts() for topic in sources}
    ignored = dict.fromkeys(sources, 0)
    for message in recording.messages(sorted(sources)) if sources else ():
        counts, decoder = messages[message.topic], decoders[message.topic]
        counts.read += 1
        try:
            decoded = recording.decode(message)
            items = list(decoder.items(decoded))
        except DecodeError as err:
            counts.lose(str(err))
            continue
        counts.written += 1
        label = f"message logged at {message.log_time_ns}"
        place = Place(label, f"{message.topic}, {label}")
        for item in items:
            try:
                box = decoder.decode(decoded, item)
            except DecodeError as err:
                collector.lose_undecoded(message.topic, str(err), place)
                continue
            if box is None:
                ignored[message.topic] += 1
                continue
            stamp_ns = message.log_time_ns if clock == "log" else box.stamp_ns
            collector.add(replace(box, stamp_ns=stamp_ns, source=message.topic), place, counts.read)
    for topic, counts in messages.items():
        lost = sum(counts.lost.values())
        if lost > boxes.lost_messages * counts.read:
            raise LossLimitError(
                f"{topic}: {lost} of {counts.read} messages with boxes cannot be decoded, most often because "
                f"{counts.main_reason}; limits.lost_messages accepts a share of {boxes.lost_messages:g}."
            )
        _check_frames(topic, collector, boxes.lost_messages)
    labelled = add_labels(files, recording, clock, collector)
    for source in files:
        _check_frames(source, collector, boxes.lost_messages)
    table = collector.finish()
    counted = {
        topic: {
            "messages": messages[topic].as_json(),
            "boxes": asdict(collector.counts[topic]),
            "ignored": ignored[topic],
        }
        for topic in sources
    }
    counted |= {
        path: {**counts, "boxes": asdict(collector.counts[path])} for path, counts in labelled.items()
    }
    return _write(table, counted, use.absent, out)


def _write(table: BoxTable, counts: JsonMapping, absent: Iterable[str], out: ArtifactWriter) -> Summary:
    out.write_table(TABLE, table.to_arrow())
    summary = {
        "counts": dict(counts),
        "absent": list(absent),
        "boxes": len(table),
        "tracks": table.track_count,
        "without_track": table.without_track,
        "categories": sorted(set(table.categories)),
    }
    out.write_json(COUNTS, summary)
    return summary


def _decoder(topic: str, source: BoxTopic, recording: Recording) -> BoxDecoder:
    msgtype = recording.topics[topic].msgtype
    decoder: BoxDecoder | None = keyed_decoder("boxes", msgtype, source.decoder)
    if decoder is None:
        raise RecipeError(
            f"rigs[].annotations: topic {topic} has type {msgtype}, which carries no boxes that are known here; "
            f"expected one of {', '.join(sorted(own_types('boxes')))}; {advice('boxes', msgtype)}"
        )
    return decoder


def _check_frames(source: str, collector: BoxCollector, limit: float) -> None:
    boxes = collector.counts[source]
    astray = boxes.lost.get(UNKNOWN_FRAME, 0)
    if astray > limit * boxes.read:
        frames = " and ".join(sorted(collector.unknown_frames[source])) or "(none)"
        raise LossLimitError(
            f"{source}: {astray} of {boxes.read} boxes are given in frame {frames}, but the known frames are "
            f"{collector.frames.describe()}; name the frame of the boxes in `frame` of this source, "
            "or choose an ego_pose source with that global frame."
        )


def _make(use: Use[AnnotationUse], inputs: Inputs, out: ArtifactWriter) -> Summary:
    with inputs.messages(use.topics) as recording:
        return make_annotations(use.params, recording, out, trajectory=inputs.trajectory)


def _boxes_plausible(evidence: Evidence) -> Finding:
    artifact = evidence.artifact(ANNOTATIONS.name)
    boxes = BoxTable.from_arrow(artifact.read_table(TABLE))
    return boxes_plausible(artifact.read_json(COUNTS)["counts"], boxes, evidence.checks.boxes_plausible)


def _losses(summary: JsonMapping) -> Iterator[Loss]:
    for source, counts in summary.get("counts", {}).items():
        yield from losses_of(source, counts.get("messages", {}))
        yield from losses_of(source, counts.get("boxes", {}), "box")


ANNOTATIONS = Asset(
    name="annotations",
    version=3,
    libraries=("pyarrow",),
    title="3-D boxes with track ids, in the frame of the ego poses.",
    description="From topics of the recording or files beside it: `annotations.parquet`.",
    kinds=frozenset({"parquet"}),
    face=Face(
        columns=SCHEMA,
        counts={"boxes": lambda summary: summary.get("boxes")},
        losses=_losses,
        heading="boxes",
    ),
    reads=(INVENTORY, CALIBRATION, EGO_POSES),
    families=("boxes",),
    params=AnnotationParams.of,
    use=use,
    make=_make,
    checks=(
        RecordingCheck(
            "boxes_plausible",
            "boxes_plausible",
            "Few boxes were lost, tracks do not jump, sizes are those of things on roads.",
            "more than `max_lost` of a source's boxes were lost; a track moves faster than `max_speed_mps` (beyond "
            "`noise_m`: two objects may share its id); a box is smaller than `min_size_m` or larger than `max_size_m`",
            _boxes_plausible,
        ),
    ),
    # Maps and reports need the track later, one process for all recordings; here all workers make it.
    along=(TRACK,),
)
