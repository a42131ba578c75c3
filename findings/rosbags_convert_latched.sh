#!/usr/bin/env bash
# What does rosbags-convert make of a ROS 1 topic that one node latches and another does not (as with /tf_static or /map)?
# Guess: one topic with both qualities of service. Seen with rosbags 0.11.9 on 2026-11-28: the ROS 2 bag lists the topic
# twice, with half of the messages each, in metadata.yaml and in the table `topics`; rosbag2 itself writes each name once.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rosbags==0.11.9
cd "$folder"
venv/bin/python - <<'PYTHON'
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS1_NOETIC)
String = store.types["std_msgs/msg/String"]
with Writer("drive.bag") as writer:
    for latching in (1, 0):
        connection = writer.add_connection(
            "/map_name", "std_msgs/msg/String", typestore=store, callerid=f"/node{latching}", latching=latching
        )
        data = store.serialize_ros1(String("yard"), "std_msgs/msg/String")
        writer.write(connection, 10**18 + latching, data)
PYTHON
venv/bin/rosbags-convert --src drive.bag --dst drive
venv/bin/python - <<'PYTHON'
import sqlite3
from pathlib import Path

rows = sqlite3.connect("drive/drive.db3").execute("SELECT name, COUNT(*) FROM topics GROUP BY name").fetchall()
listed = Path("drive/metadata.yaml").read_text().count("name: /map_name")
print(f"rows of the table: {rows}; entries of metadata.yaml: {listed}")
assert rows == [("/map_name", 2)]
assert listed == 2
PYTHON
