"""Network packets in messages: `ethernet_msgs/Packet`, `udp_msgs/UdpPacket` and others with one payload."""

from typing import Any

import numpy as np

from bagassets.errors import DecodeError

__all__ = ["PAYLOADS", "as_bytes", "payload", "sender"]

# Names of the field with the bytes of a packet, in the order in which they are looked for.
PAYLOADS = ("payload", "data", "packet", "raw", "bytes")
_ADDRESSES = ("sender_ip", "address", "src_ip", "source_ip")
_PORTS = ("sender_port", "src_port", "source_port")


def payload(message: Any) -> bytes:
    """Return the payload of the one packet in a message.

    Raises:
        DecodeError: no field holds bytes.
    """
    for name in PAYLOADS:
        value = getattr(message, name, None)
        if isinstance(value, np.ndarray | bytes | bytearray | memoryview | list):
            return as_bytes(value)
    raise DecodeError(f"it has no field {' or '.join(PAYLOADS)} with the bytes of a packet")


def as_bytes(value: Any) -> bytes:
    """Return the content of an array field as bytes.

    Raises:
        DecodeError: it is not bytes.
    """
    try:
        return value.tobytes() if isinstance(value, np.ndarray) else bytes(value)
    except (TypeError, ValueError) as err:
        raise DecodeError("its payload is not bytes") from err


def sender(message: Any) -> tuple[str, int]:
    """Return IPv4 address and port that a packet came from; "" and 0 for what the message does not tell."""
    address = next((value for name in _ADDRESSES if (value := getattr(message, name, None)) is not None), "")
    if not isinstance(address, str):
        address = ".".join(str(int(part)) for part in address)
    port = next((value for name in _PORTS if (value := getattr(message, name, None)) is not None), 0)
    return address, int(port)
