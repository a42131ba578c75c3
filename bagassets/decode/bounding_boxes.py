"""`jsk_recognition_msgs/BoundingBoxArray`: boxes with a number as label and no track."""

from operator import attrgetter

from bagassets.decode.boxes import BoxDecoder
from bagassets.decode.fields import rigid_transform, stamp_and_frame
from bagassets.decode.model import BoxReading
from bagassets.recordings.model import Message

__all__ = ["BOXES", "decode_box"]


def decode_box(message: Message, box: Message) -> BoxReading:
    """Return a `BoundingBox`; its class is its label in digits, its `value` the score.

    Raises:
        DecodeError: the pose is not usable.
    """
    stamp_ns, frame_id = stamp_and_frame(box.header, message.header)
    return BoxReading(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        frame_SE3_box=rigid_transform(box.pose.position, box.pose.orientation),
        size_m=(float(box.dimensions.y), float(box.dimensions.x), float(box.dimensions.z)),
        track_id="",
        category=str(int(box.label)),
        score=float(box.value),
    )


BOXES = BoxDecoder(attrgetter("boxes"), decode_box)
