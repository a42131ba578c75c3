#!/usr/bin/env bash
# Which end of a cloud do the times of Livox points count from, and is the lidar's extrinsic applied to them?
# Guess: from the last packet or as times of day, as those of Velodyne and Ouster; and points are in the sensor's frame.
# Seen with py-livox2 0.1.0 (Livox's own SDK2 1.3.3, and a driver around it) and a Mid-360 that this script plays on the loopback, on
# 2026-11-29:
# - from the first point, whose time is the stamp of the cloud. A cloud has no revolution: it is cut 0.1 s after its first packet.
# - the extrinsic is sent to the lidar as its install attitude, and that is all: points arrive, and are published, as they were sent.
# livox_ros_driver2 1.2.6, which no package carries, differs in the second answer. Its pub_handler.cpp counts from the first point, too
# (CustomMsg: header stamp = `timebase`, to which `offset_time` is added; PointCloud2: `timestamp` is the sum), but turns and moves the
# points by the extrinsic of its JSON file. Of a packet that lasts T with N points, it takes T/N from one to the next, and this driver
# T/(N-1). (Seen by calling its code, which is not done here.)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check py-livox2==0.1.0
cd "$folder"
HOME="$folder" "$folder/venv/bin/python" - <<'PYTHON'
import binascii
import socket
import struct
import time
import zlib

import livox_sdk
import numpy as np
from livox_sdk_cli.cfg import LivoxNetworkConfig
from livox_sdk_cli.cli import livox_runner
from livox_sdk_cli.ivox2.iceoryx_bridge import _PointCloudBuilder

HOST, LIDAR = "127.0.0.1", "127.0.0.2"
START_NS, PACKET_NS, POINTS = 1_700_000_000_000_000_000, 500_000, 96
LASTS_NS = 475_000  # from the first point of a packet to its last
SEARCH_PORT, MID360, INSTALL_ATTITUDE = 56000, 9, 0x0012
clouds = []


class Bridge:
    """Keeps the messages that the driver would publish in shared memory."""

    def __init__(self, config):
        self.builder = _PointCloudBuilder(config.frame_id)

    def publish_pointcloud(self, *arguments):
        clouds.append(self.builder.build(*arguments))


def packet(number):
    """Return a packet of points that are all at (10, 1, 0.5) m."""
    points = struct.pack("<iiiBB", 10_000, 1_000, 500, 100, 0) * POINTS
    stamp = struct.pack("<Q", START_NS + number * PACKET_NS)
    head = struct.pack("<BHHHHBBB12x", 0, 36 + len(points), LASTS_NS // 100, POINTS, number, 0, 1, 1)
    return head + struct.pack("<I", zlib.crc32(stamp + points)) + stamp + points


def search_answer():
    """Return the answer of a Mid-360 to a host that looks for lidars."""
    found = struct.pack("<BB16s4sH", 0, MID360, b"3JEDK380010Z001", socket.inet_aton(LIDAR), config.lidar_cmd_data_port)
    head = struct.pack("<BBHIHBB6x", 0xAA, 0, 24 + len(found), 1, 0, 1, 1)
    return head + struct.pack("<HI", binascii.crc_hqx(head, 0xFFFF), zlib.crc32(found)) + found


def lidar_socket(port):
    there = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    there.bind((LIDAR, port))
    there.settimeout(5)
    return there


extrinsic = {"roll": 0, "pitch": 0, "yaw": 90, "x": 1000, "y": 2000, "z": 3000}
config = LivoxNetworkConfig(host_ip=HOST, lidar_ipaddr=LIDAR, multicast_ip="", extrinsic_parameter=extrinsic)
search, commands, data = map(lidar_socket, (SEARCH_PORT, config.lidar_cmd_data_port, config.lidar_point_data_port))
livox_runner.IceoryxBridge = Bridge
runner = livox_runner.LivoxRunner(config)
assert runner.init_sdk()
livox_sdk.SetLivoxLidarPointCloudCallBack(runner.pointcloud_callback)
search.sendto(search_answer(), (HOST, SEARCH_PORT))
time.sleep(1)
runner._on_lidar_info_change(struct.unpack("<I", socket.inet_aton(LIDAR))[0], MID360)
time.sleep(1)
commands.setblocking(False)
told = []
try:
    while True:
        told.append(commands.recv(1500))
except BlockingIOError:
    pass
attitude = struct.pack("<HHfffiii", INSTALL_ATTITUDE, 24, 0, 0, 90, 1000, 2000, 3000)
print(f"commands to the lidar: {len(told)}, with its install attitude: {sum(attitude in one for one in told)}")

for number in range(202):
    data.sendto(packet(number), (HOST, config.host_point_data_port))
    time.sleep(0.0005)
time.sleep(1)
livox_sdk.LivoxLidarSdkUninit()
cloud = clouds[0]
points = np.frombuffer(bytes(cloud.data[: cloud.data_length]), runner.iceoryx.builder._dtype)
times, stamp_ns = points["offset_time"].astype(float), cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec
xyz = [float(points[name][0]) for name in "xyz"]
print(f"{cloud.width} points, stamp {stamp_ns - START_NS} ns after the first point's, times {times[0]} to {times[-1]:.6f} s")
print(f"from point to point {np.diff(times)[:95].mean() * 1e9:.1f} ns; sent (10, 1, 0.5), in the message {xyz}")
assert any(attitude in one for one in told)
assert stamp_ns == START_NS and times[0] == 0 and len(points) == 201 * POINTS
assert abs(times[-1] - (200 * PACKET_NS + LASTS_NS) * 1e-9) < 1e-8
assert np.all(np.diff(times) > 0) and abs(np.diff(times)[:95].mean() - 5e-6) < 1e-12
assert xyz == [10.0, 1.0, 0.5]
PYTHON
