"""Messages of boxes: those of `vision_msgs`, `visualization_msgs`, `jsk_recognition_msgs`, `derived_object_msgs`, Foxglove and Autoware."""

from collections.abc import Sequence
from operator import attrgetter
from types import SimpleNamespace
from typing import cast

from bagassets.base.errors import DecodeError
from bagassets.decode.boxes import NO_EXTENT, BoxDecoder, box_around
from bagassets.decode.fields import head, rigid_transform, stamp_and_frame
from bagassets.decode.model import BoxReading
from bagassets.geometry.se3 import SE3
from bagassets.recordings.model import Message

Size = tuple[float, float, float]
"""Width, length, height in metres."""


def _detection(message: Message, detection: Message) -> BoxReading:
    """Return the box of a `vision_msgs/Detection3D` with the class of its most probable hypothesis, and an id since ROS 2 Humble.

    Detections mostly leave their own header empty; then that of the array holds.

    Raises:
        DecodeError: the pose is not usable, or there is no hypothesis that names a class.
    """
    header = stamp_and_frame(detection.header, message.header)
    hypotheses = [_hypothesis(result) for result in detection.results]
    if not hypotheses:
        raise DecodeError("its detection names no class")
    score, category = max(hypotheses, key=lambda pair: pair[0])
    box = _box_of_cuboid(detection.bbox.center, detection.bbox.size)
    track_id = str(getattr(detection, "id", ""))
    return BoxReading(*header, *box, track_id=track_id, category=category, score=score)


def _hypothesis(result: Message) -> tuple[float, str]:
    """Score and class: fields of their own since ROS 2 Galactic, of the result itself before."""
    inner = getattr(result, "hypothesis", result)
    category = getattr(inner, "class_id", None)
    return float(inner.score), str(inner.id if category is None else category)


DETECTIONS = BoxDecoder(attrgetter("detections"), _detection)


_CUBE, _CYLINDER, _ADD = 1, 3, 0  # visualization_msgs/Marker


def _marker(message: Message, marker: Message) -> BoxReading | None:  # noqa: ARG001  (as BoxDecoder.decode)
    """Return the box of a cube, or around an upright cylinder, as labelling and tracking nodes publish them.

    The namespace is its class, namespace and id its track.

    Returns:
        None for other shapes (arrows, texts, …) and for markers that delete. Spheres mark points (of a path, the head of a
        person), which are no objects.

    Raises:
        DecodeError: the pose is not usable.
    """
    if marker.type not in {_CUBE, _CYLINDER} or marker.action != _ADD:
        return None
    header, box = stamp_and_frame(marker.header), _box_of_cuboid(marker.pose, marker.scale)
    return BoxReading(*header, *box, track_id=f"{marker.ns}/{marker.id}", category=str(marker.ns))


MARKER = BoxDecoder(lambda marker: [marker], _marker)
MARKERS = BoxDecoder(attrgetter("markers"), _marker)


def _bounding_box(message: Message, item: Message) -> BoxReading:
    """Return a `jsk_recognition_msgs/BoundingBox`, which has no track; its class is its label in digits, its `value` the score.

    Raises:
        DecodeError: the pose is not usable.
    """
    header = stamp_and_frame(item.header, message.header)
    box = _box_of_cuboid(item.pose, item.dimensions)
    return BoxReading(*header, *box, track_id="", category=str(int(item.label)), score=float(item.value))


BOUNDING_BOXES = BoxDecoder(attrgetter("boxes"), _bounding_box)


_CLASS_KEYS = ("category", "class", "label", "type")


def _scene_items(message: Message) -> list[Message]:
    """Return the cubes of a `foxglove.SceneUpdate`, each with its entity: a cube does not know it."""
    pairs = ((entity, cube) for entity in message.entities for cube in entity.cubes)
    return [cast("Message", SimpleNamespace(entity=entity, cube=cube)) for entity, cube in pairs]


def _scene_cube(message: Message, item: Message) -> BoxReading:  # noqa: ARG001  (as BoxDecoder.decode)
    """Return the box of a cube of a `foxglove.SceneEntity`, whose id is its track and whose metadata names its class.

    `attributes` in the metadata are separated by commas, as `bagassets view` writes them, `score` is a number. Other shapes
    mark points and surfaces.

    Raises:
        DecodeError: the pose is not usable, or no class is named.
    """
    entity, cube = item.entity, item.cube
    header = head(entity)
    known = {str(pair.key): str(pair.value) for pair in entity.metadata}
    category = next((known[key] for key in _CLASS_KEYS if known.get(key)), None)
    if category is None:
        raise DecodeError(f"the metadata of its entity name no class ({', '.join(_CLASS_KEYS)})")
    try:
        score = float(known.get("score", 1.0))
    except ValueError:
        raise DecodeError("its score is no number") from None
    attributes = tuple(filter(None, (name.strip() for name in known.get("attributes", "").split(","))))
    box = _box_of_cuboid(cube.pose, cube.size)
    return BoxReading(*header, *box, str(entity.id), category, attributes, score)


