#!/usr/bin/env bash
# A camera looks ahead, at a wall 4 m away on the left half of its image and at one 70 m away on the right. A recording (MCAP) has its images, depth in metres (32FC1, as of a stereo camera), the
# pose of camera_link, and /tf with camera_optical_frame in it, as REP 103 has it: z ahead, x to the right. stera-sdk makes a map of it (`dense_point_cloud`), of depths between 0.3 and 5 m.
# Guess: the near wall 4 m ahead, the camera's left half of it to the left; no point of the far one. Seen with stera-sdk 0.0.4 on 2026-11-30, without a word:
# - the near wall is 4 m to the RIGHT, and what is right in the image is above: the rotation in /tf, which is that from the optical frame to the link, is taken for that back, and
#   inverted. For the frames of the maker's own app, half a turn, it is all the same. The same matrix is exported as `R_optical_to_link.npy`, and colours meshes
# - the far wall is 4.464 m away, right among the others: depth becomes 16 bits of millimetres, and 70,000 less 65,536 are 4,464; it is exported as such
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==1.26.4 opencv-python-headless==4.11.0.86 h5py==3.16.0 tqdm==4.70.1 mcap==1.6.0 mcap-ros2-support==0.6.0
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps stera-sdk==0.0.4  # what it needs besides draws
cd "$folder"
venv/bin/python - 2>/dev/null <<'PYTHON'
import cv2
import numpy as np
from mcap_ros2.writer import Writer
from stera.data import MCAPReader

PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/Pose": "geometry_msgs/Vector3 position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
}
IMAGE = "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data"
INFO = "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p"
TOPICS = {
    "/tf": ("tf2_msgs/msg/TFMessage", "geometry_msgs/TransformStamped[] transforms"),
    "/camera/pose": ("geometry_msgs/msg/PoseStamped", "std_msgs/Header header\ngeometry_msgs/Pose pose"),
    "/camera/rgb/compressed": ("sensor_msgs/msg/CompressedImage", "std_msgs/Header header\nstring format\nuint8[] data"),
    "/camera/depth": ("sensor_msgs/msg/Image", IMAGE),
    "/camera/camera_info": ("sensor_msgs/msg/CameraInfo", INFO),
}
WIDTH, HEIGHT, FOCAL = 64, 48, 50.0


def xyz(x, y, z, **more):
    return {"x": x, "y": y, "z": z} | more


def header(frame):
    return {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": frame}


depth_m = np.full((HEIGHT, WIDTH), 4.0, np.float32)
depth_m[:, WIDTH // 2 :] = 70
k = [FOCAL, 0, WIDTH / 2, 0, FOCAL, HEIGHT / 2, 0, 0, 1]
optical = {"translation": xyz(0.0, 0.0, 0.0), "rotation": xyz(-0.5, 0.5, -0.5, w=0.5)}
messages = {
    "/tf": {"transforms": [{"header": header("camera_link"), "child_frame_id": "camera_optical_frame", "transform": optical}]},
    "/camera/pose": {"header": header("map"), "pose": {"position": xyz(0.0, 0.0, 0.0), "orientation": xyz(0.0, 0.0, 0.0, w=1.0)}},
    "/camera/rgb/compressed": {"format": "png", "data": cv2.imencode(".png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))[1].tobytes()},
    "/camera/depth": {"height": HEIGHT, "width": WIDTH, "encoding": "32FC1", "is_bigendian": 0, "step": WIDTH * 4, "data": depth_m.tobytes()},
    "/camera/camera_info": {"height": HEIGHT, "width": WIDTH, "distortion_model": "", "d": [], "k": k, "r": [0.0] * 9, "p": [0.0] * 12},
}
with open("room.mcap", "wb") as file:
    writer = Writer(file)
    for topic, (name, fields) in TOPICS.items():
        parts = [fields, *(f"MSG: {part}\n{text}" for part, text in PARTS.items())]
        schema = writer.register_msgdef(name, f"\n{'=' * 80}\n".join(parts))
        message = messages[topic] if topic == "/tf" else {"header": header("camera_optical_frame")} | messages[topic]
        writer.write_message(topic, schema, message, log_time=10**9, publish_time=10**9)
    writer.finish()

reader = MCAPReader("room.mcap")
points, _ = reader.dense_point_cloud(every_n=1, voxel_size=0)
near, far = (points[np.isclose(points[:, 1], -distance_m, atol=1e-3)] for distance_m in (4, 4.464))
print(f"{len(near)} points of the near wall, in the middle at {near.mean(axis=0).round(2)}; {len(far)} of the far one, at {far.mean(axis=0).round(2)}")
assert len(near) == len(far) == WIDTH * HEIGHT // 2
assert near[:, 2].mean() < 0 < far[:, 2].mean()

optical_to_link = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
assert np.allclose(reader.R_optical_to_link, optical_to_link.T)
print("right in the image is", reader.R_optical_to_link @ [1, 0, 0], "in camera_link, and ahead is", reader.R_optical_to_link @ [0, 0, 1])
PYTHON
