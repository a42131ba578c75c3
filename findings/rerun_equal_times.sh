#!/usr/bin/env bash
# An IMU's driver hands on what it has every tenth of a second: ten messages, recorded at one time, whose stamps are 10 ms apart. Another
# driver stamps such a batch with one time. The MCAP is converted for rerun and its table is read. How many rows are there?
# Guess: one for each message, whichever of its times is the index. Seen with rerun-sdk 0.41.0 on 2026-11-29: one for each TIME, with the last
# message of it; of the other nine no word, while the file has them all, and a count of 100 in its own statistics. The first driver has 10
# rows by `message_log_time`, 100 by `ros2_timestamp`, the second 100 and 10.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rerun-sdk==0.41.0 datafusion==54.0.0 pandas==3.1.1 mcap-ros2-support==0.6.0
cd "$folder"
venv/bin/python - <<'PYTHON'
import subprocess
from pathlib import Path

import rerun
from mcap_ros2.writer import Writer

IMU = """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
START_NS, STEP_NS, BATCH = 1_700_000_000 * 10**9, 10_000_000, 10


def record(path, log_times_ns, stamps_ns):
    with open(path, "wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("sensor_msgs/msg/Imu", IMU)
        for number, (log_time_ns, stamp_ns) in enumerate(zip(log_times_ns, stamps_ns, strict=True)):
            sec, nanosec = divmod(stamp_ns, 10**9)
            message = {"header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": "imu"}}
            for name in ("orientation", "angular_velocity", "linear_acceleration"):
                message[name] = {"x": float(number), "y": 0.0, "z": 0.0, "w": 1.0}
                message[f"{name}_covariance"] = [0.0] * 9
            writer.write_message("/imu", schema, message, log_time=log_time_ns, publish_time=log_time_ns)
        writer.finish()


def rows(path):
    """Return for each index how many rows the table has, and which messages are in them."""
    table = path.replace(".mcap", ".rrd")
    subprocess.run(["venv/bin/rerun", "mcap", "convert", path, "-o", table], check=True, capture_output=True)
    found = {}
    with rerun.server.Server(datasets={"drive": [str(Path(table).resolve())]}) as server:
        drive = server.client().get_dataset("drive")
        for index in ("message_log_time", "ros2_timestamp"):
            read = drive.reader(index=index).to_pandas()
            found[index] = [round(float(values[0])) for values in read["/imu:Scalars:scalars"]]
            (announced,) = read["/__mcap_properties:McapStatistics:message_count"].iloc[0]
            assert announced == len(each)
    return found


each = [START_NS + STEP_NS * number for number in range(100)]
batches = [START_NS + STEP_NS * (number // BATCH * BATCH + BATCH) for number in range(100)]
record("logged.mcap", batches, each)
record("stamped.mcap", each, batches)
seen = {path: rows(path) for path in ("logged.mcap", "stamped.mcap")}
print({path: {index: len(found) for index, found in of.items()} for path, of in seen.items()})
every, last = list(range(100)), list(range(BATCH - 1, 100, BATCH))
assert seen["logged.mcap"] == {"message_log_time": last, "ros2_timestamp": every}
assert seen["stamped.mcap"] == {"message_log_time": every, "ros2_timestamp": last}
PYTHON
