"""A short drive of which a test may change one thing: two cameras, lidar, boxes, notes."""

import dataclasses

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import get_types_from_msg

from bagassets.geometry.camera import CameraModel
from bagassets_tests.calibration_texts import ros
from bagassets_tests.small_drive import HEIGHT, LATENCY_NS, START_NS, STORE1, WIDTH, messages

STORE1.register(get_types_from_msg("string data\n", "std_msgs/msg/String"))

DURATION_S = 2.0
NOTES = "/notes"

RECIPE = """
name: keys
bags: {root: bags}
nuscenes: {version: v1.0-keys}
vision: {frames: 5}
preview: {width: 320}
lerobot:
  fps: 4
  features:
    observation.state: {signals: [motion], gap: hold}
    observation.images.front: {camera: CAM_FRONT, gap: hold}
rigs:
  - name: car
    ego_pose: {source: odometry, topic: /odom}
    annotations: [{topic: /boxes}]
    channels:
      CAM_FRONT: {modality: camera, topic: /cam/image_raw}
      CAM_BACK: {modality: camera, topic: /back/image_raw, intrinsics: {file: back.yaml}}
      LIDAR_TOP: {modality: lidar, topic: /points}
    signals:
      motion: {topic: /odom, field: twist.twist.linear}
"""


def write_lens(folder, fx=30.0):
    """Write the calibration file of the camera at the back."""
    model = CameraModel("plumb_bob", WIDTH, HEIGHT, fx, 30.0, 16.0, 12.0, (-0.1, 0.0, 0.0, 0.0, 0.0))
    (folder / "back.yaml").write_text(ros(model))


def drive():
    """Return (topic, type, header stamp, message) of everything, in order of time."""
    types = STORE1.types
    found = []
    for topic, msgtype, stamp_ns, message in messages(STORE1, DURATION_S, ros1=True):
        found.append((topic, msgtype, stamp_ns, message))
        if topic == "/tf_static":
            (front, lidar) = message.transforms
            back = dataclasses.replace(front, child_frame_id="back")
            found[-1] = (
                topic,
                msgtype,
                stamp_ns,
                dataclasses.replace(message, transforms=[front, lidar, back]),
            )
        if topic.startswith("/cam/"):
            header = dataclasses.replace(message.header, frame_id="back")
            found.append(
                (
                    topic.replace("/cam/", "/back/"),
                    msgtype,
                    stamp_ns,
                    dataclasses.replace(message, header=header),
                )
            )
    for index in range(8):
        stamp_ns = START_NS + index * 250_000_000
        found.append(("/boxes", "visualization_msgs/msg/MarkerArray", stamp_ns, box(types, stamp_ns, index)))
        found.append((NOTES, "std_msgs/msg/String", stamp_ns, types["std_msgs/msg/String"](f"note {index}")))
    return sorted(found, key=lambda entry: (entry[2], entry[0]))


def box(types, stamp_ns, index):
    stamp = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    point, quaternion = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Quaternion"]
    marker = types["visualization_msgs/msg/Marker"](
        header=types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id="base_link"),
        ns="car",
        id=7,
        type=1,
        action=0,
        pose=types["geometry_msgs/msg/Pose"](point(10.0 + index, 2.0, 0.5), quaternion(0.0, 0.0, 0.0, 1.0)),
        scale=types["geometry_msgs/msg/Vector3"](4.0, 2.0, 1.5),
        color=types["std_msgs/msg/ColorRGBA"](1.0, 0.0, 0.0, 1.0),
        lifetime=types["builtin_interfaces/msg/Duration"](0, 0),
        frame_locked=False,
        points=[],
        colors=[],
        text="",
        mesh_resource="",
        mesh_use_embedded_materials=False,
    )
    return types["visualization_msgs/msg/MarkerArray"](markers=[marker])


def changed(entries, topic, change, at=5):
    """Return the drive with `change` made to one message of a topic."""
    places = [place for place, entry in enumerate(entries) if entry[0] == topic]
    place = places[min(at, len(places) - 1)]
    name, msgtype, stamp_ns, message = entries[place]
    return [*entries[:place], (name, msgtype, stamp_ns, change(message)), *entries[place + 1 :]]


def one_pixel(message):
    data = np.array(message.data)
    data[:200] ^= 0xFF
    return dataclasses.replace(message, data=data)


def one_metre(message):
    pose = message.pose.pose
    position = dataclasses.replace(pose.position, y=pose.position.y + 1.0)
    return dataclasses.replace(
        message, pose=dataclasses.replace(message.pose, pose=dataclasses.replace(pose, position=position))
    )


def another_box(message):
    (marker,) = message.markers
    scale = dataclasses.replace(marker.scale, z=2.5)
    return dataclasses.replace(message, markers=[dataclasses.replace(marker, scale=scale)])


def another_mount(message):
    (front, lidar, back) = message.transforms
    moved = dataclasses.replace(
        back.transform, translation=dataclasses.replace(back.transform.translation, z=2.0)
    )
    return dataclasses.replace(message, transforms=[front, lidar, dataclasses.replace(back, transform=moved)])


def another_note(message):
    return dataclasses.replace(message, data="something else altogether")


def write(path, entries, compression=None):
    """Write a ROS 1 bag."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    writer = Writer(path)
    if compression is not None:
        writer.set_compression(Writer.CompressionFormat[compression])
    with writer:
        connections = {}
        for topic, msgtype, stamp_ns, message in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=STORE1)
            writer.write(connections[topic], stamp_ns + LATENCY_NS, STORE1.serialize_ros1(message, msgtype))
    return path
