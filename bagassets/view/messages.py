"""Foxglove messages for the content of a scene. Frames: `global`, `ego`, and one per channel."""

from collections.abc import Iterable, Sequence

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from bagassets.assets.lidar_file import COLUMNS, read_lidar_file
from bagassets.assets.radar_file import FIELDS, read_radar_file
from bagassets.base.json_types import JsonMapping
from bagassets.formats.reader.source import Reading
from bagassets.geometry.se3 import SE3

GLOBAL, EGO = "global", "ego"
_TYPES = {
    "i1": PackedElementField.INT8,
    "u1": PackedElementField.UINT8,
    "i2": PackedElementField.INT16,
    "u2": PackedElementField.UINT16,
    "f4": PackedElementField.FLOAT32,
    "f8": PackedElementField.FLOAT64,
}
# Red, green, blue; dealt to the categories of a scene in their order.
_COLOURS = (
    (1.0, 0.62, 0.0),
    (0.2, 0.65, 1.0),
    (0.3, 0.85, 0.4),
    (0.9, 0.4, 0.85),
    (0.95, 0.85, 0.2),
    (0.4, 0.9, 0.9),
)
_OPACITY = 0.4


def stamp(stamp_ns: int) -> Timestamp:
    """Return a time."""
    return Timestamp(seconds=stamp_ns // 10**9, nanos=stamp_ns % 10**9)


def image(reading: Reading) -> CompressedImage:
    """Return an image: the bytes of its file."""
    kind = {".jpg": "jpeg", ".png": "png"}[reading.path.suffix]
    data = reading.path.read_bytes()
    return CompressedImage(
        timestamp=stamp(reading.stamp_ns), frame_id=reading.channel, format=kind, data=data
    )


def calibration(reading: Reading) -> CameraCalibration:
    """Return the pinhole camera of an image as written; nuScenes has no distortion."""
    rows = [[float(value) for value in row] for row in reading.intrinsics or ()]
    width, height = reading.size_px
    return CameraCalibration(
        timestamp=stamp(reading.stamp_ns),
        frame_id=reading.channel,
        width=width,
        height=height,
        K=[value for row in rows for value in row],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[value for row in rows for value in (*row, 0.0)],
    )


def cloud(reading: Reading) -> PointCloud:
    """Return a lidar revolution or the targets of a radar, in the frame of the sensor, with all their fields."""
    points: NDArray[np.float32] | NDArray[np.void]
    if reading.modality == "lidar":
        points = np.ascontiguousarray(read_lidar_file(reading.path))
        fields = [(name, 4 * number, "f4") for number, name in enumerate(COLUMNS)]
        stride = 4 * len(COLUMNS)
    else:
        targets = points = read_radar_file(reading.path)
        layout = targets.dtype
        fields, stride = [], 0
        for name in FIELDS:  # packed, without padding
            fields.append((name, stride, layout[name].str[1:]))
            stride += layout[name].itemsize
    return PointCloud(
        timestamp=stamp(reading.stamp_ns),
        frame_id=reading.channel,
        pose=_pose(SE3()),
        point_stride=stride,
        fields=[PackedElementField(name=name, offset=at, type=_TYPES[kind]) for name, at, kind in fields],
        data=points.tobytes(),
    )


def transforms(stamp_ns: int, edges: Iterable[tuple[str, str, SE3]]) -> FrameTransforms:
    """Return transforms, given as parent, child and `parent_SE3_child`."""
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=stamp(stamp_ns),
                parent_frame_id=parent,
                child_frame_id=child,
                translation=_vector(parent_SE3_child.translation),
                rotation=_quaternion(parent_SE3_child.rotation),
            )
            for parent, child, parent_SE3_child in edges
        ]
    )


def pose(stamp_ns: int, global_SE3_ego: SE3) -> PoseInFrame:
    """Return the pose of the vehicle."""
    return PoseInFrame(timestamp=stamp(stamp_ns), frame_id=GLOBAL, pose=_pose(global_SE3_ego))


def path(stamp_ns: int, poses: Iterable[SE3]) -> PosesInFrame:
    """Return the trajectory of the whole scene."""
    return PosesInFrame(timestamp=stamp(stamp_ns), frame_id=GLOBAL, poses=[_pose(one) for one in poses])


def location(stamp_ns: int, lat_deg: float, lon_deg: float, alt_m: float | None) -> LocationFix:
    """Return a place on Earth."""
    return LocationFix(
        timestamp=stamp(stamp_ns), frame_id=EGO, latitude=lat_deg, longitude=lon_deg, altitude=alt_m or 0.0
    )


def boxes(stamp_ns: int, rows: Sequence[JsonMapping], categories: Sequence[str]) -> SceneUpdate:
    """Return the boxes of a sample, which replace those of the previous one.

    Args:
        stamp_ns: stamp of the sample.
        rows: rows of sample_annotation, with `category` and `attributes` by name.
        categories: all categories of the scene in order, for colours.
    """
    everything = SceneEntityDeletion(timestamp=stamp(stamp_ns), type=SceneEntityDeletion.ALL)
    return SceneUpdate(deletions=[everything], entities=[_entity(stamp_ns, row, categories) for row in rows])


def _entity(stamp_ns: int, row: JsonMapping, categories: Sequence[str]) -> SceneEntity:
    width_m, length_m, height_m = row["size"]
    metadata = {
        "category": row["category"],
        "attributes": ", ".join(row["attributes"]),
        "num_lidar_pts": str(row["num_lidar_pts"]),
        "num_radar_pts": str(row["num_radar_pts"]),
        "visibility": str(row["visibility_token"]),
        "token": row["token"],
    }
    red, green, blue = _COLOURS[categories.index(row["category"]) % len(_COLOURS)]
    cube = CubePrimitive(
        pose=_pose(SE3.create(row["rotation"], row["translation"])),
        size=Vector3(x=length_m, y=width_m, z=height_m),
        color=Color(r=red, g=green, b=blue, a=_OPACITY),
    )
    return SceneEntity(
        timestamp=stamp(stamp_ns),
        frame_id=GLOBAL,
        id=row["instance_token"],
        metadata=[KeyValuePair(key=key, value=value) for key, value in metadata.items()],
        cubes=[cube],
    )


def _pose(transform: SE3) -> Pose:
    return Pose(position=_vector(transform.translation), orientation=_quaternion(transform.rotation))


def _vector(values: Sequence[float]) -> Vector3:
    x, y, z = values
    return Vector3(x=x, y=y, z=z)


def _quaternion(values: Sequence[float]) -> Quaternion:
    w, x, y, z = values
    return Quaternion(x=x, y=y, z=z, w=w)
