"""Reading stamp, frame id and packet from a packet message without decoding it.

A lidar recorded packet by packet sends thousands of messages a second. Decoding one into an object, with arrays for
addresses and ports, costs several times as much as what is then done with the packet.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from struct import Struct

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from bagassets.recordings.elements import SIZES
from bagassets.recordings.known_types import FieldType
from bagassets.recordings.layouts import Layout
from bagassets.recordings.model import SkimmedPacket

HEADER = "std_msgs/msg/Header"
HEADER_FIELDS = {"ros1": ["seq", "stamp", "frame_id"], "cdr": ["stamp", "frame_id"]}
_FIRST = Struct(
    "<4xiII"
)  # after the sequence number, of CDR the encapsulation: seconds, nanoseconds, length of the frame id
_STAMP = np.dtype([("seconds", "<i4"), ("nanoseconds", "<u4")])
_STAMP_BEGIN, _STAMP_END = 4, 12
_LENGTH = Struct("<I")
_CDR_LITTLE_ENDIAN, _ORIGIN = b"\0\1", 4  # how an encapsulation begins; fields are aligned from its end


@dataclass(frozen=True, slots=True, eq=False)
class SkimmedPackets:
    """Packets of messages with one frame id, all of the same size.

    Attributes:
        stamps_ns: (N,) of their headers.
        frame_id: of their headers.
        payloads: (N, L) bytes.
    """

    stamps_ns: NDArray[np.int64]
    frame_id: str
    payloads: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class PacketSkimmer:
    """Reads messages of one type whose layout is simple: header, fields of fixed size, bytes of the packet.

    Attributes:
        between: alignment and size of the fields of fixed size, and of the length of the packet.
        is_cdr: of ROS 2.
    """

    between: tuple[tuple[int, int], ...]
    is_cdr: bool

    def one(self, data: bytes | memoryview) -> SkimmedPacket | None:
        """Read one message; None if its length is wrong: decoding it raises the proper error."""
        if len(data) < _FIRST.size or (self.is_cdr and data[:2] != _CDR_LITTLE_ENDIAN):
            return None
        seconds, nanoseconds, length = _FIRST.unpack_from(data)
        frame_end = begin = _FIRST.size + length
        for alignment, size in self.between:
            begin += (_ORIGIN - begin) % alignment + size
        if begin > len(data) or _LENGTH.unpack_from(data, begin - _LENGTH.size)[0] != len(data) - begin:
            return None
        text = bytes(data[_FIRST.size : frame_end])
        if self.is_cdr and text[-1:] != b"\0":
            return None
        try:
            frame = str(text[:-1] if self.is_cdr else text, "utf-8")
        except UnicodeDecodeError:
            return None
        return SkimmedPacket(seconds * 1_000_000_000 + nanoseconds, frame, bytes(data[begin:]))

    def alike(self, messages: Sequence[bytes]) -> SkimmedPackets | None:
        """Read messages at once; None if they are not alike, of one frame and length, or cannot be read."""
        sizes = {len(message) for message in messages}
        first = self.one(messages[0]) if len(sizes) == 1 else None
        if first is None:
            return None
        rows = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), -1)
        begin = rows.shape[1] - len(first.payload)
        frame_end = _FIRST.size + _FIRST.unpack_from(messages[0])[2]
        alike = [rows[:, _STAMP_END:frame_end], rows[:, begin - _LENGTH.size : begin]]
        alike += [rows[:, :2]] if self.is_cdr else []
        if any((part != part[0]).any() for part in alike):
            return None
        stamps = np.ascontiguousarray(rows[:, _STAMP_BEGIN:_STAMP_END]).view(_STAMP)[:, 0]
        stamps_ns = stamps["seconds"].astype(np.int64) * 1_000_000_000 + stamps["nanoseconds"]
        return SkimmedPackets(stamps_ns, first.frame_id, np.ascontiguousarray(rows[:, begin:]))


def packet_skimmer(layout: Layout, payloads: Sequence[str]) -> PacketSkimmer | None:
    """Return what reads packet messages of a type, or None if their layout is not simple.

    Args:
        layout: of the type.
        payloads: possible names of the field with the bytes, the likeliest first.
    """
    fields = dict(layout.types[layout.msgtype][1])
    payload = next((name for name in payloads if name in fields), None)
    kinds, is_cdr = list(fields.values()), layout.serialization == "cdr"
    if len(kinds) < 2 or list(fields)[-1] != payload or kinds[0] != (Nodetype.NAME, HEADER):
        return None
    if [name for name, _ in layout.types[HEADER][1]] != HEADER_FIELDS.get(layout.serialization):
        return None
    if kinds[-1][0] != Nodetype.SEQUENCE or _fixed_size(kinds[-1][1][0]) != (1, 1):
        return None
    sizes = [_fixed_size(kind) for kind in kinds[1:-1]]
    between = [one for one in (*sizes, (_LENGTH.size, _LENGTH.size)) if one is not None]
    if len(between) <= len(sizes):
        return None
    return PacketSkimmer(tuple((alignment if is_cdr else 1, size) for alignment, size in between), is_cdr)


def _fixed_size(kind: FieldType) -> tuple[int, int] | None:
    """Return alignment and size of a field in bytes; None if its size varies between messages."""
    if kind[0] == Nodetype.BASE:
        size = SIZES.get(kind[1][0])
        return None if size is None else (size, size)
    if kind[0] == Nodetype.ARRAY and int(kind[1][1]):
        inner = _fixed_size(kind[1][0])
        return None if inner is None else (inner[0], inner[1] * int(kind[1][1]))
    return None
