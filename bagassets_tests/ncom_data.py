"""OxTS NCOM packets written byte by byte, and messages that carry them."""

import math
import struct
from types import SimpleNamespace as Msg

import numpy as np

from bagassets_tests.pose_data import header

ETHERNET = "ethernet_msgs/msg/Packet"
UDP = "udp_msgs/msg/UdpPacket"
INVALID = -(2**23)
GPS_EPOCH_S = 315_964_800


def int24(value):
    return struct.pack("<i", value)[:3]


def microradians(angle_rad):
    return INVALID if angle_rad is None else round(angle_rad * 1e6)


def status_time(minute):
    """Status channel 0: the GPS minute, then satellites and modes."""
    return 0, struct.pack("<i4B", minute, 12, 5, 5, 5)


def status_offset(offset_s):
    """Status channel 16: mounting angles, and the offset of UTC with a valid flag."""
    return 16, struct.pack("<3hBb", 0, 0, 0, 0, (offset_s << 1) | 1)


def ncom(
    minute_ms=0, lat_deg=48.0, lon_deg=11.0, alt_m=500.0, *, heading=0.0, pitch=0.0, roll=0.0,
    velocity=(1.0, -2.0, 0.5), status=4, channel=(1, bytes(8)),
):  # fmt: skip
    """One packet of structure A; angles in radians, None marks them invalid."""
    packet = bytearray(72)
    packet[0] = 0xE7
    packet[1:3] = struct.pack("<H", minute_ms)
    packet[3:21] = bytes(range(18))  # accelerations and rates: not ours
    packet[21] = status
    packet[22] = sum(packet[1:22]) % 256
    packet[23:43] = struct.pack("<ddf", math.radians(lat_deg), math.radians(lon_deg), alt_m)
    packet[43:52] = b"".join(int24(INVALID if v is None else round(v * 1e4)) for v in velocity)
    packet[52:61] = b"".join(int24(microradians(angle)) for angle in (heading, pitch, roll))
    packet[61] = sum(packet[1:61]) % 256
    packet[62] = channel[0]
    packet[63:71] = channel[1]
    packet[71] = sum(packet[1:71]) % 256
    return bytes(packet)


def ethernet(stamp_ns, data, sender=(10, 1, 1, 20), port=3000):
    return Msg(
        header=header(stamp_ns, "eth"),
        sender_ip=np.array(sender, np.uint8),
        sender_port=port,
        receiver_ip=np.array([10, 1, 1, 1], np.uint8),
        receiver_port=3000,
        payload=np.frombuffer(data, np.uint8),
    )


def udp(stamp_ns, data, address="10.1.1.20", port=3000):
    return Msg(
        header=header(stamp_ns, "eth"), address=address, src_port=port, data=np.frombuffer(data, np.uint8)
    )
