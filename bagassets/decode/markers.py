"""`visualization_msgs/Marker` and `MarkerArray`: cubes and cylinders, as labelling and tracking nodes publish them.

Spheres mark points (of a path, the head of a person), which are no objects.
"""

from operator import attrgetter

from bagassets.decode.boxes import BoxDecoder
from bagassets.decode.fields import rigid_transform, stamp_and_frame
from bagassets.decode.model import BoxReading
from bagassets.recordings.model import Message

__all__ = ["MARKER", "MARKERS", "decode_marker"]

CUBE, CYLINDER = 1, 3
ADD = 0


def decode_marker(message: Message, marker: Message) -> BoxReading | None:  # noqa: ARG001  (as BoxDecoder.decode)
    """Return the box of a cube, or around an upright cylinder: the namespace is its class, namespace and id its track.

    Returns:
        None for other shapes (arrows, texts, …) and for markers that delete.

    Raises:
        DecodeError: the pose is not usable.
    """
    if marker.type not in {CUBE, CYLINDER} or marker.action != ADD:
        return None
    stamp_ns, frame_id = stamp_and_frame(marker.header)
    return BoxReading(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        frame_SE3_box=rigid_transform(marker.pose.position, marker.pose.orientation),
        size_m=(float(marker.scale.y), float(marker.scale.x), float(marker.scale.z)),
        track_id=f"{marker.ns}/{marker.id}",
        category=str(marker.ns),
    )


MARKER = BoxDecoder(lambda marker: [marker], decode_marker)
MARKERS = BoxDecoder(attrgetter("markers"), decode_marker)
