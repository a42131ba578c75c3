"""A robot description that was recorded, as robot_state_publisher latches it: where its URDF puts what TF does not."""

from dataclasses import replace

from bagassets.geometry.urdf import urdf_edges
from bagassets.propose.summary import RecordingSummary, TopicSummary

__all__ = ["described", "description_in"]


def description_in(summary: RecordingSummary) -> TopicSummary | None:
    """Return the topic with a robot description; None if there is none."""
    return next((topic for topic in summary.topics.values() if topic.urdf), None)


def described(summary: RecordingSummary, urdf: str) -> RecordingSummary:
    """Return recordings with the fixed joints of a URDF, as builds lay them between `/tf_static` and `/tf`.

    Raises:
        CalibrationError: the URDF cannot be used.
    """
    known = {child for _, child in summary.static}
    joints = {
        (edge.parent, edge.child): edge.first for edge in urdf_edges(urdf.encode()) if edge.child not in known
    }
    moving = summary.moving - joints.keys()
    return replace(
        summary,
        transforms={**summary.transforms, **joints},
        moving=moving,
        static=summary.static | joints.keys(),
    )
