#!/usr/bin/env bash
# A recording has images of a grey camera (mono8), an infrared one (mono16), a depth camera (16UC1) and a colour camera (rgb8).
# What are they in rerun?
# Guess: 16UC1 is a depth image, the others are images.
# Seen with rerun-sdk 0.41.0 on 2026-11-28: mono8 and mono16 are depth images, too: their grey levels are taken for distances. A Bayer
# mosaic and rgb8 are images.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rerun-sdk==0.41.0 rosbags==0.11.9 numpy==2.4.6
cd "$folder"
export HOME="$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

TYPE = "sensor_msgs/msg/Image"
store = get_typestore(Stores.ROS2_HUMBLE)
made = store.types
header = made["std_msgs/msg/Header"](made["builtin_interfaces/msg/Time"](1, 0), "cam")
with Writer(Path("drive"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
    for encoding, depth in (("mono8", 1), ("mono16", 2), ("16UC1", 2), ("bayer_rggb8", 1), ("rgb8", 3)):
        image = made[TYPE](header, 4, 6, encoding, 0, 6 * depth, np.full(24 * depth, 7, np.uint8))
        connection = writer.add_connection(f"/{encoding}", TYPE, typestore=store)
        writer.write(connection, 1, store.serialize_cdr(image, TYPE))
PYTHON
"$folder/venv/bin/rerun" mcap convert drive/drive.mcap -o drive.rrd >log 2>&1
"$folder/venv/bin/rerun" rrd print drive.rrd >printed 2>>log
for expected in "mono8 DepthImage" "mono16 DepthImage" "16UC1 DepthImage" "bayer_rggb8 Image" "rgb8 Image"; do
    read -r encoding kind <<<"$expected"
    found=$(grep -- "- /$encoding - " printed | grep -oE "(Depth)?Image:buffer" | cut -d: -f1)
    echo "$encoding: $found"
    test "$found" = "$kind"
done
