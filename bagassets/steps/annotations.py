"""The step `annotations`: boxes in topics and in files beside the recording become one global table."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from bagassets.annotations.collect import UNKNOWN_FRAME, BoxCollector, Place, SourceRules
from bagassets.annotations.files.find import LabelSet
from bagassets.annotations.frames import DATASET_FRAME
from bagassets.annotations.table import BoxTable
from bagassets.bags.inventory import Inventory
from bagassets.bags.model import RawMessage, Recording
from bagassets.decode.boxes import BoxDecoder, box_decoder, box_message_types
from bagassets.decode.model import BoxReading
from bagassets.decode.registry import decoder_params, plugin_box_decoder
from bagassets.errors import DecodeError, LossLimitError, RecipeError
from bagassets.geometry.trajectory import Trajectory
from bagassets.plugins import installed_decoders
from bagassets.recipe.model import Limits, Rig
from bagassets.recipe.model_base import Clock
from bagassets.steps.annotation_files import add_labels, file_request
from bagassets.steps.annotation_frames import box_frames, frame_params
from bagassets.steps.channel import Counts, Request
from bagassets.store.action import Step
from bagassets.store.artifact import Artifact, ArtifactWriter

__all__ = ["STEP", "make", "request"]

STEP = Step("annotations", 3, ("pyarrow",))

TABLE = "annotations.parquet"
COUNTS = "annotations.json"


def request(
    rig: Rig,
    clock: Clock,
    limits: Limits,
    inventory: Inventory,
    *,
    calibration: Mapping[str, Any],
    ego_poses: Artifact,
    labels: Mapping[str, LabelSet] | None = None,
) -> Request:
    """Return what the step reads of this recording.

    Without a topic or file of boxes it reads nothing at all, and no change of poses makes it stale.

    Args:
        rig: the rig that made the recording.
        clock: which time of a message counts.
        limits: accepted losses.
        inventory: what is in the recording.
        calibration: content of `calibration.json`.
        ego_poses: the artifact of poses.
        labels: source -> label files found beside the recording, one entry per `annotation_files` of the rig.

    Raises:
        PluginError: several decoder plug-ins claim the type of a topic.
        RecordingError: label files that the recipe insists on are not there.
        RecipeError: what tells the times of labelled frames is not there.
    """
    sources = [source for source in rig.annotations if inventory.has(source.topic)]
    absent = sorted({source.topic for source in rig.annotations} - {source.topic for source in sources})
    files = file_request(rig, clock, inventory, labels or {})
    params: dict[str, Any] = {"absent": [*absent, *files.absent]}
    if not sources and not files.sources:
        return Request(params, ())
    params |= {
        "clock": clock,
        "lost_messages": limits.lost_messages,
        "sources": {
            source.topic: source.model_dump(mode="json", exclude={"topic"})
            | decoder_params("boxes", inventory.topic(source.topic).msgtype)
            for source in sources
        },
        "files": files.sources,
    }
    frames = frame_params(
        rig,
        inventory,
        calibration,
        ego_poses,
        topics={source.topic: source.frame for source in sources},
        files=[_frame_of(source) for source in files.sources.values()],
    )
    params |= frames
    topics = {source.topic for source in sources} | {*files.topics, *frames["tf_static"], *frames["tf"]}
    return Request(params, tuple(sorted(topics)), {"ego_poses": ego_poses.digest, **files.inputs})


def make(
    params: Mapping[str, Any],
    recording: Recording,
    out: ArtifactWriter,
    *,
    trajectory: Trajectory,
    labels: Mapping[str, LabelSet] | None = None,
) -> dict[str, Any]:
    """Write `annotations.parquet` and `annotations.json`; return the summary.

    Args:
        params: as made by `request`.
        recording: offers the topics of boxes.
        out: the artifact.
        trajectory: `global_SE3_ego`, the content of `ego_poses`.
        labels: as for `request`.

    Raises:
        RecipeError: a topic carries no boxes.
        DecodeError: a box or label file cannot be used and the recipe refuses such.
        LossLimitError: more messages or boxes were lost to decoding than the recipe allows.
    """
    sources: Mapping[str, Any] = params.get("sources", {})
    decoders = {topic: _decoder(topic, source, recording) for topic, source in sources.items()}
    files: Mapping[str, Any] = params.get("files", {})
    rules = {source: _rules(fields) for source, fields in {**sources, **files}.items()}
    collector = BoxCollector(box_frames(params, recording, trajectory), rules)
    messages = {topic: Counts() for topic in sources}
    ignored = dict.fromkeys(sources, 0)
    for message in recording.messages(sorted(sources)) if sources else ():
        counts = messages[message.topic]
        counts.read += 1
        try:
            decoded = recording.decode(message)
            items = list(decoders[message.topic].items(decoded))
        except DecodeError as err:
            counts.lose(str(err))
            continue
        counts.written += 1
        decode = partial(decoders[message.topic].decode, decoded)
        ignored[message.topic] += _add_boxes(collector, decode, message, items, params["clock"], counts.read)
    for topic, counts in messages.items():
        _check_limits(topic, counts, collector, params["lost_messages"])
    labelled = add_labels(files, labels or {}, recording, params["clock"], collector) if files else {}
    for source in files:
        _check_frames(source, collector, params["lost_messages"])
    table = collector.finish()
    out.write_table(TABLE, table.to_arrow())
    summary = {
        "counts": {
            topic: {
                "messages": messages[topic].as_json(),
                "boxes": collector.counts[topic].as_json(),
                "ignored": ignored[topic],
            }
            for topic in sorted(sources)
        }
        | {source: {**labelled[source], "boxes": collector.counts[source].as_json()} for source in labelled},
        "absent": list(params["absent"]),
        **_facts(table),
    }
    out.write_json(COUNTS, summary)
    return summary


def _decoder(topic: str, source: Mapping[str, Any], recording: Recording) -> BoxDecoder:
    msgtype = recording.topics[topic].msgtype
    decoder = plugin_box_decoder(msgtype, source.get("decoder")) or box_decoder(msgtype)
    if decoder is None:
        raise RecipeError(
            f"rigs[].annotations: topic {topic} has type {msgtype}, which carries no boxes that are known here; "
            f"expected one of {', '.join(box_message_types())}; {installed_decoders().advice('boxes', msgtype)}"
        )
    return decoder


def _rules(source: Mapping[str, Any]) -> SourceRules:
    attributes = {category: tuple(names) for category, names in source["attributes"].items()}
    span_ns = source.get("span_ns")
    return SourceRules(
        frame=source["frame"],
        categories=source["categories"],
        attributes=attributes,
        attribute_names=source["attribute_names"],
        refuse=source["bad_boxes"] == "refuse",
        unmapped=source["unmapped"],
        outside=source.get("outside", "keep"),
        span_ns=None if span_ns is None else (span_ns[0], span_ns[1]),
    )


def _frame_of(source: Mapping[str, Any]) -> str | None:
    """Return the frame that all boxes of a source of files are in, if it is known without reading them."""
    if source["frame"] is None and source["format"] == "nuscenes":
        return DATASET_FRAME
    frame: str | None = source["frame"]
    return frame


def _add_boxes(
    collector: BoxCollector,
    decode: Callable[[Any], BoxReading | None],
    message: RawMessage,
    items: Iterable[Any],
    clock: Clock,
    number: int,
) -> int:
    """Hand the boxes of a topic's message to the collector; return the number of items that are no boxes."""
    ignored = 0
    label = f"message logged at {message.log_time_ns}"
    place = Place(label, f"{message.topic}, {label}")
    for item in items:
        try:
            box = decode(item)
        except DecodeError as err:
            collector.lose_undecoded(message.topic, str(err), place)
            continue
        if box is None:
            ignored += 1
            continue
        stamp_ns = message.log_time_ns if clock == "log" else box.stamp_ns
        collector.add(replace(box, stamp_ns=stamp_ns, source=message.topic), place, number)
    return ignored


def _check_limits(topic: str, messages: Counts, collector: BoxCollector, limit: float) -> None:
    lost = sum(messages.lost.values())
    if lost > limit * messages.read:
        reason = max(messages.lost, key=lambda name: messages.lost[name])
        raise LossLimitError(
            f"{topic}: {lost} of {messages.read} messages with boxes cannot be decoded, most often because {reason}; "
            f"limits.lost_messages accepts a share of {limit:g}."
        )
    _check_frames(topic, collector, limit)


def _check_frames(source: str, collector: BoxCollector, limit: float) -> None:
    boxes = collector.counts[source]
    astray = boxes.lost.get(UNKNOWN_FRAME, 0)
    if astray > limit * boxes.read:
        frames = " and ".join(sorted(collector.unknown_frames[source])) or "(none)"
        raise LossLimitError(
            f"{source}: {astray} of {boxes.read} boxes are given in frame {frames}, but known are "
            f"{collector.frames.known()}; name the frame of the boxes in `frame` of this source, "
            "or choose an ego_pose source with that global frame."
        )


def _facts(table: BoxTable) -> dict[str, Any]:
    return {
        "boxes": len(table),
        "tracks": table.track_count,
        "without_track": table.without_track,
        "categories": sorted(set(table.categories)),
    }
