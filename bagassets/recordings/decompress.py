"""Decompressing parts of recordings, never to more bytes than a bound set beforehand."""

import bz2
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import zstandard

from bagassets.recordings.damage import DamageError
from bagassets.recordings.model import OnRead
from bagassets.recordings.sizes import Sizes

_PIECE_BYTES = 1024 * 1024
_STREAM_BYTES = 4096
_ZLIB_OR_GZIP = zlib.MAX_WBITS + 32


class TooLargeError(Exception):
    """Compressed data exceeds its bound when decompressed."""


def decompress(packed: bytes, compression: str, most_bytes: int) -> bytes:
    """Return decompressed bytes.

    Args:
        packed: the compressed bytes.
        compression: `none` or empty, `lz4`, `bz2`, `zstd`.
        most_bytes: how many bytes they may decompress to; no more are ever produced.

    Raises:
        TooLargeError: they decompress to more.
        DamageError: the compression is unknown, or the data is cut off.
    """
    if compression in {"", "none"}:
        unpacked = packed
    elif compression in _DECOMPRESSORS:
        unpacked = _DECOMPRESSORS[compression](packed, most_bytes)
    else:
        raise DamageError(f"its compression '{compression}' is not supported")
    if len(unpacked) > most_bytes:
        raise TooLargeError
    return unpacked


def decompress_zlib(packed: bytes, most_bytes: int) -> bytes:
    """Return what zlib has compressed, with its own head or that of gzip; it is in messages, and never a recording's own.

    Raises:
        TooLargeError: as `decompress`.
        DamageError: the data is cut off.
        zlib.error: it is damaged.
    """
    decompressor = zlib.decompressobj(_ZLIB_OR_GZIP)
    unpacked = decompressor.decompress(packed, most_bytes + 1)
    if len(unpacked) > most_bytes:
        raise TooLargeError
    if not decompressor.eof:
        raise DamageError("the data is cut off")
    return unpacked


def _decompress_bz2(packed: bytes, most_bytes: int) -> bytes:
    """Decompress streams that follow one another; what is left behind each is copied, so it is given in small pieces."""
    view, at, decompressor = memoryview(packed), 0, bz2.BZ2Decompressor()
    pieces, left = [], most_bytes + 1
    while left and (at < len(view) or not (decompressor.eof or decompressor.needs_input)):
        if decompressor.eof:
            decompressor = bz2.BZ2Decompressor()
        given = view[at : at + _STREAM_BYTES] if decompressor.needs_input else b""
        pieces.append(decompressor.decompress(given, left))
        at += len(given) - len(decompressor.unused_data)
        left -= len(pieces[-1])
    if left and not decompressor.eof:
        raise DamageError("a compressed chunk is cut off")
    return b"".join(pieces)


def _decompress_lz4(packed: bytes, most_bytes: int) -> bytes:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    unpacked: bytes = decompressor.decompress(packed, max_length=most_bytes + 1)
    if not decompressor.eof and len(unpacked) <= most_bytes:
        raise DamageError("a compressed chunk is cut off")
    return unpacked


def _decompress_zstd(packed: bytes, most_bytes: int) -> bytes:
    announced = zstandard.frame_content_size(packed)
    if announced > most_bytes:
        raise TooLargeError
    # Without an announced size the decompressor allocates the largest size it may return.
    decompressor = zstandard.ZstdDecompressor()
    if announced >= 0:
        return decompressor.decompress(packed)
    pieces, size = [], 0
    for piece in decompressor.read_to_iter(packed):
        size += len(piece)
        if size > most_bytes:
            raise TooLargeError
        pieces.append(piece)
    return b"".join(pieces)


_DECOMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    "bz2": _decompress_bz2,
    "lz4": _decompress_lz4,
    "zstd": _decompress_zstd,
}


def decompress_file(source: Path, target: Path, sizes: Sizes, on_read: OnRead | None = None) -> None:
    """Decompress a zstd file into another one.

    Raises:
        SizeLimitError: the recording decompresses to more than `sizes` allow.
    """
    with (
        source.open("rb") as packed,
        zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as unpacked,
        target.open("wb") as out,
    ):
        while piece := unpacked.read(_PIECE_BYTES):
            sizes.add(len(piece))
            out.write(piece)
            if on_read is not None:
                on_read(source, packed.tell(), b"")
