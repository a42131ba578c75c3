"""Reading stamp, frame id and packet from a packet message without decoding it.

A lidar recorded packet by packet sends thousands of messages a second. Decoding one into an object, with arrays for
addresses and ports, costs several times as much as what is then done with the packet.
"""

from collections.abc import Callable, Sequence
from struct import Struct

from rosbags.interfaces import Nodetype

from bagassets.recordings.known_types import FieldType
from bagassets.recordings.layouts import Layout
from bagassets.recordings.model import SkimmedPacket

__all__ = ["HEADER", "Skimmer", "packet_skimmer"]

HEADER = "std_msgs/msg/Header"
_HEADER_FIELDS = ["seq", "stamp", "frame_id"]
_SIZES = {
    **dict.fromkeys(("bool", "byte", "char", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float32"), 4),
    **dict.fromkeys(("int64", "uint64", "float64"), 8),
}

_FIRST = Struct("<4xiII")  # after the sequence number: seconds, nanoseconds, length of the frame id
_LENGTH = Struct("<I")


Skimmer = Callable[[bytes | memoryview], SkimmedPacket | None]


def packet_skimmer(layout: Layout, payloads: Sequence[str]) -> Skimmer | None:
    """Return a function that reads packet messages of a type, or None if their layout is not simple.

    A simple layout is that of a ROS 1 message with a header, then fields of fixed size, then the bytes. The function returns
    None for a message whose length is wrong: decoding it raises the proper error.

    Args:
        layout: of the type.
        payloads: possible names of the field with the bytes, the likeliest first.
    """
    fields = dict(layout.types[layout.msgtype][1])
    payload = next((name for name in payloads if name in fields), None)
    kinds = list(fields.values())
    if layout.serialization != "ros1" or len(kinds) < 2 or list(fields)[-1] != payload:
        return None
    if kinds[0] != (Nodetype.NAME, HEADER) or [n for n, _ in layout.types[HEADER][1]] != _HEADER_FIELDS:
        return None
    if kinds[-1][0] != Nodetype.SEQUENCE or _fixed_size(kinds[-1][1][0]) != 1:
        return None
    sizes = [_fixed_size(kind) for kind in kinds[1:-1]]
    if None in sizes:
        return None
    between = sum(size or 0 for size in sizes)

    def skim(data: bytes | memoryview) -> SkimmedPacket | None:
        if len(data) < _FIRST.size:
            return None
        seconds, nanoseconds, length = _FIRST.unpack_from(data)
        frame_end = _FIRST.size + length
        begin = frame_end + between + _LENGTH.size
        if begin > len(data) or _LENGTH.unpack_from(data, begin - _LENGTH.size)[0] != len(data) - begin:
            return None
        try:
            frame = str(data[_FIRST.size : frame_end], "utf-8")
        except UnicodeDecodeError:
            return None
        return SkimmedPacket(seconds * 1_000_000_000 + nanoseconds, frame, bytes(data[begin:]))

    return skim


def _fixed_size(kind: FieldType) -> int | None:
    """Return the size of a field in bytes; None if it varies between messages."""
    if kind[0] == Nodetype.BASE:
        return _SIZES.get(kind[1][0])
    if kind[0] == Nodetype.ARRAY:
        inner, number = kind[1]
        size = _fixed_size(inner)
        return None if size is None else size * int(number)
    return None
