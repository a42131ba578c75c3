#!/usr/bin/env bash
# The metadata.yaml of two ROS 2 bags was lost, as a recorder that is killed never writes it: one has 12 parts of a second each, drive_0.db3 to drive_11.db3; the messages of the
# other were compressed one by one (zstd), which metadata.yaml alone says. ros2bag-repairer writes it again. Guess: both are read as before, or the second is left alone.
# Seen with ros2bag-repairer 0.1.0 and rosbags 0.11.9 on 2026-11-30, without a word ("repaired"):
# - parts are listed as their names sort: 0, 1, 10, 11, 2, … rosbags reads them in the order of the list (`AnyReader`, too), so time goes ahead by 8 s and back by 9.9
# - compressed messages are listed as plain ones, so that rosbags refuses each, and what does not check reads the bytes of zstd as numbers (findings/mcap_compressed_messages.sh)
# - a metadata.yaml that is there and whole is replaced all the same: with it, the second bag was well, and is no longer
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check ros2bag-repairer==0.1.0 rosbags==0.11.9 numpy==2.4.6 PyYAML==6.0.3
cd "$folder"
venv/bin/python - <<'PYTHON'
import shutil
import subprocess
from pathlib import Path

import numpy as np
import yaml
from rosbags.highlevel import AnyReader
from rosbags.highlevel.anyreader import AnyReaderError
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
VECTOR, START_NS = "geometry_msgs/msg/Vector3", 1_700_000_000 * 10**9


def write(path, numbers, *, compressed=False):
    """Write a bag of a message every 0.1 s, whose x is its number."""
    writer = Writer(path, version=9)
    if compressed:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/speed", VECTOR, typestore=STORE)
        for number in numbers:
            data = STORE.serialize_cdr(STORE.types[VECTOR](float(number), 0.0, 0.0), VECTOR)
            writer.write(connection, START_NS + number * 10**8, data)


def read(path):
    with AnyReader([path]) as reader:
        return [int(reader.deserialize(data, one.msgtype).x) for one, _, data in reader.messages()]


def repair(path):
    said = subprocess.run(["venv/bin/ros2bag-repair", str(path)], check=True, capture_output=True, text=True)
    assert "repaired bag" in said.stdout and "note" not in said.stdout and not said.stderr


drive = Path("drive")
drive.mkdir()
for part in range(12):
    write(Path("part"), range(part * 10, part * 10 + 10))
    shutil.move("part/part.db3", drive / f"drive_{part}.db3")
    shutil.rmtree("part")
repair(drive)
listed = yaml.safe_load((drive / "metadata.yaml").read_text())["rosbag2_bagfile_information"]["relative_file_paths"]
steps = np.diff(read(drive)) / 10
print("parts:", *listed, f"; time goes on by {steps.max()} s, and back by {-steps.min()} s")
assert listed[:5] == [f"drive_{part}.db3" for part in (0, 1, 10, 11, 2)]
assert (steps.max(), steps.min()) == (8.1, -9.9)

write(Path("small"), range(3), compressed=True)
assert read(Path("small")) == [0, 1, 2]
repair(Path("small"))
try:
    raise AssertionError(read(Path("small")))
except AnyReaderError as err:
    print("compressed by message:", err)
assert "compression_mode: ''" in Path("small/metadata.yaml").read_text()
PYTHON
