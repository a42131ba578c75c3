"""The map mask that every nuScenes dataset must have: one PNG without any map in it."""

import struct
import zlib

__all__ = ["blank_png"]


def blank_png(width: int, height: int) -> bytes:
    """Return an 8-bit grey PNG of zeros.

    Its data is stored, not deflated: what a compressor makes of it differs between versions of zlib.
    """
    rows = bytes((width + 1) * height)  # a filter byte leads each row
    blocks = [rows[start : start + 0xFFFF] for start in range(0, len(rows), 0xFFFF)]
    stored = b"".join(
        struct.pack("<BHH", number == len(blocks), len(block), len(block) ^ 0xFFFF) + block
        for number, block in enumerate(blocks, start=1)
    )
    data = b"\x78\x01" + stored + struct.pack(">I", zlib.adler32(rows))
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
