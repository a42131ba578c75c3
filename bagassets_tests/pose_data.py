"""Messages of poses, transforms, positions and calibrations, and a recording that holds them.

The recording stands in for a file: the data of a message is the decoded message itself. How files
of each format are read is tested elsewhere.
"""

from types import MappingProxyType
from types import SimpleNamespace as Msg

import numpy as np

from bagassets.base.errors import DecodeError
from bagassets.recordings.inventory import Inventory, TopicRecord
from bagassets.recordings.model import Definition, RawMessage
from bagassets.store.artifact import Artifact, ArtifactWriter

S = 1_000_000_000
T0 = 1_700_000_000 * S

TFMESSAGE = "tf2_msgs/msg/TFMessage"
ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
NAVSAT = "sensor_msgs/msg/NavSatFix"
IMU = "sensor_msgs/msg/Imu"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMAGE = "sensor_msgs/msg/Image"
CLOUD = "sensor_msgs/msg/PointCloud2"


class Recorded:
    """A recording made of `(topic, msgtype, log_time_ns, message)`."""

    def __init__(self, *entries, topics=()):
        self._messages = sorted(
            (RawMessage(topic, msgtype, log_ns, message) for topic, msgtype, log_ns, message in entries),
            key=lambda message: message.log_time_ns,
        )
        self.topics = {name: _topic(name, msgtype, 0) for name, msgtype in topics}
        for message in self._messages:
            count = self.topics[message.topic].count if message.topic in self.topics else 0
            self.topics[message.topic] = _topic(message.topic, message.msgtype, count + 1)
        self.read: list[str] = []
        self.decoded = 0

    def messages(self, topics):
        for topic in topics:
            if topic not in self.topics:
                raise KeyError(topic)
        self.read += topics
        return (message for message in self._messages if message.topic in set(topics))

    def decode(self, message):
        self.decoded += 1
        if isinstance(message.data, DecodeError):
            raise message.data
        return message.data

    def inventory(self):
        """The inventory of the recording, with what planning reads of it."""
        records = {}
        for name, info in sorted(self.topics.items()):
            held = [message for message in self._messages if message.topic == name]
            frames = dict.fromkeys(
                message.data.header.frame_id.lstrip("/")
                for message in held
                if hasattr(message.data, "header")
            )
            known = {
                "name": name, "msgtype": info.msgtype, "count": len(held), "bytes": 1, "digest": name.encode().hex(),
                "gaps": (), "gap_count": 0, "unordered_stamps": 0, "frame_ids": tuple(frames), "serialization": "cdr",
                "packed": True, "definition": Definition("none", ""),
            }  # fmt: skip
            fields = dict.fromkeys(TopicRecord.__dataclass_fields__) | known
            records[name] = TopicRecord(**fields)
        return Inventory("mcap", 1, T0, T0 + S, MappingProxyType(records), None, None, ())


def _topic(name, msgtype, count):
    return Msg(name=name, msgtype=msgtype, count=count, unstamped=_unstamped)


def _unstamped(message):
    """What differs unless only the stamps do, as `Topic.unstamped`."""
    if not hasattr(message, "header"):
        return None
    others = {name: value for name, value in vars(message).items() if name != "header"}
    return repr((message.header.frame_id, sorted(others.items()))).encode()


def header(stamp_ns, frame):
    return Msg(stamp=Msg(sec=stamp_ns // S, nanosec=stamp_ns % S), frame_id=frame)


def vector(xyz):
    x, y, z = (float(v) for v in xyz)
    return Msg(x=x, y=y, z=z)


def quaternion(wxyz):
    w, x, y, z = (float(v) for v in wxyz)
    return Msg(w=w, x=x, y=y, z=z)


def pose(value):
    return Msg(position=vector(value.translation), orientation=quaternion(value.rotation))


def odometry(stamp_ns, value, child="base_link", frame="odom"):
    covered = Msg(pose=pose(value), covariance=np.zeros(36))
    return Msg(header=header(stamp_ns, frame), child_frame_id=child, pose=covered)


def pose_stamped(stamp_ns, value, frame="map"):
    return Msg(header=header(stamp_ns, frame), pose=pose(value))


def pose_with_covariance(stamp_ns, value, frame="map"):
    covered = Msg(pose=pose(value), covariance=np.zeros(36))
    return Msg(header=header(stamp_ns, frame), pose=covered)


def transform(stamp_ns, parent, child, value):
    moved = Msg(translation=vector(value.translation), rotation=quaternion(value.rotation))
    return Msg(header=header(stamp_ns, parent), child_frame_id=child, transform=moved)


def tf(*transforms):
    return Msg(transforms=list(transforms))


def fix(stamp_ns, lat, lon, alt=0.0, status=0, frame="gps"):
    return Msg(
        header=header(stamp_ns, frame), status=Msg(status=status), latitude=lat, longitude=lon, altitude=alt
    )


def imu(stamp_ns, wxyz, covariance=0.01, frame="imu"):
    return Msg(
        header=header(stamp_ns, frame),
        orientation=quaternion(wxyz),
        orientation_covariance=np.array([covariance] + [0.0] * 8),
    )


def region(x=0, y=0, width=0, height=0):
    return Msg(x_offset=x, y_offset=y, width=width, height=height, do_rectify=False)


def camera_info(stamp_ns=T0, frame="cam", *, model="plumb_bob", d=(0.0,) * 5, ros1=False, **changes):
    fx, fy, cx, cy = changes.pop("k", (400.0, 410.0, 320.0, 240.0))
    k = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0])
    matrices = {"d": np.array(d), "k": k, "r": np.eye(3).reshape(-1), "p": np.zeros(12)}
    matrices = {name.upper() if ros1 else name: value for name, value in matrices.items()}
    fields = {
        "header": header(stamp_ns, frame), "width": 640, "height": 480, "distortion_model": model,
        "binning_x": 0, "binning_y": 0, "roi": region(),
    }  # fmt: skip
    return Msg(**(fields | matrices | changes))


def about_z(angle_rad):
    return (float(np.cos(angle_rad / 2)), 0.0, 0.0, float(np.sin(angle_rad / 2)))


class Written:
    """What a step wrote: `make(out)` is run, and its files can be read."""

    def __init__(self, folder, make):
        writer = ArtifactWriter(folder)
        self.summary = make(writer)
        self.digest = writer.finish(self.summary)
        self.artifact = Artifact(self.digest, folder)
