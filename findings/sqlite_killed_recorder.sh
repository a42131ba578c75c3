#!/usr/bin/env bash
# A ROS 2 recorder in SQLite's WAL mode is killed after it committed 50 messages, 30 of them only to drive.db3-wal. Who reads 50?
# Guess: rosbags reads 50, as SQLite does. Seen with rosbags 0.11.9 and SQLite 3.40.1 on 2026-11-28: rosbags announces 50
# (metadata.yaml) and yields 20 without an error, since it opens the file as immutable. SQLite reads 50, and even read-only
# (mode=ro) it writes drive.db3-shm beside the recording; a connection that may write empties the WAL into the recording.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rosbags==0.11.9
cd "$folder"
venv/bin/python - <<'PYTHON'
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
text = store.serialize_cdr(store.types["std_msgs/msg/String"]("hi"), "std_msgs/msg/String")
with Writer("drive", version=9) as writer:
    connection = writer.add_connection("/text", "std_msgs/msg/String", typestore=store)
    for number in range(50):
        writer.write(connection, number, text)
PYTHON
venv/bin/python - <<'PYTHON' || true
import os
import signal
import sqlite3

recorder = sqlite3.connect("drive/drive.db3")
rows = recorder.execute("SELECT topic_id, timestamp, data FROM messages WHERE timestamp >= 20").fetchall()
recorder.execute("DELETE FROM messages WHERE timestamp >= 20")
recorder.commit()
recorder.execute("PRAGMA journal_mode = WAL")
recorder.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
recorder.commit()
os.kill(os.getpid(), signal.SIGKILL)
PYTHON
rm -f drive/drive.db3-shm
venv/bin/python - <<'PYTHON'
import sqlite3
from pathlib import Path

from rosbags.highlevel import AnyReader

with AnyReader([Path("drive")]) as reader:
    by_rosbags = reader.message_count, sum(1 for _ in reader.messages())
names = sorted(path.name for path in Path("drive").glob("*.db3*"))
connection = sqlite3.connect("file:drive/drive.db3?mode=ro", uri=True)
(by_sqlite,) = connection.execute("SELECT COUNT(*) FROM messages").fetchone()
written = {path.name for path in Path("drive").glob("*.db3*")} - set(names)
print(f"{names}: rosbags announces {by_rosbags[0]} and yields {by_rosbags[1]}; SQLite reads {by_sqlite} and writes {written}")
assert by_rosbags == (50, 20)
assert by_sqlite == 50
assert written == {"drive.db3-shm"}
PYTHON
