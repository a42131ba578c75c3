#!/usr/bin/env bash
# The mount of a lidar is published twice: by robot_state_publisher on /tf_static (x = 1), and by a node that adjusts it on /tf, at 10, 11
# and 12 s (x = 10, 11, 12). Where does tf2 see the lidar at 1, 5, 10.5 and 50 s?
# Guess: one of both wins, and the loser does not count. Seen with tf2 0.7.6 of Debian 12 on 2026-11-29:
# - static first: the frame stays static, and each message of /tf replaces it, for all times: x = 12 at 1 s, long before anyone said so, and
#   at 50 s. What was looked up at 10.5 s changes once the recording has been read further (10, then 12).
# - static last, with the stamp 0 that a static transform may have: it is a sample at 0 s like any other, and tf2 interpolates from there:
#   x = 5.5 at 5 s; at 50 s there is none.
# So the order in which the messages of two topics arrive decides where the lidar was; tf2 says nothing in either case.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv" # the Python of Debian 12, for which its tf2 is built
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 PyYAML==6.0.3 catkin_pkg==1.1.0 rospkg==1.6.1
cd "$folder"
apt-get download --quiet=2 -o APT::Sandbox::User=root python3-tf2=0.7.6-1+b2 libtf2-2d=0.7.6-1+b2 librostime1d libconsole-bridge1.0 \
  python3-rospy=1.15.15+ds-2 python3-rosgraph=1.15.15+ds-2 python3-roscpp-msg=1.15.15+ds-2 python3-rosgraph-msgs python3-roslib \
  python3-catkin python3-genpy python3-genmsg python3-std-msgs python3-geometry-msgs python3-tf2-msgs
for package in *.deb; do dpkg --extract "$package" debian; done
LD_LIBRARY_PATH=debian/usr/lib/x86_64-linux-gnu PYTHONPATH=debian/usr/lib/python3/dist-packages venv/bin/python - <<'PYTHON'
import tf2_py
from geometry_msgs.msg import TransformStamped
from rospy import Duration, Time


def transform(seconds, x):
    message = TransformStamped()
    message.header.stamp, message.header.frame_id, message.child_frame_id = Time(seconds), "base", "lidar"
    message.transform.translation.x, message.transform.rotation.w = x, 1.0
    return message


def seen(messages):
    """Return x at 1, 5, 10.5 and 50 s after tf2 was given the messages in this order, None where it refuses."""
    buffer = tf2_py.BufferCore(Duration(100))
    for static, seconds, x in messages:
        (buffer.set_transform_static if static else buffer.set_transform)(transform(seconds, x), "recording")
    result = []
    for seconds in (1.0, 5.0, 10.5, 50.0):
        try:
            found = buffer.lookup_transform_core("base", "lidar", Time.from_sec(seconds))
            result.append(round(found.transform.translation.x, 6))
        except tf2_py.ExtrapolationException:
            result.append(None)
    return result


static, moving = (True, 0, 1.0), [(False, 10, 10.0), (False, 11, 11.0), (False, 12, 12.0)]
first, halfway, last = seen([static, *moving]), seen([static, *moving[:1]]), seen([*moving, static])
print(f"static first: {first}, after one message of /tf: {halfway}; static last: {last}")
assert first == [12.0] * 4
assert halfway == [10.0] * 4
assert last == [1.9, 5.5, 10.5, None]
PYTHON
