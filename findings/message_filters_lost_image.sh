#!/usr/bin/env bash
# A camera and a lidar run at 10 Hz, each scan 10 ms behind its image. rospy's ApproximateTimeSynchronizer pairs them, with the `slop` of 0.1 s
# that its examples have. One image is lost. What are the pairs from then on?
# Guess: one pair is missing, all others are 10 ms apart, as each message takes its nearest partner.
# Seen with message_filters 1.15.15 of Debian 12 on 2026-11-29: every pair behind the loss is 90 ms apart, to the end of the recording: the
# scan that has no image waits for the next image, which is within `slop`, and that image takes it at once, 10 ms before its own scan comes.
# One loss in a minute is enough, and nothing says so. A `slop` of half a period, 0.05 s, pairs them as guessed. ROS 2's has the same source.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 PyYAML==6.0.3 catkin_pkg==1.1.0 rospkg==1.6.1
cd "$folder"
apt-get download --quiet=2 -o APT::Sandbox::User=root python3-message-filters=1.15.15+ds-2 python3-rospy=1.15.15+ds-2 \
  python3-rosgraph=1.15.15+ds-2 python3-roscpp-msg=1.15.15+ds-2 python3-rosgraph-msgs python3-roslib python3-catkin python3-genpy \
  python3-genmsg python3-std-msgs python3-sensor-msgs python3-geometry-msgs
for package in *.deb; do dpkg --extract "$package" debian; done
PYTHONPATH=debian/usr/lib/python3/dist-packages venv/bin/python - <<'PYTHON'
from message_filters import ApproximateTimeSynchronizer, SimpleFilter
from rospy import Time, rostime
from sensor_msgs.msg import Image, PointCloud2

NUMBER, LOST = 600, 10
rostime.set_rostime_initialized(True)


def gaps_ms(slop_s, lost):
    """Return how far the scan is behind the image, for each pair in turn."""
    camera, lidar = SimpleFilter(), SimpleFilter()
    gaps = []
    pairs = ApproximateTimeSynchronizer([camera, lidar], 10, slop_s)
    pairs.registerCallback(lambda image, scan: gaps.append((scan.header.stamp - image.header.stamp).to_nsec() // 1_000_000))
    for number in range(NUMBER):
        for topic, message, ms in ((camera, Image(), 100 * number), (lidar, PointCloud2(), 100 * number + 10)):
            if topic is lidar or number != lost:
                message.header.stamp = Time(ms // 1000, ms % 1000 * 1_000_000)
                topic.signalMessage(message)
    return gaps


whole, broken, narrow = gaps_ms(0.1, None), gaps_ms(0.1, LOST), gaps_ms(0.05, LOST)
for name, gaps in (("all images", whole), ("one lost", broken), ("one lost, slop of 0.05 s", narrow)):
    print(f"{name}: {len(gaps)} pairs, {sorted(set(gaps))} ms apart, {gaps.count(-90)} of them 90 ms")
assert whole == [10] * NUMBER
assert broken == [10] * LOST + [-90] * (NUMBER - LOST - 1)
assert narrow == [10] * (NUMBER - 1)
PYTHON
