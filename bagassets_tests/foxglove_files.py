"""MCAP files with Foxglove's messages as robots write them: protobuf by the real foxglove-sdk, JSON by schema, ROS 2 CDR.

The three say the same. Content is written down once, with `M` for a message and `T` for a time; fields in the order of
`foxglove_msgs`.
"""

import base64
import json

import foxglove
import numpy as np
from foxglove import messages as sdk
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

NS = 1_700_000_000_123_456_789  # not representable in a double
NUMERIC = {
    1: "Uint8",
    2: "Int8",
    3: "Uint16",
    4: "Int16",
    5: "Uint32",
    6: "Int32",
    7: "Float32",
    8: "Float64",
}
_PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg=="
)  # a black pixel
_GEOMETRY = {"Vector3", "Point3", "Quaternion", "Pose"}


class M:
    """A message of a type of Foxglove's."""

    def __init__(self, kind, **fields):
        self.kind, self.fields = kind, fields


class T(int):
    """A time in nanoseconds."""


class E(int):
    """A number of `NumericType`."""


def pose(x=0.0, y=0.0, z=0.0, rotation=(1.0, 0.0, 0.0, 0.0)):
    w, qx, qy, qz = rotation
    return M("Pose", position=M("Vector3", x=x, y=y, z=z), orientation=M("Quaternion", x=qx, y=qy, z=qz, w=w))


# Types of foxglove_msgs, abridged to the fields that these tests fill.
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
_TEXTS = {
    "CompressedImage": "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n",
    "CompressedVideo": "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n",
    "RawImage": "builtin_interfaces/Time timestamp\nstring frame_id\nuint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data\n",
    "PackedElementField": "string name\nuint32 offset\nuint8 type\n",
    "PointCloud": "builtin_interfaces/Time timestamp\nstring frame_id\ngeometry_msgs/Pose pose\nuint32 point_stride\nfoxglove_msgs/PackedElementField[] fields\nuint8[] data\n",
    "LaserScan": "builtin_interfaces/Time timestamp\nstring frame_id\ngeometry_msgs/Pose pose\nfloat64 start_angle\nfloat64 end_angle\nfloat64[] ranges\nfloat64[] intensities\n",
    "FrameTransform": "builtin_interfaces/Time timestamp\nstring parent_frame_id\nstring child_frame_id\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "FrameTransforms": "foxglove_msgs/FrameTransform[] transforms\n",
    "PoseInFrame": "builtin_interfaces/Time timestamp\nstring frame_id\ngeometry_msgs/Pose pose\n",
    "Odometry": "builtin_interfaces/Time timestamp\nstring frame_id\nstring body_frame_id\ngeometry_msgs/Pose pose\n",
    "LocationFix": "builtin_interfaces/Time timestamp\nstring frame_id\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude\n",
    "CameraCalibration": "builtin_interfaces/Time timestamp\nstring frame_id\nuint32 width\nuint32 height\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\n",
    "KeyValuePair": "string key\nstring value\n",
    "CubePrimitive": "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 size\n",
    "SceneEntity": "builtin_interfaces/Time timestamp\nstring frame_id\nstring id\nfoxglove_msgs/KeyValuePair[] metadata\nfoxglove_msgs/CubePrimitive[] cubes\n",
    "SceneUpdate": "foxglove_msgs/SceneEntity[] entities\n",
}  # fmt: skip
for _name, _text in _TEXTS.items():
    ROS2.register(get_types_from_msg(_text, f"foxglove_msgs/msg/{_name}"))


