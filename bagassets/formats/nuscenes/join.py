"""The version folder of a dataset: tables joined from recordings, those that exist once (category, attribute, visibility, sensor, map), splits."""

import json
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet

from bagassets.base.json_types import JsonObject
from bagassets.engine.splits import SplitShare
from bagassets.formats.format import ByGroups, Facts, Finished, Member
from bagassets.formats.json_files import json_bytes, rows_text
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


def _files(settings: NuScenes, splits: Sequence[str]) -> list[str]:
    del settings, splits
    return [f"{table}.json" for table in RECORDING_TABLES]


def _rows(settings: NuScenes, file: str, member: Member) -> bytes:
    del settings
    return rows_text(f"{member.artifact.files}/{file}")


def _facts(members: Sequence[Member], settings: NuScenes) -> JsonObject:
    """Return what the tables that exist once, and `splits.json`, have of some recordings."""
    logs: list[str] = []
    scenes: dict[str, list[str]] = {}
    for member in members:
        logs += [row["token"] for row in _parsed(_rows(settings, "log.json", member))]
        names = [row["name"] for row in _parsed(_rows(settings, "scene.json", member))]
        scenes.setdefault(member.split, []).extend(names)
    facts = [member.facts for member in members]
    return {
        "categories": sorted({name for fact in facts for name in fact["categories"]}),
        "attributes": sorted({name for fact in facts for name in fact["attributes"]}),
        "channels": sorted({pair for fact in facts for pair in fact["channels"].items()}),
        "logs": logs,
        "scenes": scenes,
    }


def _finish(
    facts: Sequence[Facts], settings: NuScenes, shares: Sequence[SplitShare], rows: Mapping[str, int]
) -> Finished:
    """Return the tables that exist once, and `splits.json`. Without recordings the tables are empty, and the devkit loads them."""
    shared = _shared(facts, settings)
    numbers = {table: rows[f"{table}.json"] for table in RECORDING_TABLES}
    numbers |= {table: len(its) for table, its in shared.items()}
    splits = {
        devkit_split_name(share.name): [
            name for group in facts for name in group["scenes"].get(share.name, ())
        ]
        for share in shares
    }
    return Finished(
        {f"{table}.json": table_bytes(table, its) for table, its in shared.items()}
        | {SPLITS: json_bytes(splits)},
        {
            "version": settings.version,
            "scenes": numbers["scene"],
            "keyframes": numbers["sample"],
            "boxes": numbers["sample_annotation"],
            "rows": {name: numbers[name] for name in TABLES},
        },
        {MAP_FILE: blank_png(MAP_SIZE_PX, MAP_SIZE_PX)},
    )


def _parsed(text: bytes) -> list[JsonObject]:
    """Return the rows in a `rows_text`."""
    rows: list[JsonObject] = json.loads(b"[%b]" % text)
    return rows


def _shared(facts: Sequence[Facts], settings: NuScenes) -> Mapping[str, list[JsonObject]]:
    categories = {name for group in facts for name in group["categories"]}
    attributes = {name for group in facts for name in group["attributes"]}
    sensors = {(channel, modality) for group in facts for channel, modality in group["channels"]}
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
                "log_tokens": sorted(log for group in facts for log in group["logs"]),
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


JOIN = ByGroups(_files, _rows, _facts, _finish)
"""All 13 tables and `splits.json`."""
