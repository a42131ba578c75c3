"""ROS messages of the sample drive, for ROS 1 and ROS 2 from one description."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from bagassets.geometry.se3 import SE3, Floats
from bagassets.recordings.model import Message
from bagassets.sample.rig import Camera
from bagassets.sample.truth import TruthBox

# Types that rosbags lacks in one or both ROS versions.
_DEFINITIONS = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose\n",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox3D bbox\nstring id\n",
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
    "radar_msgs/msg/RadarReturn": "float32 range\nfloat32 azimuth\nfloat32 elevation\nfloat32 doppler_velocity\n"
    "float32 amplitude\n",
    "radar_msgs/msg/RadarScan": "std_msgs/Header header\nradar_msgs/RadarReturn[] returns\n",
    "velodyne_msgs/msg/VelodynePacket": "{time} stamp\nuint8[1206] data\n",
    "velodyne_msgs/msg/VelodyneScan": "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
}

# numpy kind -> datatype of sensor_msgs/PointField.
_POINT_FIELD_TYPES = {"u1": 2, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def typestore(*, ros1: bool) -> Typestore:
    """Return a type store of one ROS version with all types of the sample."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    time = "time" if ros1 else "builtin_interfaces/Time"
    for name, text in _DEFINITIONS.items():
        if name not in store.types:
            store.register(get_types_from_msg(text.format(time=time), name))
    return store


