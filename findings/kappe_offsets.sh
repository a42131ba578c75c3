#!/usr/bin/env bash
# The mount of a camera, which looks to the left, is corrected in a recording with kappe: `tf_static: offset:` of 0.1 m along x and 10 degrees about
# x. Then it is cut into two, from 0 to 5 s and from 5 to 10 s. Guess: x is that of one frame, the mount's or the camera's; and each message is in
# one part. Seen with kappe 0.25.0 on 2026-11-29, without a word:
# - the camera moves along the x of its PARENT, forward, and turns about its OWN x, which points to the left: neither offset times transform
#   nor transform times offset
# - parts are cut by publish time, both ends included: the message of 5 s is in both. But the file is read by log time, up to the end: one
#   that was published before 10 s and recorded after it is in none, like the one published before 0 s.
# - without `--keep_tf_tree true` the second part has no /tf_static at all
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check kappe==0.25.0 mcap==1.6.0 mcap-ros2-support==0.6.0 scipy==1.17.1 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import subprocess
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer
from scipy.spatial.transform import Rotation

PARTS = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
}
TF, *OTHERS = (f"MSG: {name}\n{fields}" for name, fields in PARTS.items())
DEFINITION = f"\n{'=' * 80}\n".join([TF.split("\n", 1)[1], *OTHERS])
SECOND, START_NS = 10**9, 1_700_000_000 * 10**9


def xyz(x, y, z, **more):
    return {"x": x, "y": y, "z": z} | more


with open("drive.mcap", "wb") as file:
    writer = Writer(file)
    tf = writer.register_msgdef("tf2_msgs/msg/TFMessage", DEFINITION)
    point = writer.register_msgdef("geometry_msgs/msg/Point", PARTS["geometry_msgs/Vector3"])
    turned = Rotation.from_euler("z", 90, degrees=True)
    x, y, z, w = turned.as_quat()
    mount = {"header": {"stamp": {"sec": 1_700_000_000, "nanosec": 0}, "frame_id": "base"}, "child_frame_id": "camera"}
    mount["transform"] = {"translation": xyz(1.0, 0.0, 0.0), "rotation": xyz(x, y, z, w=w)}
    writer.write_message("/tf_static", tf, {"transforms": [mount]}, log_time=START_NS, publish_time=START_NS)
    for published_s, logged_s in ((-0.1, 0.1), (1.0, 1.2), (5.0, 5.0), (9.9, 10.1)):
        times = {"log_time": START_NS + round(logged_s * SECOND), "publish_time": START_NS + round(published_s * SECOND)}
        writer.write_message("/point", point, xyz(published_s, 0.0, 0.0), **times)
    writer.finish()


def kappe(*arguments):
    subprocess.run(["venv/bin/kappe", "--progress=false", *arguments], check=True, capture_output=True)


def messages(path):
    with open(path, "rb") as file:
        read = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        return [(channel.topic, message) for _, channel, _, message in read]


offset = "{child_frame_id: camera, translation: {x: 0.1}, rotation: {euler_deg: [10, 0, 0]}}"
Path("convert.yaml").write_text(f"tf_static:\n  offset:\n    - {offset}\n")
kappe("convert", "--config", "convert.yaml", "drive.mcap", "converted")
(transform,) = (m.transforms[0].transform for topic, m in messages("converted/drive.mcap") if topic == "/tf_static")
moved = np.array([getattr(transform.translation, name) for name in "xyz"])
rotation = Rotation.from_quat([getattr(transform.rotation, name) for name in "xyzw"])
axis = (rotation * turned.inv()).as_rotvec(degrees=True)
print("moved to", moved, "in the base, turned there by", axis.round(3), "degrees about x, y, z")
assert np.allclose(moved, [1.1, 0, 0])
assert np.allclose(axis, [0, 10, 0])

splits = "".join(
    f"  - {{name: part{number}, start: {1_700_000_000 + start}, end: {1_700_000_000 + start + 5}}}\n"
    for number, start in enumerate((0, 5))
)
Path("cut.yaml").write_text(f"splits:\n{splits}")
kappe("cut", "--config", "cut.yaml", "--output", "cut", "drive.mcap")
parts = [messages(f"cut/part{number}.mcap") for number in range(2)]
print([[(topic, m.x) if topic == "/point" else topic for topic, m in part] for part in parts])
assert [[m.x for topic, m in part if topic == "/point"] for part in parts] == [[1.0, 5.0], [5.0]]
assert [sum(topic == "/tf_static" for topic, _ in part) for part in parts] == [1, 0]
PYTHON
