"""Network packets in messages: one payload, as in `ethernet_msgs/Packet` and `udp_msgs/UdpPacket`, or many.

`velodyne_msgs/VelodyneScan` holds many.
"""

from struct import Struct

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


def packets_in(message: Message) -> list[tuple[int | None, bytes]]:
    """Return (own stamp or None, payload) of each packet in a message.

    Raises:
        DecodeError: no field holds packets.
    """
    if hasattr(message, "packets"):
        return [(stamp_ns(packet.stamp), _as_bytes(packet.data)) for packet in message.packets]
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