class Messages:
    """Makes messages.

    Args:
        ros1: for ROS 1, whose headers count and whose CameraInfo has capitals.
    """

    def __init__(self, *, ros1: bool) -> None:
        self.ros1 = ros1
        self.store = typestore(ros1=ros1)

    def make(self, msgtype: str, *values: Any, **fields: Any) -> Message:
        """Return a message of a type, written `pkg/Type`."""
        package, name = msgtype.split("/")
        return cast("Message", self.store.types[f"{package}/msg/{name}"](*values, **fields))

    def time(self, stamp_ns: int) -> Message:
        """Return a stamp."""
        return self.make("builtin_interfaces/Time", stamp_ns // 10**9, stamp_ns % 10**9)

    def header(self, stamp_ns: int, frame: str) -> Message:
        """Return a header."""
        sequence = (0,) if self.ros1 else ()
        return self.make("std_msgs/Header", *sequence, self.time(stamp_ns), frame)

    def image(self, stamp_ns: int, frame: str, encoding: str, pixels: NDArray[np.uint8]) -> Message:
        """Return `sensor_msgs/Image` of (H, W) or (H, W, C) pixels."""
        height, width = pixels.shape[:2]
        data = np.ascontiguousarray(pixels).reshape(-1)
        header = self.header(stamp_ns, frame)
        return self.make("sensor_msgs/Image", header, height, width, encoding, 0, len(data) // height, data)

    def compressed_image(self, stamp_ns: int, frame: str, kind: str, data: bytes) -> Message:
        """Return `sensor_msgs/CompressedImage`."""
        header = self.header(stamp_ns, frame)
        return self.make("sensor_msgs/CompressedImage", header, kind, np.frombuffer(data, np.uint8))

    def camera_info(self, stamp_ns: int, camera: Camera) -> Message:
        """Return `sensor_msgs/CameraInfo` of a camera."""
        model, names = camera.model, "DKRP" if self.ros1 else "dkrp"
        k, p = model.matrix, np.zeros((3, 4))
        p[:, :3] = k
        matrices = (np.array(model.distortion), k.reshape(-1), np.eye(3).reshape(-1), p.reshape(-1))
        return self.make(
            "sensor_msgs/CameraInfo",
            header=self.header(stamp_ns, camera.frame),
            width=model.width,
            height=model.height,
            distortion_model=model.model,
            binning_x=0,
            binning_y=0,
            roi=self.make("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False),
            **dict(zip(names, matrices, strict=True)),
        )

    def cloud(self, stamp_ns: int, frame: str, points: NDArray[np.void]) -> Message:
        """Return `sensor_msgs/PointCloud2` with the fields of a structured array."""
        kinds: Mapping[str, tuple[np.dtype[Any], int]] = points.dtype.fields  # type: ignore[assignment]  # (dtype, offset, title)
        fields = [
            self.make("sensor_msgs/PointField", name, kind[1], _POINT_FIELD_TYPES[kind[0].str[1:]], 1)
            for name, kind in kinds.items()
        ]
        step, data = points.dtype.itemsize, np.frombuffer(points.tobytes(), np.uint8)
        return self.make(
            "sensor_msgs/PointCloud2", self.header(stamp_ns, frame), 1, len(points), fields, False, step,
            step * len(points), data, False,
        )  # fmt: skip

    def transforms(self, stamp_ns: int, parent: str, children: Sequence[tuple[str, SE3]]) -> Message:
        """Return `tf2_msgs/TFMessage` with `parent_SE3_child` of each child."""
        edges = []
        for child, parent_SE3_child in children:
            translation = self.make("geometry_msgs/Vector3", *parent_SE3_child.translation)
            value = self.make("geometry_msgs/Transform", translation, self._quaternion(parent_SE3_child))
            edges.append(
                self.make("geometry_msgs/TransformStamped", self.header(stamp_ns, parent), child, value)
            )
        return self.make("tf2_msgs/TFMessage", edges)

    def odometry(self, stamp_ns: int, odom_SE3_ego: SE3, speed_mps: float, yaw_rate: float) -> Message:
        """Return `nav_msgs/Odometry` of `base_link` in `odom`; the twist is that of the car, rad/s."""
        twist = self.make(
            "geometry_msgs/Twist", self._vector(speed_mps, 0.0, 0.0), self._vector(0.0, 0.0, yaw_rate)
        )
        return self.make(
            "nav_msgs/Odometry",
            self.header(stamp_ns, "odom"),
            "base_link",
            self.make("geometry_msgs/PoseWithCovariance", self._pose(odom_SE3_ego), np.zeros(36)),
            self.make("geometry_msgs/TwistWithCovariance", twist, np.zeros(36)),
        )

    def fix(self, stamp_ns: int, frame: str, lat_deg: float, lon_deg: float, alt_m: float) -> Message:
        """Return `sensor_msgs/NavSatFix`."""
        status = self.make("sensor_msgs/NavSatStatus", 0, 1)
        return self.make(
            "sensor_msgs/NavSatFix", self.header(stamp_ns, frame), status, lat_deg, lon_deg, alt_m,
            np.array([1e-4, 0, 0, 0, 1e-4, 0, 0, 0, 4e-4]), 2,
        )  # fmt: skip

    def imu(self, stamp_ns: int, frame: str, enu_SE3_ego: SE3, rate: Floats, acceleration: Floats) -> Message:
        """Return `sensor_msgs/Imu`: turn rate in rad/s and acceleration in m/s², both in the car."""
        small = np.diag([1e-6] * 3).reshape(-1)
        return self.make(
            "sensor_msgs/Imu", self.header(stamp_ns, frame), self._quaternion(enu_SE3_ego), small,
            self._vector(*rate), small, self._vector(*acceleration), small,
        )  # fmt: skip

    def detections(self, stamp_ns: int, frame: str, boxes: Sequence[TruthBox]) -> Message:
        """Return `vision_msgs/Detection3DArray` of boxes, which must be in `frame`."""
        header, detections = self.header(stamp_ns, frame), []
        for box in boxes:
            pose, (width, length, height) = self._pose(box.odom_SE3_box), box.size_m
            covariance = self.make("geometry_msgs/PoseWithCovariance", pose, np.zeros(36))
            guess = self.make("vision_msgs/ObjectHypothesis", box.category, 1.0)
            result = self.make("vision_msgs/ObjectHypothesisWithPose", guess, covariance)
            bounds = self.make("vision_msgs/BoundingBox3D", pose, self._vector(length, width, height))
            detections.append(
                self.make("vision_msgs/Detection3D", header, [result], bounds, str(box.track_id))
            )
        return self.make("vision_msgs/Detection3DArray", header, detections)

    def velodyne_scan(self, frame: str, stamps_ns: Sequence[int], packets: NDArray[np.uint8]) -> Message:
        """Return `velodyne_msgs/VelodyneScan` of (M, 1206) packets."""
        made = [
            self.make("velodyne_msgs/VelodynePacket", self.time(stamp_ns), data)
            for stamp_ns, data in zip(stamps_ns, packets, strict=True)
        ]
        return self.make("velodyne_msgs/VelodyneScan", self.header(stamps_ns[0], frame), made)

    def _vector(self, x: float, y: float, z: float) -> Message:
        return self.make("geometry_msgs/Vector3", float(x), float(y), float(z))

    def _quaternion(self, transform: SE3) -> Message:
        w, x, y, z = transform.rotation
        return self.make("geometry_msgs/Quaternion", x, y, z, w)

    def _pose(self, transform: SE3) -> Message:
        return self.make(
            "geometry_msgs/Pose",
            self.make("geometry_msgs/Point", *transform.translation),
            self._quaternion(transform),
        )
