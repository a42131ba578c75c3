#!/usr/bin/env bash
# Clouds of a lidar, as PCD with intensities from 0 to 1, as many drivers and PCL have them, become messages in a record of Apollo (Cyber RT) with cyber_record, and the
# record an MCAP with its converter, to be looked at elsewhere. Guess: intensities as they were, or scaled to whole numbers, which Apollo's message has; and an MCAP
# that others read, since it has protobuf, as Apollo has.
# Seen with cyber_record 0.1.13, wheelos_msgs 0.1.6, mcap 1.6.0 and mcap-protobuf-support 0.6.0 on 2026-11-30: without a word, all intensities but 1.0 are 0, as their
# fractions are cut off (and PCD made of the messages has what is left, as unsigned numbers of four bytes). The converter reports that all messages are converted; but
# nobody else decodes them: the schema of each channel is Apollo's ProtoDesc in place of a FileDescriptorSet. The two look alike, one file without what it
# imports: so only types that import nothing can be read, and nearly each of Apollo's imports its Header
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check cyber-record==0.1.13 wheelos-msgs==0.1.6 "protobuf<6" numpy==2.4.6 mcap==1.6.0 mcap-protobuf-support==0.6.0
cat >convert.py <<'PYTHON'
from pathlib import Path

from cyber_record.converter import convert_file
from cyber_record.message_tools import PointCloudBuilder
from cyber_record.record import Record
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

INTENSITIES = (0.0, 0.25, 0.5, 0.99, 1.0)
START_NS = 1_700_000_000_000_000_000
lines = [f"{number}.5 0.0 1.0 {intensity}" for number, intensity in enumerate(INTENSITIES)]
count = len(lines)
head = f"FIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA ascii\n"
Path("cloud.pcd").write_text("VERSION 0.7\n" + head + "\n".join(lines) + "\n")
cloud = PointCloudBuilder().build("cloud.pcd", "lidar", t=START_NS / 1e9)
found = [point.intensity for point in cloud.point]
print("intensities", INTENSITIES, "are", found)
assert found == [0, 0, 0, 0, 1]
with Record("drive.record", mode="w") as record:
    record.write("/lidar", cloud, START_NS)
report = convert_file("drive.record", "drive.mcap", "record", "mcap")
print("converter:", report)
assert (report["converted"], report["skipped"]) == (1, 0)
with open("drive.mcap", "rb") as file:
    ((schema, channel, message),) = make_reader(file).iter_messages()
assert (schema.encoding, channel.message_encoding, message.log_time) == ("protobuf", "protobuf", START_NS)
files = FileDescriptorSet.FromString(schema.data).file
print("files in the schema:", [one.name for one in files], "which import", [list(one.dependency) for one in files])
assert len(files) == 1 and files[0].dependency
try:
    with open("drive.mcap", "rb") as file:
        list(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
except TypeError as error:
    print("mcap:", error)
    assert "has not been loaded" in str(error)
else:
    raise SystemExit("mcap reads it now")
PYTHON
venv/bin/python convert.py
