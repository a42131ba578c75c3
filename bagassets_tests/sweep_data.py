"""Messages that tests of lidar and radar feed to decoders and steps."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bagassets.recordings.model import RawMessage
from bagassets.store.artifact import Artifact, ArtifactWriter

CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8, "i8": 9, "u8": 10}


@dataclass
class Time:
    sec: int
    nanosec: int


@dataclass
class Header:
    stamp: Time
    frame_id: str = "lidar"


@dataclass
class Field:
    name: str
    offset: int
    datatype: int
    count: int = 1


@dataclass
class Cloud:
    header: Header
    height: int
    width: int
    fields: list[Field]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: np.ndarray
    is_dense: bool = False


@dataclass
class Scan:
    header: Header
    ranges: np.ndarray
    intensities: np.ndarray
    angle_min: float = -1.0
    angle_max: float = 1.0
    angle_increment: float = 0.01
    time_increment: float = 0.0
    scan_time: float = 0.0
    range_min: float = 0.1
    range_max: float = 30.0


@dataclass
class VelodynePacket:
    stamp: Time
    data: np.ndarray


@dataclass
class VelodyneScan:
    header: Header
    packets: list[VelodynePacket] = field(default_factory=list)


@dataclass
class EthernetPacket:
    header: Header
    payload: np.ndarray


def header(stamp_ns: int, frame_id: str = "lidar") -> Header:
    return Header(Time(stamp_ns // 10**9, stamp_ns % 10**9), frame_id)


def cloud(stamp_ns: int, columns: dict[str, np.ndarray], frame_id: str = "lidar") -> Cloud:
    """A tightly packed, unorganised cloud of the given columns."""
    dtype = np.dtype([(name, values.dtype) for name, values in columns.items()])
    table = np.zeros(len(next(iter(columns.values()))), dtype)
    for name, values in columns.items():
        table[name] = values
    fields = [
        Field(name, dtype.fields[name][1], CODES[dtype.fields[name][0].str.lstrip("<|>=")])
        for name in columns
    ]
    step = dtype.itemsize
    data = np.frombuffer(table.tobytes(), np.uint8)
    return Cloud(header(stamp_ns, frame_id), 1, len(table), fields, False, step, step * len(table), data)


# --- Velodyne packets, as in the VLP-16 and VLS-128 manuals ---------------------------------

BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("returns", [("distance", "<u2"), ("i", "u1")], 32)])
PACKET_TYPE = np.dtype([("blocks", BLOCK, 12), ("us", "<u4"), ("mode", "u1"), ("product", "u1")])
VLP16_ELEVATIONS = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
VLP16_PACKET_NS = 24 * 55_296
VLS128_PACKET_NS = 173_400


def vlp16_packets(
    turns: float, *, rpm: int = 600, distance_mm: int = 20_000, start_deg: float = 0.0, first_us: int = 1_000
) -> np.ndarray:
    """Packets of a VLP-16 that sees a wall at the same distance everywhere."""
    deg_per_packet = rpm * 6.0 * VLP16_PACKET_NS * 1e-9
    number = round(turns * 360 / deg_per_packet)
    packets = np.zeros(number, PACKET_TYPE)
    packets["blocks"]["flag"] = 0xEEFF
    starts = start_deg + np.arange(number)[:, None] * deg_per_packet + np.arange(12) * deg_per_packet / 12
    packets["blocks"]["azimuth"] = np.floor(np.mod(starts, 360) * 100)
    packets["blocks"]["returns"]["distance"] = distance_mm // 2
    packets["blocks"]["returns"]["i"] = 77
    packets["us"] = (first_us + np.floor(np.arange(number) * VLP16_PACKET_NS / 1000)) % 3_600_000_000
    packets["mode"], packets["product"] = 0x37, 0x22
    return packets


def vls128_packets(number: int, *, rpm: int = 600) -> np.ndarray:
    """Packets of a VLS-128: three firings of four banks of 32 lasers each."""
    packets = np.zeros(number, PACKET_TYPE)
    packets["blocks"]["flag"] = np.tile([0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF], 3)
    deg = rpm * 6.0 * VLS128_PACKET_NS * 1e-9
    starts = np.arange(number)[:, None] * deg + np.repeat(np.arange(3), 4) * deg / 3
    packets["blocks"]["azimuth"] = np.floor(np.mod(starts, 360) * 100)
    packets["blocks"]["returns"]["distance"] = 5_000  # of 4 mm
    packets["blocks"]["returns"]["i"] = 100
    packets["us"] = np.floor(np.arange(number) * VLS128_PACKET_NS / 1000)
    packets["mode"], packets["product"] = 0x37, 0xA1
    return packets


def velodyne_scan(packets: np.ndarray, start_ns: int, packet_ns: int) -> VelodyneScan:
    scan = VelodyneScan(header(start_ns))
    for number, packet in enumerate(packets):
        stamp = start_ns + number * packet_ns
        data = np.frombuffer(packet.tobytes(), np.uint8)
        scan.packets.append(VelodynePacket(header(stamp).stamp, data))
    return scan


# --- a recording without a file -------------------------------------------------------------


class StandIn(bytes):
    """Stands in for the bytes of a message that is decoded already."""

    message: Any

    @classmethod
    def of(cls, message: Any) -> "StandIn":
        made = cls(b"a message")
        made.message = message
        return made


class Messages:
    """Stands in for a recording and its topic."""

    name, msgtype = "/sensor", "a type"

    def __init__(self) -> None:
        self.topics = {"/sensor": self}

    def decode(self, message: RawMessage) -> Any:
        assert isinstance(message.data, StandIn)
        if isinstance(message.data.message, Exception):
            raise message.data.message
        return message.data.message

    def packet(self, data: Any, payloads: Any) -> None:
        """Leave it to decoding."""

    def packets(self, messages: Any, payloads: Any) -> None:
        """Leave them to decoding."""


def raw(message: Any, msgtype: str, log_time_ns: int, topic: str = "/sensor") -> RawMessage:
    return RawMessage(topic, msgtype, log_time_ns, StandIn.of(message))


def finished(writer: ArtifactWriter, folder) -> Artifact:
    return Artifact("x", folder)
