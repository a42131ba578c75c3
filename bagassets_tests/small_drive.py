"""A few seconds of a drive, written with the real writers of each format.

One camera (rgb8, no distortion), one lidar, odometry at 50 Hz, static transforms: the vehicle goes
straight ahead at `SPEED_MPS`, so every pose is known in closed form.
"""

from pathlib import Path

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START_NS = 1_700_000_000_000_000_000
SPEED_MPS = 8.0
LATENCY_NS = 3_000_000
WIDTH, HEIGHT = 32, 24
# Optical axes in the vehicle: z forward, x right, y down.
OPTICAL_XYZW = (-0.5, 0.5, -0.5, 0.5)

STORE1 = get_typestore(Stores.ROS1_NOETIC)
STORE1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage"))
STORE2 = get_typestore(Stores.ROS2_HUMBLE)

RECIPE = """scenes: {{min_length_s: 0.5}}
name: {name}
bags: {{root: {root}, settle_s: 0}}
nuscenes: {{version: v1.0-test}}
rigs:
  - name: car
    ego_pose: {{source: odometry, topic: /odom}}
    channels:
      CAM_FRONT: {{modality: camera, topic: /cam/image_raw}}
      LIDAR_TOP: {{modality: lidar, topic: /points}}
"""


def messages(store, duration_s=3.0, ros1=False):
    """Yield (topic, type, header stamp, message) of the drive, in order of time."""
    types = store.types

    def header(stamp_ns, frame):
        stamp = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        fields = {"stamp": stamp, "frame_id": frame}
        return types["std_msgs/msg/Header"](**({"seq": 0} if ros1 else {}), **fields)

    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    quaternion = types["geometry_msgs/msg/Quaternion"]
    events = [(START_NS, "static")]
    events += [(START_NS + i * 20_000_000, "odom") for i in range(int(duration_s * 50) + 1)]
    events += [(START_NS + 10_000_000 + i * 100_000_000, "camera") for i in range(int(duration_s * 10) - 1)]
    events += [(START_NS + 5_000_000 + i * 100_000_000, "lidar") for i in range(int(duration_s * 10) - 1)]
    for stamp_ns, kind in sorted(events):
        if kind == "static":
            transform = types["geometry_msgs/msg/Transform"]
            stamped = types["geometry_msgs/msg/TransformStamped"]
            edges = [
                stamped(
                    header(stamp_ns, "base_link"),
                    "cam",
                    transform(vector(1.5, 0.0, 1.2), quaternion(*OPTICAL_XYZW)),
                ),
                stamped(
                    header(stamp_ns, "base_link"),
                    "lidar",
                    transform(vector(0.5, 0.0, 1.8), quaternion(0.0, 0.0, 0.0, 1.0)),
                ),
            ]
            yield "/tf_static", "tf2_msgs/msg/TFMessage", stamp_ns, types["tf2_msgs/msg/TFMessage"](edges)
        elif kind == "odom":
            x = SPEED_MPS * (stamp_ns - START_NS) / 1e9
            pose = types["geometry_msgs/msg/Pose"](point(x, 0.0, 0.0), quaternion(0.0, 0.0, 0.0, 1.0))
            twist = types["geometry_msgs/msg/Twist"](vector(SPEED_MPS, 0.0, 0.0), vector(0.0, 0.0, 0.0))
            zeros = np.zeros(36)
            yield (
                "/odom",
                "nav_msgs/msg/Odometry",
                stamp_ns,
                types["nav_msgs/msg/Odometry"](
                    header(stamp_ns, "odom"),
                    "base_link",
                    types["geometry_msgs/msg/PoseWithCovariance"](pose, zeros),
                    types["geometry_msgs/msg/TwistWithCovariance"](twist, zeros),
                ),
            )
        elif kind == "camera":
            rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
            image = np.stack([columns * 8, rows * 10, np.full_like(rows, 60)], axis=2).astype(np.uint8)
            yield (
                "/cam/image_raw",
                "sensor_msgs/msg/Image",
                stamp_ns,
                types["sensor_msgs/msg/Image"](
                    header(stamp_ns, "cam"), HEIGHT, WIDTH, "rgb8", 0, WIDTH * 3, image.reshape(-1)
                ),
            )
            k = np.array([30.0, 0, 16, 0, 30, 12, 0, 0, 1])
            p = np.array([30.0, 0, 16, 0, 0, 30, 12, 0, 0, 0, 1, 0])
            names = ("D", "K", "R", "P") if ros1 else ("d", "k", "r", "p")
            values = dict(zip(names, (np.zeros(5), k, np.eye(3).reshape(-1), p), strict=True))
            roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
            yield "/cam/camera_info", "sensor_msgs/msg/CameraInfo", stamp_ns, types["sensor_msgs/msg/CameraInfo"](
                header=header(stamp_ns, "cam"), height=HEIGHT, width=WIDTH, distortion_model="plumb_bob",
                binning_x=0, binning_y=0, roi=roi, **values,
            )  # fmt: skip
        else:
            field = types["sensor_msgs/msg/PointField"]
            fields = [field(name, 4 * i, 7, 1) for i, name in enumerate(("x", "y", "z", "intensity"))]
            points = np.array([[5.0, y, 0.0, 10.0] for y in np.linspace(-3, 3, 50)], dtype=np.float32)
            yield "/points", "sensor_msgs/msg/PointCloud2", stamp_ns, types["sensor_msgs/msg/PointCloud2"](
                header(stamp_ns, "lidar"), 1, len(points), fields, False, 16, 16 * len(points),
                points.view(np.uint8).reshape(-1), True,
            )  # fmt: skip


