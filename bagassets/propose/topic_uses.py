"""What becomes of each topic of a rig's recordings: used as what, not decodable and why, or not needed."""

from collections.abc import Mapping

from bagassets.decode.registry import types_of
from bagassets.propose.poses import PoseProposal
from bagassets.propose.sensors import Sensor
from bagassets.propose.summary import USES, RecordingSummary, TopicUse

__all__ = ["transform_topics", "uses_of"]


def uses_of(
    summary: RecordingSummary,
    channels: Mapping[str, Sensor],
    pose: PoseProposal,
    annotations: list[str],
    left_out: list[TopicUse],
    urdf: TopicUse | None = None,
) -> list[TopicUse]:
    """Return what becomes of each topic, those that are used first.

    Args:
        summary: the recordings.
        channels: channel -> sensor.
        pose: where poses come from.
        annotations: topics with boxes, the one that is used first.
        left_out: topics that could be a sensor's.
        urdf: what becomes of a robot description.
    """
    used: dict[str, list[str]] = {}
    for name, sensor in channels.items():
        used.setdefault(sensor.topic.name, []).append(name)
        if sensor.camera_info is not None:
            used.setdefault(sensor.camera_info.name, []).append(f"calibration of {name}")
    for field, what in (("topic", "poses"), ("imu", "orientation")):
        if field in pose.fields:
            used.setdefault(pose.fields[field], []).append(what)
    for name in annotations[:1]:
        used.setdefault(name, []).append("boxes")
    for name in transform_topics(summary):
        used.setdefault(name, []).append("transforms")
    uses = [TopicUse(summary.topics[name], "used", ", ".join(what)) for name, what in used.items()]
    uses += left_out if urdf is None else [*left_out, urdf]
    known = {use.topic.name for use in uses}
    boxes = "boxes, too; the recipe has it as a comment"
    uses += [
        TopicUse(topic, "left out", boxes) if name in annotations else TopicUse(topic, "not needed")
        for name, topic in summary.topics.items()
        if name not in known
    ]
    return sorted(uses, key=lambda use: USES.index(use.status))


def transform_topics(summary: RecordingSummary) -> list[str]:
    """Return the topics with transforms."""
    types = set(types_of("transforms"))
    return [topic.name for topic in summary.topics.values() if topic.msgtype in types and topic.count > 0]
