#!/usr/bin/env bash
# A recording is compressed with `pymcap-cli roscompress`, and restored with `rosdecompress`. What changes in clouds and in depth images?
# Guess: x, y and z by up to half of `--resolution` (a centimetre), and nothing else, as it is a resolution in space; depth is left alone,
# or is an error, as it is where it is not compressed ("Unsupported image encoding: 16UC1").
# Seen with pymcap-cli 0.34.0, pureini 0.10.0 (Cloudini) and DracoPy 2.2.0 on 2026-11-28, for a revolution of 0.1 s:
# - Cloudini, as it is set up: every float32 has that resolution. The times of velodyne_pointcloud (`time`, seconds) become multiples of
#   0.01 s, 11 values for 999 points, by which deskewing is off by up to 7.5 cm at 15 m/s; intensities of 0 to 1 become per cents
# - Draco: float64 becomes float32, so the times of Hesai and RoboSense (`timestamp`, seconds since 1970) are all the same;
#   those in float32 stay
# Both drop points that are NaN, so that an organised cloud is none any more.
# - depth of 16 bit in a PNG (`16UC1; png compressed`) becomes H.264 of 8 bit, without a word: 1320 mm are 5 of 255
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check "pymcap-cli[video,pointcloud]==0.34.0" mcap-codec-support==0.17.0 \
  pureini==0.10.0 DracoPy==2.2.0 pointcloud2==0.6.0 small-mcap==0.16.0 rosbags==0.11.9 numpy==2.4.6 opencv-python-headless==4.14.0.94
cd "$folder"
cat >clouds.py <<'PYTHON'
import sys
from pathlib import Path

import cv2
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

TYPE, DEPTH, NUMBER = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CompressedImage", 1000
NUMPY = {4: "<u2", 6: "<u4", 7: "<f4", 8: "<f8"}  # sensor_msgs/PointField
CODES = {kind: code for code, kind in NUMPY.items()}
SINCE = {"time": ("<f4", 0.0), "timestamp": ("<f8", 1_700_000_000.0)}
store = get_typestore(Stores.ROS2_HUMBLE)


def recorded(name):
    kind, begin_s = SINCE[name]
    points = np.zeros(NUMBER, [*((axis, "<f4") for axis in ("x", "y", "z", "intensity")), (name, kind)])
    points["x"] = np.linspace(-50, 50, NUMBER)
    points["intensity"] = np.linspace(0, 1, NUMBER)
    points[name] = begin_s + np.linspace(0, 0.1, NUMBER)
    points["x"][0] = np.nan
    return points


def write():
    made = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}
    header = made["Header"](made["Time"](1_700_000_000, 0), "lidar")
    with Writer(Path("drive"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for name in SINCE:
            points = recorded(name)
            fields = [
                made["PointField"](field, offset, CODES[kind.str], 1)
                for field, (kind, offset) in points.dtype.fields.items()
            ]
            data, step = points.view(np.uint8), points.dtype.itemsize
            message = made["PointCloud2"](header, 1, NUMBER, fields, False, step, len(data), data, False)
            connection = writer.add_connection(f"/{name}", TYPE, typestore=store)
            writer.write(connection, 1, store.serialize_cdr(message, TYPE))
        png = cv2.imencode(".png", np.full((64, 64), 1320, np.uint16))[1].reshape(-1)
        connection = writer.add_connection("/depth", DEPTH, typestore=store)
        image = made["CompressedImage"](header, "16UC1; png compressed ", png)
        writer.write(connection, 1, store.serialize_cdr(image, DEPTH))


def restored(file):
    with AnyReader([Path(file)]) as reader:
        for connection, _, data in reader.messages():
            cloud = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/depth":
                pixels = cv2.imdecode(cloud.data, cv2.IMREAD_UNCHANGED)
                print(f"depth: {pixels.dtype} {pixels[32, 32]}")
                assert pixels.dtype == np.uint8 and pixels.max() < 10
                continue
            layout = {
                "names": [field.name for field in cloud.fields],
                "formats": [NUMPY[field.datatype] for field in cloud.fields],
                "offsets": [field.offset for field in cloud.fields],
                "itemsize": cloud.point_step,
            }
            yield connection.topic[1:], np.frombuffer(cloud.data.tobytes(), np.dtype(layout))


if len(sys.argv) == 1:
    write()
else:
    wrong = {}
    for name, points in restored(sys.argv[1]):
        assert len(points) == NUMBER - 1
        before = recorded(name)[1:]
        for field in ("x", "intensity", name):
            apart = np.abs(points[field].astype(float) - before[field].astype(float)).max()
            print(f"{sys.argv[1]} {field}: up to {apart:.4f} off, {len(np.unique(points[field]))} values")
            wrong[name, field] = round(float(apart), 3), len(np.unique(points[field]))
    if sys.argv[1] == "cloudini.mcap":
        assert wrong["time", "time"] == (0.005, 11)
        assert wrong["time", "intensity"] == (0.005, 101)
        assert wrong["timestamp", "timestamp"] == (0, NUMBER - 1)
    else:
        assert wrong["time", "time"] == (0, NUMBER - 1)
        assert wrong["timestamp", "timestamp"] == (0.1, 1)
PYTHON
venv/bin/python clouds.py
for format in cloudini draco; do
    venv/bin/pymcap-cli roscompress drive/drive.mcap -o small.mcap --force --pc-format $format >log 2>&1
    venv/bin/pymcap-cli rosdecompress small.mcap -o $format.mcap >>log 2>&1
    venv/bin/python clouds.py $format.mcap
done
