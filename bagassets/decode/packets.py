"""Network packets in messages: one payload, as in `ethernet_msgs/Packet` and `udp_msgs/UdpPacket`, or many.

`velodyne_msgs/VelodyneScan` holds many.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from struct import Struct
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import stamp_ns
from bagassets.geometry.kernels.returns import ALL_AZIMUTHS, BANK_FLAGS, PACKET
from bagassets.recordings.model import Message

VELODYNE_PACKET_SIZE = PACKET.itemsize
_VELODYNE_HEAD = Struct("<HH")  # flag and azimuth, in hundredths of a degree, of the first block

# Possible names of the field with the bytes of a packet, in the order of lookup.
PAYLOADS = ("payload", "data", "packet", "raw", "bytes")
_ADDRESSES = ("sender_ip", "address", "src_ip", "source_ip")
_PORTS = ("sender_port", "src_port", "source_port")


@dataclass(frozen=True, eq=False)
class Packets:
    """Data packets, in the order in which they were recorded.

    Attributes:
        host_ns: (N,) when the host received them, on the clock of the recipe.
        data: (N,) all that is in them: of a Velodyne, `PACKET`.
    """

    host_ns: NDArray[np.int64]
    data: NDArray[np.void]

    @cached_property
    def device_us(self) -> NDArray[np.int64]:
        """The lidar's own times (N,), microseconds since the top of the hour."""
        return self.data["us"].astype(np.int64)

    @cached_property
    def azimuths(self) -> NDArray[np.int64]:
        """Azimuths (N,) of their first blocks, hundredths of a degree, clockwise."""
        return self.data["blocks"]["azimuth"][:, 0].astype(np.int64)

    @classmethod
    def joined(cls, parts: Sequence["Packets"]) -> "Packets":
        """Return packets that follow each other."""
        if not parts:
            return cls(np.empty(0, dtype=np.int64), np.empty(0, dtype=PACKET))
        if len(parts) == 1:
            return parts[0]
        # As plain bytes: numpy copies structures field by field.
        kind = parts[0].data.dtype
        data = np.concatenate([part.data.view(np.uint8).reshape(-1, kind.itemsize) for part in parts])
        return type(parts[0])(np.concatenate([part.host_ns for part in parts]), data.view(kind)[:, 0])

    def __getitem__(self, which: slice) -> Self:
        return replace(self, host_ns=self.host_ns[which], data=self.data[which])

    def __len__(self) -> int:
        return len(self.host_ns)


@dataclass(frozen=True, slots=True, eq=False)
class PacketPoints:
    """Points of a revolution: (N, 5) as in `CloudReading`, their (N,) times, and how long after its time a packet begins."""

    points: NDArray[np.float32]
    times_ns: NDArray[np.int64]
    begin_ns: int = 0

    @classmethod
    def room(cls, number: int) -> "PacketPoints":
        """Return room for so many points."""
        return cls(np.empty((number, 5), dtype=np.float32), np.empty(number, dtype=np.int64))


def packets_in(message: Message) -> list[tuple[int | None, bytes]]:
    """Return (own stamp or None, payload) of each packet in a message.

    Raises:
        DecodeError: no field holds packets.
    """
    if hasattr(message, "packets"):
        return [(stamp_ns(packet.stamp), _filled(packet)) for packet in message.packets]
    return [(None, payload(message))]


def is_velodyne_packet(data: bytes) -> bool:
    """Tell by size, flag and azimuth whether bytes are a data packet of any Velodyne model."""
    if len(data) != VELODYNE_PACKET_SIZE:
        return False
    flag, azimuth = _VELODYNE_HEAD.unpack_from(data)
    return bool(flag == BANK_FLAGS[0] and azimuth < ALL_AZIMUTHS)


def payload(message: Message) -> bytes:
    """Return the payload of the one packet in a message.

    Raises:
        DecodeError: no field holds bytes.
    """
    for name in PAYLOADS:
        value = getattr(message, name, None)
        if isinstance(value, np.ndarray | bytes | bytearray | memoryview | list):
            return _as_bytes(value)
    raise DecodeError(f"it has no field {' or '.join(PAYLOADS)} with the bytes of a packet")


def _filled(packet: Message) -> bytes:
    """Return the bytes of a packet; where all arrays are of one length, `size` says how much of it is filled."""
    data, size = _as_bytes(packet.data), getattr(packet, "size", None)
    return data[:size] if isinstance(size, int) and size >= 0 else data


def _as_bytes(value: NDArray[np.generic] | bytes | bytearray | memoryview | list[int]) -> bytes:
    """Return the content of an array field as bytes.

    Raises:
        DecodeError: it is not bytes.
    """
    try:
        return value.tobytes() if isinstance(value, np.ndarray) else bytes(value)
    except (TypeError, ValueError) as err:
        raise DecodeError("its payload is not bytes") from err


def sender(message: Message) -> tuple[str, int]:
    """Return IPv4 address and port of a packet's sender; "" and 0 if the message does not say."""
    address = next((value for name in _ADDRESSES if (value := getattr(message, name, None)) is not None), "")
    if not isinstance(address, str):
        address = ".".join(str(int(part)) for part in address)
    port = next((value for name in _PORTS if (value := getattr(message, name, None)) is not None), 0)
    return address, int(port)
