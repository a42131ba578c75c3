"""Rows and files that exist once per dataset: category, attribute, visibility, sensor, map."""

import struct
import zlib
from collections.abc import Callable, Iterable, Sequence
from collections.abc import Set as AbstractSet

from bagassets.base.json_types import JsonObject
from bagassets.formats.nuscenes.settings import NamedText
from bagassets.formats.nuscenes.tokens import (
    VISIBILITY_LEVELS,
    sensor_token,
    token,
    visibility_token,
)

__all__ = [
    "MAP_FILE",
    "blank_png",
    "map_rows",
    "named_rows",
    "sensor_rows",
    "visibility_rows",
]

MAP_FILE = "maps/blank.png"


def named_rows(
    token_of: Callable[[str], str], named: Sequence[NamedText], recorded: AbstractSet[str]
) -> list[JsonObject]:
    """Return the categories or attributes of the recipe, in its order, then others recorded in recordings, by name."""
    texts = {entry.name: entry.description for entry in named}
    names = [*texts, *sorted(recorded - texts.keys())]
    return [{"token": token_of(name), "name": name, "description": texts.get(name, "")} for name in names]


def visibility_rows() -> list[JsonObject]:
    """Return the four levels of visibility."""
    return [
        {
            "token": visibility_token(level),
            "level": level,
            "description": f"{level.removeprefix('v')} % of the object can be seen",
        }
        for level in VISIBILITY_LEVELS
    ]


def sensor_rows(sensors: Iterable[tuple[str, str]]) -> list[JsonObject]:
    """Return a row for each pair of channel and modality."""
    return [
        {"token": sensor_token(channel, modality), "channel": channel, "modality": modality}
        for channel, modality in sorted(set(sensors))
    ]


def map_rows(log_tokens: Iterable[str]) -> list[JsonObject]:
    """Return the one map; it holds for all logs, as the devkit asks for."""
    return [
        {
            "token": token("map", MAP_FILE),
            "log_tokens": sorted(log_tokens),
            "category": "semantic_prior",
            "filename": MAP_FILE,
        }
    ]


def blank_png(width: int, height: int) -> bytes:
    """Return an 8-bit grey PNG of zeros: the mask of the one map, which shows nothing.

    Its data is stored, not deflated, because the output of compressors differs between versions of zlib.
    """
    rows = bytes((width + 1) * height)  # a filter byte leads each row
    blocks = [rows[start : start + 0xFFFF] for start in range(0, len(rows), 0xFFFF)]
    stored = b"".join(
        struct.pack("<BHH", number == len(blocks), len(block), len(block) ^ 0xFFFF) + block
        for number, block in enumerate(blocks, start=1)
    )
    data = b"\x78\x01" + stored + struct.pack(">I", zlib.adler32(rows))
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + _png_chunk(b"IHDR", header)
        + _png_chunk(b"IDAT", data)
        + _png_chunk(b"IEND", b"")
    )


def _png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