SCENE_UPDATE = BoxDecoder(_scene_items, _scene_cube)


# derived_object_msgs/Object CLASSIFICATION_*
_DERIVED_CLASSES = (
    "unknown",
    "unknown_small",
    "unknown_medium",
    "unknown_big",
    "pedestrian",
    "bike",
    "car",
    "truck",
    "motorcycle",
    "other_vehicle",
    "barrier",
    "sign",
)


def _derived_object(message: Message, item: Message) -> BoxReading:
    """Return the box of a tracked `derived_object_msgs/Object`; its class is the lower-case name of the classification.

    Raises:
        DecodeError: the shape has no extent, or the pose is not usable.
    """
    frame_SE3_object = rigid_transform(item.pose.position, item.pose.orientation)
    box = _box_of_primitive(frame_SE3_object, item.shape)
    return BoxReading(
        *stamp_and_frame(item.header, message.header),
        *box,
        track_id=str(int(item.id)),
        category=_name_of(int(item.classification), _DERIVED_CLASSES),
        score=int(item.classification_certainty) / 255,
    )


def _box_of_primitive(frame_SE3_object: SE3, shape: Message) -> tuple[SE3, Size]:
    """Return `frame_SE3_box` and size of a `shape_msgs/SolidPrimitive`.

    Where the origin of a cone is, its definition leaves open.
    """
    match int(shape.type), [float(value) for value in shape.dimensions]:
        case 1, [length, width, height, *_]:  # BOX
            return frame_SE3_object, (width, length, height)
        case 2, [radius, *_]:  # SPHERE
            return frame_SE3_object, (2 * radius,) * 3
        case 3, [height, radius, *_]:  # CYLINDER
            return frame_SE3_object, (2 * radius, 2 * radius, height)
        case 5, [height, *_] if hasattr(shape, "polygon"):  # PRISM, since Humble
            return box_around(frame_SE3_object, shape.polygon, height)
    raise DecodeError(NO_EXTENT)


DERIVED_OBJECTS = BoxDecoder(attrgetter("objects"), _derived_object)


# autoware_perception_msgs/ObjectClassification; the last four came later.
_AUTOWARE_CLASSES = (
    "unknown",
    "car",
    "truck",
    "bus",
    "trailer",
    "motorcycle",
    "bicycle",
    "pedestrian",
    "animal",
    "hazard",
    "over_drivable",
    "under_drivable",
)


def _autoware_object(message: Message, item: Message) -> BoxReading:
    """Return the box of an Autoware object with its most probable class; detected objects have no track.

    Raises:
        DecodeError: the shape has no extent, no class is named, or the pose is not usable.
    """
    if not len(item.classification):
        raise DecodeError("its object names no class")
    header = stamp_and_frame(message.header)
    likeliest = max(item.classification, key=lambda entry: float(entry.probability))
    pose = item.kinematics.pose_with_covariance.pose
    box = _box_of_shape(rigid_transform(pose.position, pose.orientation), item.shape)
    identifier = getattr(item, "object_id", None)
    return BoxReading(
        *header,
        *box,
        track_id="" if identifier is None else bytes(int(byte) for byte in identifier.uuid).hex(),
        category=_name_of(int(likeliest.label), _AUTOWARE_CLASSES),
        score=float(item.existence_probability),
    )


def _box_of_shape(frame_SE3_object: SE3, shape: Message) -> tuple[SE3, Size]:
    """Return `frame_SE3_box` and size of an `autoware_perception_msgs/Shape`."""
    width_m, length_m, height_m = _size_m(shape.dimensions)
    match int(shape.type):
        case 0:  # BOUNDING_BOX
            return frame_SE3_object, (width_m, length_m, height_m)
        case 1:  # CYLINDER: x is the diameter; y is not used by every version of the message
            return frame_SE3_object, (length_m, length_m, height_m)
        case 2:  # POLYGON
            return box_around(frame_SE3_object, shape.footprint, height_m)
    raise DecodeError(NO_EXTENT)


AUTOWARE_OBJECTS = BoxDecoder(attrgetter("objects"), _autoware_object)


def _box_of_cuboid(pose: Message, extent: Message) -> tuple[SE3, Size]:
    """Return `frame_SE3_box` and size of what a message gives as pose and extent along x, y, z."""
    return rigid_transform(pose.position, pose.orientation), _size_m(extent)


def _size_m(extent: Message) -> Size:
    """Return the size whose length is along x, as a `Vector3` in metres gives it."""
    return float(extent.y), float(extent.x), float(extent.z)


def _name_of(label: int, names: Sequence[str]) -> str:
    return names[label] if label < len(names) else f"class_{label}"
