#!/usr/bin/env bash
# A node computes with seconds, and stamps what it publishes with the time of its input, which went through a double: `Time.from_sec(stamp.to_sec())`. Images
# come 30 times a second, by the clock of a simulator, which began at 0, or by that of the day. How many of 1000 stamps are what they were?
# Guess: all of the simulator's, as a double has digits to spare there; hardly any of the day's, where doubles are 238 ns apart.
# Seen on 2026-11-29, without a word:
#                                                simulator            day
#   genpy 0.6.16 of Debian 12 (rospy, ROS 1)     541, others -1 ns    none, up to 115 ns off
#   foxglove-sdk 0.30.3 (`from_epoch_secs`)      532, others -1 ns    none, up to 115 ns off
#   rclpy 7.1.6 (`Time(seconds=…)`, ROS 2)       974, others -1 ns    33, up to 177 ns off
# What remains of a second is cut to nanoseconds, not rounded: 33.3 s are 33.299999999. So a `TimeSynchronizer` of message_filters, which wants
# equal stamps, pairs 541 of the simulator's images with what was made of them, and of the day's none; nor is anything found by its stamp.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check ros-jazzy-rclpy==7.1.6 ros-jazzy-rmw-fastrtps-cpp==8.4.3 foxglove-sdk==0.30.3 \
  PyYAML==6.0.3 catkin_pkg==1.1.0 rospkg==1.6.1
cd "$folder"
apt-get download --quiet=2 -o APT::Sandbox::User=root python3-message-filters=1.15.15+ds-2 python3-rospy=1.15.15+ds-2 \
  python3-rosgraph=1.15.15+ds-2 python3-roscpp-msg=1.15.15+ds-2 python3-rosgraph-msgs python3-roslib python3-catkin python3-genpy \
  python3-genmsg python3-std-msgs python3-sensor-msgs python3-geometry-msgs
for package in *.deb; do dpkg --extract "$package" debian; done
cat > stamps.py <<'PYTHON'
import sys

NS = 10**9
SIMULATOR_NS = [number // 30 * NS + number % 30 * 33_333_333 for number in range(1000)]
STAMPS_NS = {"simulator": SIMULATOR_NS, "day": [1_700_000_000 * NS + 7 + stamp_ns for stamp_ns in SIMULATOR_NS]}
library, *expected = sys.argv[1], *map(int, sys.argv[2:])

if library == "genpy":
    from genpy import Time

    def through_seconds(stamp_ns):
        return Time.from_sec(Time(*divmod(stamp_ns, NS)).to_sec()).to_nsec()
elif library == "rclpy":
    from rclpy.time import Time

    def through_seconds(stamp_ns):
        return Time(seconds=stamp_ns / NS).nanoseconds
else:
    from foxglove.messages import Timestamp

    def through_seconds(stamp_ns):
        stamp = Timestamp.from_epoch_secs(stamp_ns / NS)
        return stamp.sec * NS + stamp.nsec


assert 33_300_000_000 / NS == 33.3 and through_seconds(33_300_000_000) == 33_299_999_999
for (clock, stamps_ns), equal in zip(STAMPS_NS.items(), expected):
    off_ns = [through_seconds(stamp_ns) - stamp_ns for stamp_ns in stamps_ns]
    print(f"{library}, {clock}: {off_ns.count(0)} of {len(off_ns)} are what they were, the others {min(off_ns)} to {max(off_ns)} ns off")
    assert off_ns.count(0) == equal
    assert set(off_ns) == {-1, 0} if clock == "simulator" else max(map(abs, off_ns)) < 238

if library == "genpy":
    from message_filters import SimpleFilter, TimeSynchronizer
    from rospy import rostime
    from sensor_msgs.msg import Image

    rostime.set_rostime_initialized(True)
    for (clock, stamps_ns), equal in zip(STAMPS_NS.items(), expected):
        images, masks, pairs = SimpleFilter(), SimpleFilter(), []
        TimeSynchronizer([images, masks], 10).registerCallback(lambda image, mask: pairs.append(image))
        for stamp_ns in stamps_ns:
            for topic, ns in ((images, stamp_ns), (masks, through_seconds(stamp_ns))):
                message = Image()
                message.header.stamp = rostime.Time(*divmod(ns, NS))
                topic.signalMessage(message)
        print(f"{clock}: {len(pairs)} pairs")
        assert len(pairs) == equal
PYTHON
PYTHONPATH=debian/usr/lib/python3/dist-packages venv/bin/python stamps.py genpy 541 0
venv/bin/python stamps.py foxglove 532 0
venv/bin/python stamps.py rclpy 974 33