def examples():
    """Return a message of each type that is read."""

    def stamped(kind, **fields):
        return M(kind, timestamp=T(NS), frame_id="/sensor", **fields)

    edge = M(
        "FrameTransform", timestamp=T(NS), parent_frame_id="/base", child_frame_id="/sensor",
        translation=M("Vector3", x=1.0, y=0.0, z=0.0), rotation=M("Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )  # fmt: skip
    columns = [
        M("PackedElementField", name=name, offset=4 * n, type=E(7)) for n, name in enumerate(("x", "y", "z"))
    ]
    points = np.arange(12, dtype="<f4").tobytes()
    k = [100.0, 0.0, 32.0, 0.0, 100.0, 24.0, 0.0, 0.0, 1.0]
    r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    lens = {"distortion_model": "plumb_bob", "D": [0.1, 0.0, 0.0, 0.0, 0.0]}
    pairs = [
        M("KeyValuePair", key=key, value=value) for key, value in {"category": "car", "score": "1"}.items()
    ]
    cube = M("CubePrimitive", pose=pose(1.0), size=M("Vector3", x=4.0, y=2.0, z=1.5))
    return [
        stamped("CompressedImage", data=_PNG, format="png"),
        stamped("CompressedVideo", data=b"\0\0\0\1\x65\x88\x84", format="h264"),
        stamped("RawImage", width=4, height=2, encoding="rgb8", step=12, data=bytes(range(24))),
        stamped("PointCloud", pose=pose(), point_stride=12, fields=columns, data=points),
        stamped(
            "LaserScan",
            pose=pose(),
            start_angle=0.0,
            end_angle=1.5,
            ranges=[1.0, 2.0],
            intensities=[5.0, 6.0],
        ),
        edge,
        M("FrameTransforms", transforms=[edge, edge]),
        stamped("PoseInFrame", pose=pose(1.5)),
        stamped("Odometry", body_frame_id="base", pose=pose(1.5)),
        stamped("LocationFix", latitude=48.25, longitude=11.5, altitude=500.0),
        stamped(
            "CameraCalibration",
            width=64,
            height=48,
            **lens,
            K=k,
            R=r,
            P=[*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
        ),
        M("SceneUpdate", entities=[stamped("SceneEntity", id="a", metadata=pairs, cubes=[cube])]),
    ]


def as_sdk(value):
    """Return a value for the foxglove-sdk."""
    match value:
        case M():
            fields = {name: as_sdk(one) for name, one in value.fields.items()}
            return getattr(sdk, value.kind)(**fields)
        case T():
            return sdk.Timestamp(sec=value // 10**9, nsec=value % 10**9)
        case E():
            return getattr(sdk.PackedElementFieldNumericType, NUMERIC[value])
        case list():
            return [as_sdk(one) for one in value]
    return value


def as_json(value):
    """Return a value as in JSON."""
    match value:
        case M():
            return {name: as_json(one) for name, one in value.fields.items()}
        case T():
            return {"sec": value // 10**9, "nsec": value % 10**9}
        case bytes():
            return base64.b64encode(value).decode()
        case list():
            return [as_json(one) for one in value]
    return value


def schema_of(value):
    """Return the JSON schema of a value, as https://github.com/foxglove/foxglove-sdk generates it."""
    match value:
        case M():
            properties = {name: schema_of(one) for name, one in value.fields.items()}
            return {"title": f"foxglove.{value.kind}", "type": "object", "properties": properties}
        case T():
            parts = {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}
            return {"type": "object", "title": "time", "properties": parts}
        case E():
            return {
                "title": "foxglove.NumericType",
                "oneOf": [{"title": n, "const": i} for i, n in NUMERIC.items()],
            }
        case bytes():
            return {"type": "string", "contentEncoding": "base64"}
        case list():
            return {"type": "array", "items": schema_of(value[0]) if value else {"type": "number"}}
    return {"type": {str: "string", float: "number", int: "integer"}[type(value)], "description": "a comment"}


def as_ros(value, msgtype=None):
    """Return a value as an object of rosbags."""
    match value:
        case M():
            package = "geometry_msgs" if value.kind in _GEOMETRY else "foxglove_msgs"
            kind = {"Point3": "Point"}.get(value.kind, value.kind)
            made = ROS2.types[msgtype or f"{package}/msg/{kind}"]
            fields = {name.lower(): as_ros(one) for name, one in value.fields.items()}
            if kind == "Pose":
                position = value.fields["position"].fields
                fields["position"] = ROS2.types["geometry_msgs/msg/Point"](**position)
            return made(**fields)
        case T():
            return ROS2.types["builtin_interfaces/msg/Time"](sec=value // 10**9, nanosec=value % 10**9)
        case bytes():
            return np.frombuffer(value, np.uint8)
        case list() if value and isinstance(value[0], M):
            return [as_ros(one) for one in value]
        case list():
            return np.array(value, np.float64)
    return int(value) if isinstance(value, E) else value


def write_protobuf(path, items):
    """Write (topic, log time, message) with the foxglove-sdk."""
    from foxglove import channels

    made = {}
    context = foxglove.Context()
    with foxglove.open_mcap(path, allow_overwrite=True, context=context):
        for topic, log_time_ns, message in items:
            if topic not in made:
                made[topic] = getattr(channels, f"{message.kind}Channel")(topic, context=context)
            made[topic].log(as_sdk(message), log_time=log_time_ns)
    return path


def write_json(path, items):
    return _write(
        path, items, "json", lambda message: json.dumps(as_json(message)).encode(),
        lambda message: (f"foxglove.{message.kind}", "jsonschema", json.dumps(schema_of(message)).encode()),
    )  # fmt: skip


def write_cdr(path, items):
    def definition(message):
        name = f"foxglove_msgs/msg/{message.kind}"
        return name, "ros2msg", ROS2.generate_msgdef(name, ros_version=2)[0].encode()

    def data(message):
        return bytes(ROS2.serialize_cdr(as_ros(message), f"foxglove_msgs/msg/{message.kind}"))

    return _write(path, items, "cdr", data, definition)


def _write(path, items, encoding, data_of, schema_of_message):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {}
        for topic, log_time_ns, message in items:
            if topic not in channels:
                schema = writer.register_schema(*schema_of_message(message))
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], log_time_ns, data_of(message), log_time_ns)
        writer.finish()
    return path


WRITERS = {"protobuf": write_protobuf, "json": write_json, "cdr": write_cdr}
