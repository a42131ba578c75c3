#!/usr/bin/env bash
# A cloud of 100 s is brought from the lidar's frame into the vehicle's by `do_transform_cloud` of tf2_sensor_msgs, with the static transform
# of its mount (10 m ahead, a quarter turn to the left). What comes out?
# Guess: the same cloud in another frame: stamp, layout and all fields as they were, x, y, z transformed, normals turned.
# Seen with tf2_sensor_msgs 0.7.6 of Debian 12 (Python) on 2026-11-29, without a word:
# - the stamp is that of the TRANSFORM: 0 for one that was looked up at Time(0), as for static ones is usual. `do_transform_pose` likewise.
# - the first three FIELDS are transformed, whatever they are: of intensity, x, y, z, (7, 1, 2, 3) become (9, 7, 2, 3)
# - normals stay as they were, so they belong to no frame
# - an organised cloud of 2 rows becomes one row of all points
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv" # the Python of Debian 12, for which its tf2 is built
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 PyYAML==6.0.3 catkin_pkg==1.1.0 rospkg==1.6.1
cd "$folder"
apt-get download --quiet=2 -o APT::Sandbox::User=root python3-tf2-sensor-msgs=0.7.6-1 python3-tf2-geometry-msgs=0.7.6-1 \
  python3-tf2-ros=0.7.6-1 python3-tf2=0.7.6-1+b2 libtf2-2d=0.7.6-1+b2 librostime1d libconsole-bridge1.0 python3-pykdl liborocos-kdl1.5 \
  python3-actionlib python3-actionlib-msgs python3-rospy=1.15.15+ds-2 python3-rosgraph=1.15.15+ds-2 python3-roscpp-msg=1.15.15+ds-2 \
  python3-rosgraph-msgs python3-roslib python3-catkin python3-genpy python3-genmsg python3-std-msgs python3-geometry-msgs \
  python3-sensor-msgs python3-tf2-msgs
for package in *.deb; do dpkg --extract "$package" debian; done
LD_LIBRARY_PATH=debian/usr/lib/x86_64-linux-gnu PYTHONPATH=debian/usr/lib/python3/dist-packages venv/bin/python - <<'PYTHON'
import numpy as np
import tf2_py
from geometry_msgs.msg import PoseStamped, TransformStamped
from rospy import Duration, Time
from sensor_msgs.msg import PointField
from sensor_msgs.point_cloud2 import create_cloud, read_points
from std_msgs.msg import Header
from tf2_geometry_msgs import do_transform_pose
from tf2_sensor_msgs import do_transform_cloud

VALUES = {"x": 1.0, "y": 2.0, "z": 3.0, "intensity": 7.0, "normal_x": 1.0, "normal_y": 0.0, "normal_z": 0.0}

mount = TransformStamped()
mount.header.frame_id, mount.child_frame_id = "base", "lidar"
mount.transform.translation.x = 10.0
mount.transform.rotation.z = mount.transform.rotation.w = np.sqrt(0.5)
buffer = tf2_py.BufferCore(Duration(10))
buffer.set_transform_static(mount, "recording")
latest = buffer.lookup_transform_core("base", "lidar", Time(0))


def transformed(*names):
    """Return what becomes of a cloud of 2 rows with one point each, and its first point."""
    fields = [PointField(name, 4 * number, PointField.FLOAT32, 1) for number, name in enumerate(names)]
    cloud = create_cloud(Header(stamp=Time(100), frame_id="lidar"), fields, [[VALUES[name] for name in names]] * 2)
    cloud.height, cloud.width, cloud.row_step = 2, 1, cloud.point_step
    result = do_transform_cloud(cloud, latest)
    return result, np.round(next(read_points(result)), 5).tolist()


cloud, point = transformed("x", "y", "z", "normal_x", "normal_y", "normal_z")
_, shifted = transformed("intensity", "x", "y", "z")
pose = PoseStamped()
pose.header.stamp, pose.pose.orientation.w = Time(100), 1.0
stamps = cloud.header.stamp.to_sec(), do_transform_pose(pose, latest).header.stamp.to_sec()
print(f"stamps {stamps}, {cloud.height} x {cloud.width}, xyz and normal {point}; intensity, x, y, z: {shifted}")
assert stamps == (0.0, 0.0)
assert (cloud.height, cloud.width) == (1, 2)
assert point == [8.0, 1.0, 3.0, 1.0, 0.0, 0.0]  # the normal should be (0, 1, 0)
assert shifted == [9.0, 7.0, 2.0, 3.0]
PYTHON
