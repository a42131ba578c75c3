#!/usr/bin/env bash
# A camera at 20 Hz and a lidar at 10 Hz are recorded for 60 s (MCAP of ROS 2). The camera's driver hangs for 10 s; beside that it loses no frame, one in forty or one in ten, as on a busy link.
# rosbag-doctor is asked for timing gaps, without a configuration. Guess: the 10 s are a large gap in each of the three. Seen with rosbag-doctor 0.1.1 on 2026-12-01:
# - no frame lost, or one in forty: a large gap of 10 050 ms, as guessed
# - one in ten: no issue at all, "pass". A gap is one only if 95 % of the periods are within half a period of the median, so that the worse of two recordings is the healthy one
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check rosbag-doctor==0.1.1 mcap==1.6.0 numpy==2.4.6 pyyaml==6.0.4 2>/dev/null
cat >outage.py <<'PYTHON'
from mcap.writer import Writer
from rosbag_doctor.doctor import inspect_bag

START_NS, SECONDS = 1_700_000_000_000_000_000, 60
for lost_every, is_seen in ((None, True), (40, True), (10, False)):
    camera = [frame for frame in range(SECONDS * 20 + 1) if not 400 <= frame < 600 and not (lost_every and frame % lost_every == 5)]
    times_ns = sorted([(START_NS + frame * 50_000_000, "camera") for frame in camera] + [(START_NS + scan * 100_000_000, "lidar") for scan in range(SECONDS * 10 + 1)])
    path = f"lost_{lost_every}.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="")
        channels = {}
        for topic, name in (("camera", "sensor_msgs/msg/CompressedImage"), ("lidar", "sensor_msgs/msg/PointCloud2")):
            schema = writer.register_schema(name=name, encoding="ros2msg", data=b"std_msgs/Header header")
            channels[topic] = writer.register_channel(topic=f"/{topic}", message_encoding="cdr", schema_id=schema)
        for sequence, (time_ns, topic) in enumerate(times_ns):
            writer.add_message(channels[topic], log_time=time_ns, publish_time=time_ns, data=bytes(20), sequence=sequence)
        writer.finish()
    report = inspect_bag(path)
    found = [(issue.topic, issue.code, issue.message) for issue in report.issues]
    print(f"one frame in {lost_every} lost, 10 s without any: {report.status}, {found}")
    assert bool(found) == is_seen and all(topic == "/camera" and code == "large-gap" for topic, code, _ in found), found
PYTHON
venv/bin/python outage.py 2>said.txt || { cat said.txt; exit 1; }
test ! -s said.txt
