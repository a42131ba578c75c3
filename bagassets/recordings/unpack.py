"""Unpacking what recordings hold compressed, never beyond a bound that is known before."""

import bz2
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import zstandard

from bagassets.errors import SizeLimitError
from bagassets.recordings.damage import DamageError
from bagassets.recordings.sizes import GIGABYTE, readable_bytes

__all__ = ["TooLargeError", "unpack", "unpack_file"]

_PIECE_BYTES = 1024 * 1024


class TooLargeError(Exception):
    """Something unpacks to more bytes than it may."""


def unpack(packed: bytes, compression: str, most_bytes: int) -> bytes:
    """Return bytes unpacked.

    Args:
        packed: the bytes.
        compression: `none` or empty, `lz4`, `bz2`, `zstd`.
        most_bytes: how many they may unpack to; more are never made.

    Raises:
        TooLargeError: there would be more.
        DamageError: the compression is not known.
    """
    if compression in {"", "none"}:
        unpacked = packed
    elif compression in _UNPACKERS:
        unpacked = _UNPACKERS[compression](packed, most_bytes)
    else:
        raise DamageError(f"its compression '{compression}' is not supported")
    if len(unpacked) > most_bytes:
        raise TooLargeError
    return unpacked


def _unpack_bz2(packed: bytes, most_bytes: int) -> bytes:
    unpacker = bz2.BZ2Decompressor()
    unpacked = unpacker.decompress(packed, most_bytes + 1)
    while unpacker.unused_data and len(unpacked) <= most_bytes:  # streams may follow each other
        packed, unpacker = unpacker.unused_data, bz2.BZ2Decompressor()
        unpacked += unpacker.decompress(packed, most_bytes + 1 - len(unpacked))
    if not unpacker.eof and len(unpacked) <= most_bytes:
        raise DamageError("a compressed chunk is cut off")
    return unpacked


def _unpack_lz4(packed: bytes, most_bytes: int) -> bytes:
    unpacker = lz4.frame.LZ4FrameDecompressor()
    unpacked: bytes = unpacker.decompress(packed, max_length=most_bytes + 1)
    if not unpacker.eof and len(unpacked) <= most_bytes:
        raise DamageError("a compressed chunk is cut off")
    return unpacked


def _unpack_zstd(packed: bytes, most_bytes: int) -> bytes:
    announced = zstandard.frame_content_size(packed)
    if announced > most_bytes:
        raise TooLargeError
    # Without an announced size the unpacker makes room for as much as it may return.
    unpacker = zstandard.ZstdDecompressor()
    if announced >= 0:
        return unpacker.decompress(packed)
    pieces, size = [], 0
    for piece in unpacker.read_to_iter(packed):
        size += len(piece)
        if size > most_bytes:
            raise TooLargeError
        pieces.append(piece)
    return b"".join(pieces)


_UNPACKERS: dict[str, Callable[[bytes, int], bytes]] = {
    "bz2": _unpack_bz2,
    "lz4": _unpack_lz4,
    "zstd": _unpack_zstd,
}


def unpack_file(source: Path, target: Path, ratio: int) -> None:
    """Write a zstd-compressed file unpacked to another place.

    Raises:
        SizeLimitError: it unpacks to more than a gigabyte and `ratio` times its size.
    """
    most_bytes = max(GIGABYTE, ratio * source.stat().st_size)
    written = 0
    with (
        source.open("rb") as packed,
        zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as unpacked,
        target.open("wb") as out,
    ):
        while piece := unpacked.read(_PIECE_BYTES):
            written += len(piece)
            if written > most_bytes:
                raise SizeLimitError(
                    f"{source}: it unpacks to more than {readable_bytes(most_bytes)}; if you trust it, raise "
                    "limits.compression_ratio in the recipe."
                )
            out.write(piece)
