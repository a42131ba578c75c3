"""Decompressing as far as bytes are there, never beyond a bound."""

import bz2
from pathlib import Path

import lz4.frame
import zstandard

from bagassets.recordings.damage import DamageError
from bagassets.recordings.decompress import TooLargeError, decompress
from bagassets.recordings.model import OnRead
from bagassets.recordings.salvage.damage_map import CUT
from bagassets.recordings.sizes import Sizes

_PIECE_BYTES = 1024 * 1024
_INPUT_BYTES = 4096


def unpack_chunk(packed: bytes, compression: str, most_bytes: int, *, is_cut: bool) -> tuple[bytes, str]:
    """Return what a chunk holds, and what is wrong with it; "" if nothing is.

    Of a chunk that was cut, what comes before the cut is sound. One that contradicts itself holds nothing: which of its bytes
    are wrong cannot be told.

    Args:
        packed: its bytes, as many as there are.
        compression: `none` or empty, `lz4`, `bz2`, `zstd`.
        most_bytes: how many it may unpack to.
        is_cut: the file ends before the chunk does.
    """
    try:
        if not is_cut:
            return decompress(packed, compression, most_bytes), ""
        return _head(packed, compression, most_bytes), CUT
    except TooLargeError:
        return b"", "it holds more than it announces"
    except DamageError as err:
        return b"", str(err)
    except (OSError, RuntimeError, EOFError, ValueError, zstandard.ZstdError):
        return b"", "what it holds cannot be decompressed"


def _head(packed: bytes, compression: str, most_bytes: int) -> bytes:
    """Return what the first bytes of a chunk unpack to.

    Raises:
        Exception: of the decompressor, if they contradict themselves.
    """
    if compression in {"", "none"}:
        return packed[:most_bytes]
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=most_bytes))
    if compression == "bz2":
        return bz2.BZ2Decompressor().decompress(packed, most_bytes)
    if compression != "zstd":
        raise DamageError(f"its compression '{compression}' is not supported")
    with zstandard.ZstdDecompressor().stream_reader(packed) as reader:
        pieces, left = [], most_bytes
        while left and (piece := reader.read(min(left, _PIECE_BYTES))):
            pieces.append(piece)
            left -= len(piece)
    return b"".join(pieces)


def unpack_file(source: Path, target: Path, sizes: Sizes, on_read: OnRead | None = None) -> str:
    """Decompress a zstd file into another one as far as that goes; return what is wrong, "" if nothing is.

    Raises:
        SizeLimitError: the recording decompresses to more than `sizes` allow.
    """
    unpacked = 0
    with source.open("rb") as packed, target.open("wb") as out:
        try:
            announced = zstandard.frame_content_size(packed.read(18))
        except zstandard.ZstdError:
            return "it is not compressed by zstd"
        packed.seek(0)
        reader = zstandard.ZstdDecompressor().stream_reader(
            packed, read_size=_INPUT_BYTES, read_across_frames=True, closefd=False
        )
        try:
            while piece := reader.read1(_PIECE_BYTES):  # what it has at once, lest an error takes it along
                sizes.add(len(piece))
                unpacked += len(piece)
                out.write(piece)
                if on_read is not None:
                    on_read(source, packed.tell(), b"")
        except zstandard.ZstdError:
            return f"it cannot be decompressed beyond {unpacked} bytes"
    if announced > unpacked:
        return f"{CUT}: {unpacked} of {announced} bytes can be decompressed"
    return ""
