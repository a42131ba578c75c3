"""Packets of Hesai lidars that tests write, byte by byte after the manuals."""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from bagassets_tests.sweep_data import header, raw

SCAN, FRAME = "pandar_msgs/msg/PandarScan", "hesai_ros_driver/msg/UdpFrame"
TURN_NS = 100_000_000
SINGLE, DUAL, TRIPLE = 0x37, 0x39, 0x3D


_ANY = b"\x5a"  # what is not read


def _tail(us, minute, second, mode, _loop):
    return _ANY * 10 + struct.pack("<IB", us, mode) + _ANY * 5 + bytes([minute, second])


def _qt_tail(*values):
    return _ANY * 2 + _tail(*values)


def _xt_tail(us, minute, second, mode, _loop):
    return _ANY * 10 + bytes([mode]) + _ANY * 6 + struct.pack("<2BI", minute, second, us) + _ANY


def _qt128_tail(us, minute, second, mode, loop):
    """After a checksum and 17 bytes on safety."""
    return (
        _ANY * 26 + bytes([loop]) + _ANY * 6 + bytes([mode]) + _ANY * 6
        + struct.pack("<2BI", minute, second, us) + _ANY * 9
    )  # fmt: skip


@dataclass(frozen=True)
class Layout:
    """A model: what is before the blocks, its channels and blocks, a return, what is after them, and the time of a block."""

    head: bytes
    channels: int
    blocks: int
    returned: str
    tail: Callable[..., bytes]
    block_ns: int
    mark: bytes = b""

    def steps(self, returns=1):
        """Packets of a turn of 0.1 s."""
        return round(TURN_NS / (self.block_ns * self.blocks / returns))


LAYOUTS = {
    "Pandar40P": Layout(b"", 40, 10, "<HB", _tail, 50_000, b"\xff\xee"),
    "Pandar64": Layout(bytes.fromhex("eeff400600040000"), 64, 6, "<HB", _tail, 50_000),
    "QT64": Layout(bytes.fromhex("eeff03010000400401040201"), 64, 4, "<HBx", _qt_tail, 166_667),
    "XT16": Layout(bytes.fromhex("eeff06010000100801040201"), 16, 8, "<HBx", _xt_tail, 50_000),
    "XT32": Layout(bytes.fromhex("eeff06010000200801040201"), 32, 8, "<HBx", _xt_tail, 50_000),
    "XT32M2X": Layout(bytes.fromhex("eeff06010000200601050301"), 32, 6, "<HBx", _xt_tail, 50_000),
    "QT128": Layout(bytes.fromhex("eeff03020000800201040238"), 128, 2, "<HBx", _qt128_tail, 111_111),
}
UNITS_M = {name: 0.005 if name == "XT32M2X" else 0.004 for name in LAYOUTS}


def corrections(channels, *, lowest_first=False):
    """A correction file: 2 degrees from channel to channel (of 128: a half), and azimuths of -1, 0 and 1."""
    lines = [
        f"{one + 1},{elevation(one, channels, lowest_first):.3f},{one % 3 - 1}.000" for one in range(channels)
    ]
    return "\n".join(["Laser id,Elevation,Azimuth", *lines, ""]).encode()


def elevation(channel, channels, lowest_first=False):
    step = 2.0 if channels <= 64 else 0.5
    place = channel if lowest_first else channels - 1 - channel
    return (place - channels / 2) * step / 2


def distance(channel, late=0):
    """In the units of a packet."""
    return 1_000 + 10 * channel + 300 * late


def seen(azimuth_deg, channel, channels, distance_m):
    """Where a channel of `corrections` sees something."""
    azimuth = math.radians(azimuth_deg + channel % 3 - 1)
    up = math.radians(elevation(channel, channels))
    flat_m = distance_m * math.cos(up)
    return [flat_m * math.sin(azimuth), flat_m * math.cos(azimuth), distance_m * math.sin(up)]


def packet(model, azimuth=0.0, *, step=0.2, us=1_000_000, mode=SINGLE, returns=1, loop=1, distances=distance):
    """One packet.

    Args:
        azimuth: of the first firing, degrees; each further firing is `step` later.
        us: since the top of the hour.
        mode: return mode.
        returns: of a firing, which are in blocks that follow each other.
        loop: of a QT128.
        distances: of a channel and the number of its return.
    """
    one = LAYOUTS[model]
    parts = [one.head]
    for block in range(one.blocks):
        firing, late = divmod(block, returns)
        parts += [one.mark, struct.pack("<H", round((azimuth + step * firing) * 100) % 36_000)]
        parts += [struct.pack(one.returned, distances(c, late), c + 100 * late) for c in range(one.channels)]
    tail = one.tail(us % 1_000_000, us // 60_000_000, us // 1_000_000 % 60, mode, loop)
    return b"".join([*parts, tail])


@dataclass
class Packet:
    stamp: object
    data: np.ndarray
    size: int


@dataclass
class Scan:
    header: object
    packets: list = field(default_factory=list)


def spin(model, turns, *, begin=0.0, returns=1, mode=SINGLE, start_us=5_000_000, turn_ns=TURN_NS, **options):
    """(time after the first one, packet) of each packet of so many turns."""
    number = LAYOUTS[model].steps(returns)
    step = 360.0 / number / (LAYOUTS[model].blocks / returns)
    for index in range(round(begin * number), round((begin + turns) * number)):
        since_ns = index * turn_ns // number
        us = (start_us + since_ns // 1000) % 3_600_000_000
        azimuth = index % number * 360.0 / number
        yield since_ns, packet(model, azimuth, step=step, us=us, mode=mode, returns=returns, **options)


def messages(model, turns, *, start_ns, per_message=100, size=1500, stamped=True, msgtype=SCAN, **options):
    """Messages of a driver: each packet has the stamp of its time by the lidar."""
    packets = list(spin(model, turns, **options))
    for first in range(0, len(packets), per_message):
        part = packets[first : first + per_message]
        made = [
            Packet(
                header(start_ns + since_ns if stamped else 0).stamp,
                np.frombuffer(data.ljust(size or 0, b"\0"), np.uint8),
                len(data),
            )
            for since_ns, data in part
        ]
        yield raw(Scan(header(start_ns + part[0][0]), made), msgtype, start_ns + part[-1][0])