def as_it_is(_topic, _number, message, log_ns):
    return [(log_ns, message)]


def write_drive(
    path: Path, file_format: str, duration_s=3.0, keep=lambda _topic, _stamp_ns: True, change=as_it_is
) -> Path:
    """Write the drive as `ros1` (.bag), `ros2` (a folder) or `mcap`; return its path.

    Args:
        path: of the file or folder.
        file_format: of the three.
        duration_s: of the drive.
        keep: topic, header stamp -> whether a message is written.
        change: topic, number of the message on it, message, log time -> (log time, message, or its bytes) of what is written.
    """

    store = STORE1 if file_format == "ros1" else STORE2

    def kept():
        numbers = {}
        for topic, msgtype, stamp_ns, message in messages(store, duration_s, ros1=store is STORE1):
            if not keep(topic, stamp_ns):
                continue
            numbers[topic] = numbers.get(topic, -1) + 1
            for log_ns, one in change(topic, numbers[topic], message, stamp_ns + LATENCY_NS):
                yield topic, msgtype, stamp_ns, log_ns, one

    return write_messages(path, file_format, store, kept())


def write_messages(path: Path, file_format: str, store, items) -> Path:
    """Write messages, as `write_drive` does, and return their path.

    Args:
        path: of the file or folder.
        file_format: `ros1`, `ros2` or `mcap`.
        store: has their types.
        items: (topic, type, header stamp, log time, message or its bytes) of each.
    """
    serialize = store.serialize_ros1 if file_format == "ros1" else store.serialize_cdr
    packed = (
        (topic, msgtype, stamp_ns, log_ns, one if isinstance(one, bytes) else bytes(serialize(one, msgtype)))
        for topic, msgtype, stamp_ns, log_ns, one in items
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    channels = {}
    if file_format == "mcap":
        with path.open("wb") as stream:
            writer = McapWriter(stream)
            writer.start(profile="", library="test")
            for topic, msgtype, stamp_ns, log_ns, data in packed:
                if topic not in channels:
                    text, _ = store.generate_msgdef(msgtype, ros_version=2)
                    schema = writer.register_schema(msgtype, "ros2msg", text.encode())
                    channels[topic] = writer.register_channel(topic, "cdr", schema)
                writer.add_message(channels[topic], log_ns, data, stamp_ns)
            writer.finish()
        return path
    with Rosbag1Writer(path) if file_format == "ros1" else Rosbag2Writer(path, version=9) as writer:
        for topic, msgtype, _, log_ns, data in packed:
            if topic not in channels:
                channels[topic] = writer.add_connection(topic, msgtype, typestore=store)
            writer.write(channels[topic], log_ns, data)
    return path
