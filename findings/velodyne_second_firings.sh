#!/usr/bin/env bash
# A Velodyne VLP-16 turns 20 times a second. A packet has the angle of every SECOND firing; the one between is 55 microseconds, 0.4 degrees, later, and its lasers fire one
# after the other. The packets become points with @foxglove/velodyne-cloud and with velodyne-decoder. At which angles are they?
# Guess: at those of their firings, in both; each has the formula of the manual. Seen on 2026-11-29:
# - velodyne-decoder 3.1.0: so it is, within 0.02 degrees
# - @foxglove/velodyne-cloud 1.0.1: BOTH firings at the angle of the first, without a word: the second ones are 0.4 to 0.65 degrees off, 0.57 m at 50 m, and lie upon
#   the first, which are up to 0.25 off themselves. Angles are computed, and select the points, by `minAngle` and `maxAngle`, but positions are made of those in the packet
# - its `timestamp()`, which it takes where no time is given, lies 31,700 years ahead for a packet that is 1 s past the hour: microseconds are multiplied by 1e6
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check velodyne-decoder==3.1.0 numpy==2.4.6
cd "$folder"
npm install --silent --no-fund --no-audit --prefix "$folder" @foxglove/velodyne-cloud@1.0.1
cat > points.cjs <<'JAVASCRIPT'
const fs = require("node:fs");
const { Calibration, Model, PointCloud, RawPacket, Transformer } = require("@foxglove/velodyne-cloud");

const packet = new RawPacket(new Uint8Array(fs.readFileSync("packet.bin")));
const ahead_s = packet.timestamp() - Date.now() / 1000;
const cloud = new PointCloud({ stamp: 0, maxPoints: 384 });
new Transformer(new Calibration(Model.VLP16)).unpack(packet, 0, 0, cloud);
const points = Array.from({ length: cloud.width }, (_, i) => cloud.point(i)).map(({ x, y, z }) => [x, y, z]);
console.log(JSON.stringify({ ahead_s, points }));
JAVASCRIPT
cat > angles.py <<'PYTHON'
import json
import struct
import subprocess

import numpy as np
import velodyne_decoder as velodyne

FIRING_US, LASER_US, DEG_PER_US = 55.296, 2.304, 20 * 360 / 1e6

azimuths_deg = [90 + 2 * FIRING_US * DEG_PER_US * block for block in range(12)]
blocks = [struct.pack("<HH", 0xEEFF, round(deg * 100)) + struct.pack("<HB", 5000, 100) * 32 for deg in azimuths_deg]
packet = b"".join(blocks) + struct.pack("<IBB", 1_000_000, 0x37, 0x22)
with open("packet.bin", "wb") as file:
    file.write(packet)
late_us = np.array([firing * FIRING_US + laser * LASER_US for firing in range(2) for laser in range(16)])
fired_deg = np.add.outer(azimuths_deg, late_us * DEG_PER_US)  # clockwise, by block and return

answer = json.loads(subprocess.run(["node", "points.cjs"], check=True, capture_output=True, text=True).stdout)
packets = velodyne.PacketVector([velodyne.VelodynePacket(1.0, packet)])
_, decoded = velodyne.ScanDecoder(velodyne.Config(model=velodyne.Model.VLP16)).decode(packets)
off_deg = {}
for name, points in (("foxglove", np.array(answer["points"])), ("velodyne-decoder", decoded[:, :3])):
    seen_deg = np.degrees(np.arctan2(-points[:, 1], points[:, 0])).reshape(12, 2, 16)
    off_deg[name] = (fired_deg.reshape(12, 2, 16) - seen_deg + 180) % 360 - 180
    print(f"{name}: first firings {np.abs(off_deg[name][:, 0]).max():.2f} degrees off, second {np.abs(off_deg[name][:, 1]).max():.2f}")
assert np.abs(off_deg["velodyne-decoder"]).max() < 0.02
assert np.allclose(off_deg["foxglove"], late_us.reshape(2, 16) * DEG_PER_US, atol=0.02)
print(f"timestamp(): in {answer['ahead_s'] / 31_556_952:.0f} years")
assert abs(answer["ahead_s"] / 1e12 - 1) < 1e-6
PYTHON
venv/bin/python angles.py
