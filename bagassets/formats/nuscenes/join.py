"""The version folder of a dataset: tables joined from recordings, those that exist once (category, attribute, visibility, sensor, map), splits."""

import json
import struct
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path

from bagassets.base.json_types import JsonObject
from bagassets.engine.splits import SplitShare
from bagassets.formats.format import Joined, Member
from bagassets.formats.json_files import json_bytes, rows_text, write_hashed, write_joined
from bagassets.formats.nuscenes.schema import RECORDING_TABLES, SPLITS, TABLES, devkit_split_name
from bagassets.formats.nuscenes.settings import NamedText, NuScenes
from bagassets.formats.nuscenes.table_file import table_bytes
from bagassets.formats.nuscenes.tokens import (
    VISIBILITY_LEVELS,
    attribute_token,
    category_token,
    sensor_token,
    token,
    visibility_token,
)

MAP_FILE, MAP_SIZE_PX = "maps/blank.png", 64


def join(members: Sequence[Member], settings: NuScenes, shares: Sequence[SplitShare], out: Path) -> Joined:
    """Write all 13 tables and `splits.json` into an empty folder.

    Memory grows only with the scenes and logs of the recordings, not with their other rows. Without recordings the tables
    are empty, and the devkit loads them.

    Args:
        members: recordings in the order of their keys.
        settings: the recipe's `nuscenes`.
        shares: shares of the splits, in order of their names.
        out: the folder.
    """
    rows: dict[str, int] = {}
    folders = [str(member.artifact.files) for member in members]
    digests: dict[str, str] = {}
    kept: dict[str, list[bytes]] = {"scene": [], "log": []}
    for table in RECORDING_TABLES:
        texts: Iterable[bytes] = (rows_text(f"{folder}/{table}.json") for folder in folders)
        if table in kept:
            texts = kept[table] = list(texts)
        rows[table], digests[f"{table}.json"] = write_joined(out / f"{table}.json", texts)
    logs = [row["token"] for text in kept["log"] for row in _parsed(text)]
    for table, shared in _shared(members, logs, settings).items():
        rows[table] = len(shared)
        digests[f"{table}.json"] = write_hashed(out / f"{table}.json", table_bytes(table, shared))
    splits: dict[str, list[str]] = {devkit_split_name(share.name): [] for share in shares}
    for member, text in zip(members, kept["scene"], strict=True):
        splits[devkit_split_name(member.split)] += [row["name"] for row in _parsed(text)]
    digests[SPLITS] = write_hashed(out / SPLITS, json_bytes(splits))
    facts = {
        "version": settings.version,
        "scenes": rows["scene"],
        "keyframes": rows["sample"],
        "boxes": rows["sample_annotation"],
        "rows": {name: rows[name] for name in TABLES},
    }
    picture = {MAP_FILE: blank_png(MAP_SIZE_PX, MAP_SIZE_PX)}
    return Joined(dict(sorted(digests.items())), facts, picture)


def _parsed(text: bytes) -> list[JsonObject]:
    """Return the rows in a `rows_text`."""
    rows: list[JsonObject] = json.loads(b"[%b]" % text)
    return rows


def _shared(
    members: Sequence[Member], logs: Sequence[str], settings: NuScenes
) -> Mapping[str, list[JsonObject]]:
    facts = [member.facts for member in members]
    categories = {name for fact in facts for name in fact["categories"]}
    attributes = {name for fact in facts for name in fact["attributes"]}
    sensors = {pair for fact in facts for pair in fact["channels"].items()}
    return {
        "category": _named_rows(category_token, settings.categories, categories),
        "attribute": _named_rows(attribute_token, settings.attributes, attributes),
        "visibility": [
            {
                "token": visibility_token(level),
                "level": level,
                "description": f"{level.removeprefix('v')} % of the object can be seen",
            }
            for level in VISIBILITY_LEVELS
        ],
        "sensor": [
            {"token": sensor_token(channel, modality), "channel": channel, "modality": modality}
            for channel, modality in sorted(sensors)
        ],
        # One, which holds for all logs, as the devkit asks for.
        "map": [
            {
                "token": token("map", MAP_FILE),
                "log_tokens": sorted(logs),
                "category": "semantic_prior",
                "filename": MAP_FILE,
            }
        ],
    }


def _named_rows(
    token_of: Callable[[str], str], named: Sequence[NamedText], recorded: AbstractSet[str]
) -> list[JsonObject]:
    """Return the categories or attributes of the recipe, in its order, then others recorded in recordings, by name."""
    texts = {entry.name: entry.description for entry in named}
    names = [*texts, *sorted(recorded - texts.keys())]
    return [{"token": token_of(name), "name": name, "description": texts.get(name, "")} for name in names]


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
