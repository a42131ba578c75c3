#!/usr/bin/env bash
# Which end of a revolution do the times of its points count from, and is the lidar's extrinsic applied to them?
# Guess: the first point has the time 0 and all later ones more; points are in the sensor's frame, or extrinsics are in metres.
# Seen with velodyne-decoder 3.1.0 and ouster-sdk 1.0.1 on 2026-11-28, at 10 revolutions per second:
# - velodyne-decoder, as it is set up: from the first firing of the LAST packet: -0.0995 to +0.0013 s, and that is the stamp of the
#   revolution. With `timestamp_first_packet` from the first one: 0 to 0.1008 s.
# - ouster-sdk: absolute times, one for each column. A column that was lost on the way has the time 0 and stays in the frame, as points
#   at exactly (0, 0, 0): the smallest of `timestamp` is 1970. `status` tells them.
# - ouster-sdk: `XYZLut` leaves the extrinsic out unless `use_extrinsics=True`; it is in metres, while the transforms beside it in
#   the same SensorInfo, `lidar_to_sensor_transform` and `beam_to_lidar_transform`, are in millimetres.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check velodyne-decoder==3.1.0 ouster-sdk==1.0.1
"$folder/venv/bin/python" - <<'PYTHON'
import struct

import numpy as np
import ouster.sdk.core as ouster
import velodyne_decoder as velodyne

START_S, FIRING_US = 1700000000.0, 55.296  # of a VLP-16


def velodyne_times(first_packet):
    """Return the stamp of a whole revolution, and the first and last time of its points."""
    config = velodyne.Config(model=velodyne.Model.VLP16)
    config.timestamp_first_packet = first_packet
    decoder = velodyne.StreamDecoder(config)
    for number in range(160):
        us = int(number * 24 * FIRING_US)
        blocks = (  # two firings in each, 0.2 degrees apart; all returns at 10 m
            struct.pack("<HH", 0xEEFF, (number * 12 + block) * 40 % 36000) + struct.pack("<HB", 5000, 100) * 32
            for block in range(12)
        )
        packet = b"".join(blocks) + struct.pack("<IBB", us, 0x37, 0x22)
        if revolution := decoder.decode(START_S + us * 1e-6, packet):
            stamp, points = revolution
            return tuple(round(float(t), 4) for t in (stamp.host - START_S, points[:, 4].min(), points[:, 4].max()))
    raise SystemExit("no revolution")


for first_packet, seen in ((False, (0.0995, -0.0995, 0.0013)), (True, (0.0, 0.0, 0.1008))):
    got = velodyne_times(first_packet)
    print(f"velodyne-decoder, timestamp_first_packet={first_packet}: stamp {got[0]} s, points {got[1]} to {got[2]} s")
    assert got == seen

info = ouster.SensorInfo.from_default(ouster.LidarMode(1024, 10))
info.sensor_to_body = np.array([[1.0, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
sent, frame = ouster.LidarFrame(info), ouster.LidarFrame(info)
sent.status[:], sent.measurement_id[:] = 1, np.arange(sent.w)
sent.timestamp[:] = 10**18 + np.arange(sent.w) * 97656
sent.field("RANGE")[:] = 10_000
batcher = ouster.FrameBatcher(info)
for number, packet in enumerate(ouster.frame_to_packets(sent, ouster.PacketFormat(info), 0, 0)):
    if number != 10:  # it got lost: columns 160 to 175
        batcher.batch(packet, frame)
there = frame.status > 0
assert not there[160:176].any() and there.sum() == 1024 - 16
bare, placed = ouster.XYZLut(info)(frame), ouster.XYZLut(info, use_extrinsics=True)(frame)
shift = (placed - bare)[0, 500]
lift_mm = info.lidar_to_sensor_transform[2, 3]
print(f"ouster-sdk: times from {frame.timestamp.min()}, {np.all(bare == 0, axis=2).sum()} points at (0, 0, 0)")
print(f"ouster-sdk: a body transform of 2 moves points by {shift}, beside a lidar that is {lift_mm} above the sensor's base")
assert frame.timestamp.min() == 0
assert np.all(bare[:, ~there] == 0) and not np.any(np.all(bare[:, there] == 0, axis=2))
assert np.allclose(shift, [2, 0, 0])
assert lift_mm == 36.18
PYTHON
