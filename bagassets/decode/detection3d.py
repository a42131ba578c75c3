"""`vision_msgs/Detection3DArray`: detections with a box, hypotheses and, since ROS 2 Humble, an id."""

from operator import attrgetter

from bagassets.base.errors import DecodeError
from bagassets.decode.boxes import BoxDecoder
from bagassets.decode.fields import rigid_transform, stamp_and_frame
from bagassets.decode.model import BoxReading
from bagassets.recordings.model import Message

__all__ = ["DETECTIONS", "decode_detection"]


def decode_detection(message: Message, detection: Message) -> BoxReading:
    """Return the box of a `Detection3D` with the class of its most probable hypothesis.

    Detections mostly leave their own header empty; then that of the array holds.

    Raises:
        DecodeError: the pose is not usable, or there is no hypothesis that names a class.
    """
    stamp_ns, frame_id = stamp_and_frame(detection.header, message.header)
    hypotheses = [_hypothesis(result) for result in detection.results]
    if not hypotheses:
        raise DecodeError("its detection names no class")
    score, category = max(hypotheses, key=lambda pair: pair[0])
    size = detection.bbox.size
    return BoxReading(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        frame_SE3_box=rigid_transform(detection.bbox.center.position, detection.bbox.center.orientation),
        size_m=(float(size.y), float(size.x), float(size.z)),
        track_id=str(getattr(detection, "id", "")),
        category=category,
        score=score,
    )


def _hypothesis(result: Message) -> tuple[float, str]:
    """Score and class: fields of their own since ROS 2 Galactic, of the result itself before."""
    inner = getattr(result, "hypothesis", result)
    category = getattr(inner, "class_id", None)
    return float(inner.score), str(inner.id if category is None else category)


DETECTIONS = BoxDecoder(attrgetter("detections"), decode_detection)
