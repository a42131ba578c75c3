#!/usr/bin/env bash
# A gripper's force-torque sensor measures a push of 10 N to the left, no torque. It is wanted at the wrist, 0.2 m behind the sensor, whose axes are parallel:
# `do_transform_wrench` of tf2_geometry_msgs. Guess: 10 N to the left, and the torque of the lever, 2 Nm about z.
# Seen with tf2_geometry_msgs 0.7.6 of Debian 12 (Python) on 2026-11-29, without a word: 10 N, and NO torque: force and torque are turned, each by itself, and the way
# between the frames is not looked at. The stamp is that of the transform, 0 of a static mount, as of all messages that it transforms. PyKDL,
# which it is built on, has the torque (`Frame * Wrench`).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv" # the Python of Debian 12, for which its tf2 is built
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 PyYAML==6.0.3 catkin_pkg==1.1.0 rospkg==1.6.1
cd "$folder"
apt-get download --quiet=2 -o APT::Sandbox::User=root python3-tf2-geometry-msgs=0.7.6-1 python3-tf2-ros=0.7.6-1 python3-tf2=0.7.6-1+b2 \
  libtf2-2d=0.7.6-1+b2 librostime1d libconsole-bridge1.0 python3-pykdl liborocos-kdl1.5 python3-actionlib python3-actionlib-msgs \
  python3-rospy=1.15.15+ds-2 python3-rosgraph=1.15.15+ds-2 python3-roscpp-msg=1.15.15+ds-2 python3-rosgraph-msgs python3-roslib \
  python3-catkin python3-genpy python3-genmsg python3-std-msgs python3-geometry-msgs python3-tf2-msgs
for package in *.deb; do dpkg --extract "$package" debian; done
LD_LIBRARY_PATH=debian/usr/lib/x86_64-linux-gnu PYTHONPATH=debian/usr/lib/python3/dist-packages venv/bin/python - <<'PYTHON'
import PyKDL
from geometry_msgs.msg import TransformStamped, WrenchStamped
from rospy import Time
from tf2_geometry_msgs import do_transform_wrench

mount = TransformStamped()
mount.header.frame_id, mount.child_frame_id = "wrist", "sensor"
mount.transform.translation.x, mount.transform.rotation.w = 0.2, 1.0
measured = WrenchStamped()
measured.header.frame_id, measured.header.stamp = "sensor", Time(1700000000)
measured.wrench.force.y = 10.0

got = do_transform_wrench(measured, mount)
force, torque = got.wrench.force, got.wrench.torque
right = PyKDL.Frame(PyKDL.Vector(0.2, 0, 0)) * PyKDL.Wrench(PyKDL.Vector(0, 10, 0), PyKDL.Vector(0, 0, 0))
print(f"tf2: force {force.y:g} N, torque {torque.z:g} Nm, stamp {got.header.stamp.secs}; PyKDL: torque {right.torque.z():g} Nm")
assert (force.y, torque.x, torque.y, torque.z) == (10, 0, 0, 0) and got.header.frame_id == "wrist"
assert got.header.stamp == Time(0)
assert abs(right.torque.z() - 2) < 1e-9 and abs(right.force.y() - 10) < 1e-9
PYTHON
