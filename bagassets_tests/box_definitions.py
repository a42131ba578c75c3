"""Messages that carry boxes, as their packages define them: fields in their order, with their constants.

A recording holds such a text with each topic, so a decoder meets types made from it, never ours.
"""

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg

_CLASSIFICATION = """
uint8 UNKNOWN=0
uint8 CAR=1
uint8 TRUCK=2
uint8 BUS=3
uint8 TRAILER=4
uint8 MOTORCYCLE=5
uint8 BICYCLE=6
uint8 PEDESTRIAN=7
{more}
uint8 label
float32 probability
"""
_MORE_CLASSES = "uint8 ANIMAL=8\nuint8 HAZARD=9\nuint8 OVER_DRIVABLE=10\nuint8 UNDER_DRIVABLE=11"
_SHAPE = """
uint8 BOUNDING_BOX=0
uint8 CYLINDER=1
uint8 POLYGON=2
uint8 type
geometry_msgs/Polygon footprint
geometry_msgs/Vector3 dimensions
"""
_ORIENTATION = "uint8 UNAVAILABLE=0\nuint8 SIGN_UNKNOWN=1\nuint8 AVAILABLE=2\n"
_POSE = "geometry_msgs/PoseWithCovariance pose_with_covariance\n"
_TWIST = "geometry_msgs/TwistWithCovariance twist_with_covariance\n"
_ACCELERATION = "geometry_msgs/AccelWithCovariance acceleration_with_covariance\n"
_AVAILABLE = "uint8 orientation_availability\n"


def _autoware(package, tracked_kinematics, more_classes):
    return {
        f"{package}/msg/ObjectClassification": _CLASSIFICATION.format(more=more_classes),
        f"{package}/msg/Shape": _SHAPE,
        f"{package}/msg/DetectedObjectKinematics": _ORIENTATION + _POSE + "bool has_position_covariance\n" + _AVAILABLE
        + _TWIST + "bool has_twist\nbool has_twist_covariance\n",
        f"{package}/msg/TrackedObjectKinematics": _ORIENTATION + tracked_kinematics + "bool is_stationary\n",
        f"{package}/msg/DetectedObject": "float32 existence_probability\nObjectClassification[] classification\n"
        "DetectedObjectKinematics kinematics\nShape shape\n",
        f"{package}/msg/TrackedObject": "unique_identifier_msgs/UUID object_id\nfloat32 existence_probability\n"
        "ObjectClassification[] classification\nTrackedObjectKinematics kinematics\nShape shape\n",
        f"{package}/msg/DetectedObjects": "std_msgs/Header header\nDetectedObject[] objects\n",
        f"{package}/msg/TrackedObjects": "std_msgs/Header header\nTrackedObject[] objects\n",
    }  # fmt: skip


_OBJECT = """
std_msgs/Header header
uint32 id
uint8 detection_level
uint8 OBJECT_DETECTED=0
uint8 OBJECT_TRACKED=1
bool object_classified
geometry_msgs/Pose pose
geometry_msgs/Twist twist
geometry_msgs/Accel accel
geometry_msgs/Polygon polygon
shape_msgs/SolidPrimitive shape
uint8 classification
uint8 CLASSIFICATION_UNKNOWN=0
uint8 CLASSIFICATION_UNKNOWN_SMALL=1
uint8 CLASSIFICATION_UNKNOWN_MEDIUM=2
uint8 CLASSIFICATION_UNKNOWN_BIG=3
uint8 CLASSIFICATION_PEDESTRIAN=4
uint8 CLASSIFICATION_BIKE=5
uint8 CLASSIFICATION_CAR=6
uint8 CLASSIFICATION_TRUCK=7
uint8 CLASSIFICATION_MOTORCYCLE=8
uint8 CLASSIFICATION_OTHER_VEHICLE=9
uint8 CLASSIFICATION_BARRIER=10
uint8 CLASSIFICATION_SIGN=11
uint8 classification_certainty
uint32 classification_age
"""
DEFINITIONS = {
    **_autoware("autoware_perception_msgs", _POSE + _TWIST + _ACCELERATION + _AVAILABLE, _MORE_CLASSES),
    **_autoware("autoware_auto_perception_msgs", _POSE + _AVAILABLE + _TWIST + _ACCELERATION, ""),
    "derived_object_msgs/msg/Object": _OBJECT,
    "derived_object_msgs/msg/ObjectArray": "std_msgs/Header header\nderived_object_msgs/Object[] objects\n",
    "jsk_recognition_msgs/msg/BoundingBox": "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    "geometry_msgs/Vector3 dimensions\nfloat32 value\nuint32 label\n",
    "jsk_recognition_msgs/msg/BoundingBoxArray": "std_msgs/Header header\nBoundingBox[] boxes\n",
}


def register(store):
    """Add the definitions to a type store that lacks them."""
    for name, text in DEFINITIONS.items():
        if name not in store.types:
            store.register(get_types_from_msg(text, name))
    return store


class Blank:
    """Makes messages of which only some fields matter.

    Args:
        store: type store with the definitions.
    """

    def __init__(self, store):
        self.store = register(store)

    def __call__(self, name, **fields):
        """Return a message with these fields set and all others zero; a field that the type lacks is an error."""
        _, described = self.store.fielddefs[name]
        values = {field: self._zero(kind) for field, kind in described}
        unknown = set(fields) - set(values)
        assert not unknown, f"{name} has no {unknown}"
        return self.store.types[name](**(values | fields))

    def constants(self, name):
        """Return the constants of a type."""
        return {constant: value for constant, _, value in self.store.fielddefs[name][0]}

    def _zero(self, described):
        kind, what = described
        if kind == Nodetype.NAME:
            return self(what)
        if kind == Nodetype.BASE:
            return {"string": "", "bool": False}.get(what[0], 0.0 if what[0].startswith("float") else 0)
        (inner, inner_what), number = what
        if inner == Nodetype.BASE and inner_what[0] != "string":
            return np.zeros(number if kind == Nodetype.ARRAY else 0, inner_what[0])
        return []
