#!/usr/bin/env bash
# An inertial system of OxTS sends NCOM packets, whose status bytes are about something else in each. Here the system says that UTC is 18 s behind GPS time,
# that the last GNSS position was 2.0 standard deviations off in x, -2.0 in y, and not used in z, that its gyroscopes have a bias of 0.001 rad/s, and that
# its heading is known to 0.1 degrees. What does rt-range read? Guess: the same. Seen with rt-range 0.3.2 on 2026-11-29, by the units that the maker's
# own decoder has: a UTC that is 93 s ahead; 4.1 and 8.9 deviations, and 0.0 for z; 0.02 rad/s; and 175 "mm" of heading. It cuts off the sign where
# it should shift out the lowest bit, which says whether there is a value; bias comes in steps of 0.000005 rad/s, not of 0.0001, accuracies of
# angles in hundredths of a milliradian. Position, velocity, angles, accelerations and rates of the packets are right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps rt-range==0.3.2 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import math
import struct

from rt_range.ethernet.ncom import NCOM


def three_bytes(value):
    return struct.pack("<i", value)[:3]


def flagged(value):
    """Return a signed byte as NCOM has some: a value in seven bits, and below them one that says that it is valid."""
    return struct.pack("<b", value << 1 | 1)


def read(channel, status):
    """Return what rt-range reads of a packet with these eight status bytes."""
    packet = b"\xe7" + struct.pack("<H", 12_345) + b"".join(map(three_bytes, (1000, 0, -98_100, 0, 0, -25_000)))
    packet += bytes([4, sum(packet[1:]) + 4 & 0xFF])
    packet += struct.pack("<ddf", math.radians(48.1), math.radians(11.5), 520.0) + b"".join(map(three_bytes, (100_000, 0, 0, 1_570_796, 0, 0)))
    packet += bytes([sum(packet[1:]) & 0xFF, channel]) + status
    return NCOM.parse(packet + bytes([sum(packet[1:]) & 0xFF]))


time = read(16, struct.pack("<3hB", 0, 0, 0, 0) + flagged(-18))
innovations = read(1, flagged(20) + flagged(-20) + bytes(6))
bias = read(6, struct.pack("<3hBB", round(0.001 / 5e-6), 0, 0, 1, 0))
accuracy = read(5, struct.pack("<3HBB", round(math.radians(0.1) / 1e-5), 0, 0, 1, 0))
print("UTC minus GPS time, s:", time["batch_s_UTC_time_offset"])
print("innovations in x, y, z:", *(innovations[f"batch_s_position_{axis}_innovation"] for axis in "xyz"))
print("bias, rad/s:", bias["batch_s_gyro_bias_x"], "accuracy of heading:", accuracy["batch_s_heading_accuracy"])
(unit,) = [field.unit for field in NCOM._fields[(5,)] if field.name == "batch_s_heading_accuracy"]
assert math.isclose(math.degrees(time["latitude"]), 48.1) and math.isclose(time["acceleration_z"], -9.81) and math.isclose(time["north_velocity"], 10)
assert math.isclose(time["angular_rate_z"], -0.25) and math.isclose(time["heading"], 1.570796) and math.isclose(time["time"], 12.345)
assert time["batch_s_UTC_time_offset"] == 93
assert [float(innovations[f"batch_s_position_{axis}_innovation"]) for axis in "xyz"] == [4.1, 8.9, 0.0]
assert math.isclose(bias["batch_s_gyro_bias_x"], 0.02)
assert accuracy["batch_s_heading_accuracy"] == 175 and unit == "mm"
PYTHON
