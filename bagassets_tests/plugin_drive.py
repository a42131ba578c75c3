"""The small drive with messages of types that only plug-ins decode."""

import numpy as np
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bagassets_tests.small_drive import LATENCY_NS, START_NS, messages

WIDTH, HEIGHT = 16, 8
RAW_FRAME = "acme_msgs/msg/RawFrame"
DEFINITIONS = {
    RAW_FRAME: "std_msgs/Header header\nuint32 width\nuint32 height\nuint8[] data\n",
    "acme_msgs/msg/Scan": "std_msgs/Header header\nfloat32[] x\nfloat32[] y\n",
    "acme_msgs/msg/Targets": "builtin_interfaces/Time time\nfloat64[] range_m\nfloat64[] speed_mps\n",
    "acme_msgs/msg/Fix": "builtin_interfaces/Time time\nfloat64 east_m\nfloat64 heading_rad\n",
    "acme_msgs/msg/Things": "std_msgs/Header header\nstring[] kinds\nfloat64[] x\n",
}

RECIPE = """
name: plugins
bags: {root: bags, settle_s: 0}
nuscenes: {version: v1.0-test}
rigs:
  - name: car
    ego_pose: {source: odometry, topic: /odom}
    channels:
      CAM_ACME: {modality: camera, topic: /acme, undistort: false, output: png, frame: cam}
      CAM_FRONT: {modality: camera, topic: /cam/image_raw}
      LIDAR_TOP: {modality: lidar, topic: /points}
"""


def raw10(rows):
    """Pack 10-bit values as MIPI RAW10 does: four high bytes, then their low bits in a fifth."""
    values = np.asarray(rows, dtype=np.uint16).reshape(-1, 4)
    low = sum((values[:, i] & 3) << (2 * i) for i in range(4))
    return np.column_stack([values >> 2, low]).astype(np.uint8).reshape(-1)


def mosaic(red, green, blue):
    """A Bayer RGGB mosaic of one colour, in 10-bit values."""
    rows = np.zeros((HEIGHT, WIDTH), dtype=np.uint16)
    rows[0::2, 0::2], rows[1::2, 1::2] = red * 4 + 1, blue * 4 + 2
    rows[0::2, 1::2] = rows[1::2, 0::2] = green * 4 + 3
    return rows


class Kit:
    """Makes messages of any type in `store`."""

    def __init__(self):
        self.store = get_typestore(Stores.ROS2_HUMBLE)
        for msgtype, text in DEFINITIONS.items():
            self.store.register(get_types_from_msg(text, msgtype))

    def make(self, msgtype, **fields):
        return self.store.types[msgtype](**fields)

    def time(self, stamp_ns):
        return self.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)

    def header(self, stamp_ns, frame):
        return self.make("std_msgs/msg/Header", stamp=self.time(stamp_ns), frame_id=frame)


def raw_frame(kit, stamp_ns, number):
    data = raw10(mosaic(200, 100, 10 + number))
    return kit.make(
        RAW_FRAME,
        header=kit.header(stamp_ns, "cam"),
        width=np.uint32(WIDTH),
        height=np.uint32(HEIGHT),
        data=data,
    )


def write_recording(path, extra=(("/acme", RAW_FRAME, raw_frame),), duration_s=2.0):
    """Write the small drive as a ROS 2 bag, with ten messages a second of each (topic, type, maker)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    kit = Kit()
    events = [
        (stamp_ns, topic, msgtype, message)
        for topic, msgtype, stamp_ns, message in messages(kit.store, duration_s)
    ]
    for topic, msgtype, make in extra:
        for number in range(int(duration_s * 10) - 1):
            stamp_ns = START_NS + 12_000_000 + number * 100_000_000
            events.append((stamp_ns, topic, msgtype, make(kit, stamp_ns, number)))
    with Writer(path, version=9) as writer:
        connections = {}
        for stamp_ns, topic, msgtype, message in sorted(events, key=lambda event: event[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=kit.store)
            writer.write(connections[topic], stamp_ns + LATENCY_NS, kit.store.serialize_cdr(message, msgtype))
    return path
