#!/usr/bin/env bash
# A recording of ten seconds has the joints of an arm 50 times a second, and the IMU of a lidar ten times a second, at rest (9.81 m/s2 along z), which fails after 2 s; its orientation turns slowly, and is q
# or -q as it comes, which is one orientation. The IMU's frame is `os_imu`, as Ouster's driver has it, or `imu_link`. A table of both is made with rosbag-resurrector: `sync(…, tolerance_ms=50)`, "max
# time difference between an anchor sample and the matched non-anchor sample", used "by all methods for 'no match' detection". Guess: the same numbers, and nothing (NaN) from 2.05 s on.
# Seen with rosbag-resurrector 0.8.7 on 2026-11-30, without a word:
# - `os_imu`: an acceleration of 4e86 along z: values of 8 bytes are read where the name of the frame ends, without the four bytes of padding that CDR has after
#   names of 4 to 7 letters, of 12 to 15 and so on. With `imu_link`, `imu` and `base_link` there is none, and all is right
# - methods "sample_and_hold" and "interpolate": the last orientation until the end, 8 s old; "nearest" has NaN
# - "interpolate" goes from q to -q number by number: near the middle the quaternion is 0.2 long
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check rosbag-resurrector==0.8.7 mcap-ros2-support==0.6.0 mcap==1.6.0 rosbags==0.11.9 numpy==2.4.6 2>/dev/null
cat > table.py <<'PYTHON'
from pathlib import Path

import numpy as np
from resurrector.core.bag_frame import BagFrame
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
START_NS, TOLERANCE_MS = 1_700_000_000 * 10**9, 50


def of(name, *values):
    return STORE.types[name](*values)


def record(frame):
    """Record the arm, and an IMU in this frame; return the path of the MCAP."""

    def header(time_ns):
        return of("std_msgs/msg/Header", of("builtin_interfaces/msg/Time", time_ns // 10**9, time_ns % 10**9), frame)

    none, still, up = np.zeros(9), of("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0), of("geometry_msgs/msg/Vector3", 0.0, 0.0, 9.81)
    times_ns = range(START_NS, START_NS + 10 * 10**9, 20_000_000)
    rows = [(time_ns, "/joint_states", of("sensor_msgs/msg/JointState", header(time_ns), ["a"], np.ones(1), np.ones(1), np.ones(1))) for time_ns in times_ns]
    for number in range(21):
        time_ns, half, sign = START_NS + 100_000_000 * number, 0.03 * number, (-1) ** number
        turned = of("geometry_msgs/msg/Quaternion", 0.0, 0.0, sign * np.sin(half), sign * np.cos(half))
        rows.append((time_ns, "/imu", of("sensor_msgs/msg/Imu", header(time_ns), turned, none, still, none, up, none)))
    with Writer(Path(frame), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {"/joint_states": "sensor_msgs/msg/JointState", "/imu": "sensor_msgs/msg/Imu"}
        topics = {name: writer.add_connection(name, kind, typestore=STORE) for name, kind in kinds.items()}
        for time_ns, name, message in sorted(rows, key=lambda row: row[0]):
            writer.write(topics[name], time_ns, STORE.serialize_cdr(message, topics[name].msgtype))
    (path,) = Path(frame).glob("*.mcap")
    return path


found = {}
for frame in ("imu", "imu_link", "base_link", "os_imu", "xsens"):
    table = BagFrame(record(frame))["/imu"].to_polars()
    found[frame] = float(table["linear_acceleration.z"][0])
print("acceleration along z, by frame:", found)
assert all(np.isclose(found[frame], 9.81) for frame in ("imu", "imu_link", "base_link"))
assert not any(np.isclose(found[frame], 9.81) for frame in ("os_imu", "xsens"))
(path,) = Path("imu_link").glob("*.mcap")
for method in ("nearest", "sample_and_hold", "interpolate"):
    table = BagFrame(path).sync(["/joint_states", "/imu"], method=method, tolerance_ms=TOLERANCE_MS, anchor="/joint_states")
    seconds = (table["timestamp_ns"].to_numpy() - START_NS) / 1e9
    numbers = np.column_stack([table[f"imu__orientation.{axis}"].to_numpy() for axis in "xyzw"])
    known = ~np.isnan(numbers).any(axis=1)
    length = np.linalg.norm(numbers[known & (seconds <= 2)], axis=1)
    late = int((known & (seconds > 2 + TOLERANCE_MS / 1000)).sum())
    print(f"{method}: {len(table)} rows, {late} later than the tolerance, up to {seconds[known].max():.2f} s; length of quaternions {length.min():.3f} to {length.max():.3f}")
    assert len(table) == 500
    if method == "nearest":
        assert late == 0 and np.allclose(length, 1)
    else:
        assert late > 390
        assert np.allclose(length, 1) if method == "sample_and_hold" else length.min() < 0.3
PYTHON
venv/bin/python table.py > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
