#!/usr/bin/env bash
# rosbag-slam-lint reads metadata.yaml of a ROS 2 bag before it goes into lidar-inertial odometry: points 5 times a second at least, an IMU 50 times. In a recording of 5 minutes
# the IMU has sent nothing, as its topic with 0 messages shows, while the magnetometer of the same driver is there at 60 Hz; and two lidars have sent half of their scans, 3 Hz each
# of 6. Guess: two warnings, of the IMU and of the points. Seen with rosbag-slam-lint 0.3.2 on 2026-12-01:
# - none, exit code 0 with `--fail-on warn`. A topic is of the IMU by its name, whatever its type, 0 messages are there, and the rates of all topics of a group are
#   added up: 0 + 60 Hz of the IMU, 3 + 3 Hz of points
# - without the magnetometer and the second lidar, both warnings come: what is recorded besides hides what is missing
# - rates that it suggests for one's own recordings (`rosbag-slam-profile-stats`) are such sums, too: of 80 % of 60 and of 6 Hz, after this one
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rosbag-slam-lint==0.3.2 PyYAML==6.0.3 2>/dev/null
cd "$folder"
cat > lint.py <<'PYTHON'
import json
import subprocess
from pathlib import Path

DURATION_S = 300
RATES_HZ = {
    ("/imu/data", "sensor_msgs/msg/Imu"): 0,
    ("/imu/mag", "sensor_msgs/msg/MagneticField"): 60,
    ("/front/points", "sensor_msgs/msg/PointCloud2"): 3,
    ("/rear/points", "sensor_msgs/msg/PointCloud2"): 3,
    ("/tf", "tf2_msgs/msg/TFMessage"): 10,
    ("/odom", "nav_msgs/msg/Odometry"): 20,
}


def write(name, without=()):
    """Write what a recorder leaves of a recording in its metadata."""
    counts = {topic: DURATION_S * rate for topic, rate in RATES_HZ.items() if topic[0] not in without}
    topics = [
        {"topic_metadata": {"name": name, "type": kind, "serialization_format": "cdr", "offered_qos_profiles": ""}, "message_count": count}
        for (name, kind), count in counts.items()
    ]
    information = {
        "version": 5,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": DURATION_S * 10**9},
        "starting_time": {"nanoseconds_since_epoch": 1_777_888_999 * 10**9},
        "message_count": sum(counts.values()),
        "topics_with_message_count": topics,
        "relative_file_paths": [f"{name}_0.mcap"],
    }
    Path(name).mkdir()
    Path(name, "metadata.yaml").write_text(json.dumps({"rosbag2_bagfile_information": information}))  # JSON is YAML


def lint(name):
    ran = subprocess.run(["venv/bin/rosbag-slam-lint", name, "--profile", "lio", "--fail-on", "warn"], capture_output=True, text=True)
    print(f"{name}: exit code {ran.returncode}", ran.stdout + ran.stderr, sep="\n")
    return ran


write("drive")
write("alone", without=("/imu/mag", "/rear/points"))
drive, alone = lint("drive"), lint("alone")
stats = subprocess.run(["venv/bin/rosbag-slam-profile-stats", "--profile", "lio", "drive"], capture_output=True, text=True)
print(stats.stdout + stats.stderr)
assert drive.returncode == 0 and "LOW_TOPIC_RATE" not in drive.stdout
assert "p10=6.000" in stats.stdout and "suggested_min_hz: 48.0" in stats.stdout
assert alone.returncode == 1 and alone.stdout.count("LOW_TOPIC_RATE") == 2
PYTHON
venv/bin/python lint.py
