#!/usr/bin/env bash
# A Hesai XT32 turns ten times a second, 600 rpm. Three revolutions of it, 2000 firings each, as packets of UDP in PandarScan messages, one message a
# revolution, become clouds with hydra4. When was each point measured, and how many clouds are there? In a second recording each firing has two returns, a
# window at 5 m and the wall behind it at 20 m. Guess: each point within the 0.1 s of its revolution, at the UTC of its packet; three clouds; both returns.
# Seen with hydra4 0.2.0 on 2026-11-30, without a word:
# - the times of blocks in a packet, microseconds in the manual of the lidar, are added as SECONDS: the points of one revolution of 0.1 s have times over
#   350.1 s. Only those of the last of eight blocks are near the truth, 3.28 s late; sorted by time, revolutions are interleaved. (Its other lidar, OT128, has
#   microseconds)
# - UTC of the packet is taken for the time of the machine: with TZ=Europe/Berlin all is an hour earlier
# - two clouds: the last revolution only comes out when a next one begins
# - of two returns the FIRST block of each pair is there, here the window; the wall is nowhere, and no parameter brings it back
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check hydra4==0.2.0 pypcd4==1.5.1 numpy==2.2.6
cat > clouds.py <<'PYTHON'
import struct
import sys
from datetime import UTC, datetime, timedelta

import numpy as np
from hydra4 import Hydra
from hydra4.msgs import builtin_interfaces__msg__Time as Time
from hydra4.msgs import pandar_msgs__msg__PandarPacket as Packet
from hydra4.msgs import pandar_msgs__msg__PandarScan as Scan
from hydra4.msgs import std_msgs__msg__Header as Header

BEGIN = datetime(2026, 1, 15, 12, tzinfo=UTC)
FIRINGS, FIRING_US, STRONGEST, LAST_FIRST = 2000, 50, 0x37, 0x3B


def packet(first_firing, *, dual):
    """Return a packet of eight blocks, of eight firings or of four with two returns each."""
    firings = [first_firing + (block // 2 if dual else block) for block in range(8)]
    blocks = b""
    for block, firing in enumerate(firings):
        distance_m = (5 if block % 2 == 0 else 20) if dual else 20
        blocks += struct.pack("<H", round(firing % FIRINGS * 36000 / FIRINGS)) + struct.pack("<HBB", round(distance_m / 0.004), 100, 0) * 32
    at = BEGIN + timedelta(microseconds=firings[-1] * FIRING_US)
    date = bytes([at.year - 1900, at.month, at.day, at.hour, at.minute, at.second])
    tail = bytes(10) + bytes([LAST_FIRST if dual else STRONGEST]) + struct.pack(">H", 600 * 10) + date
    tail += struct.pack("<I", at.microsecond) + bytes([0x42]) + bytes(4)
    data = bytes([0xEE, 0xFF, 6, 1, 0, 0, 32, 8, 0, 4, 2 if dual else 1, 0]) + blocks + tail
    return Packet(Time(0, 0), np.frombuffer(data, np.uint8), len(data))


def clouds(*, dual):
    hydra, step, found = Hydra(Hydra.Model.PandarXT32), 4 if dual else 8, []
    for revolution in range(3):
        packets = [packet(revolution * FIRINGS + firing, dual=dual) for firing in range(0, FIRINGS, step)]
        found += hydra.to_pypcd4(Scan(Header(Time(0, 0), "lidar"), packets))
    return found


single = clouds(dual=False)
times_s = [cloud.pc_data["stamp"] - BEGIN.timestamp() for cloud in single]
print(f"{len(single)} clouds of {[cloud.points for cloud in single]} points, {[(round(float(t.min()), 2), round(float(t.max()), 2)) for t in times_s]} s after the begin")
zone_s = float(sys.argv[1])
assert [cloud.points for cloud in single] == [FIRINGS * 32] * 2
for revolution, each_s in enumerate(times_s):
    assert abs(np.ptp(each_s) - 350.1) < 0.01
    assert abs(each_s.max() - (zone_s + 3.28 + 0.1 * (revolution + 1))) < 0.001
    last_block = each_s.reshape(-1, 8, 32)[:, 7]
    truth_s = (revolution * FIRINGS + np.arange(7, FIRINGS, 8)) * FIRING_US * 1e-6
    assert np.allclose(last_block - truth_s[:, None] - zone_s, 3.28, atol=1e-4)

both = clouds(dual=True)[0]
ranges_m = np.linalg.norm(both.numpy(("x", "y", "z")), axis=1)
print(f"two returns: {both.points} points, at {ranges_m.min():.2f} to {ranges_m.max():.2f} m")
assert both.points == FIRINGS * 32
assert np.allclose(ranges_m, 5, atol=1e-3)
PYTHON
TZ=UTC venv/bin/python clouds.py 0
TZ=Europe/Berlin venv/bin/python clouds.py -3600
