"""The version folder of a dataset: tables joined from recordings, shared tables, splits."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from bagassets.base.json_types import JsonObject
from bagassets.engine.splits import SplitShare
from bagassets.formats.format import Joined, Member
from bagassets.formats.json_files import json_bytes, rows_text, write_hashed, write_joined
from bagassets.formats.nuscenes import shared_rows
from bagassets.formats.nuscenes.schema import RECORDING_TABLES, SPLITS, TABLES, devkit_split_name
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.formats.nuscenes.table_file import table_bytes
from bagassets.formats.nuscenes.tokens import attribute_token, category_token

__all__ = ["join"]

MAP_SIZE_PX = 64


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
    picture = {shared_rows.MAP_FILE: shared_rows.blank_png(MAP_SIZE_PX, MAP_SIZE_PX)}
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
        "category": shared_rows.named_rows(category_token, settings.categories, categories),
        "attribute": shared_rows.named_rows(attribute_token, settings.attributes, attributes),
        "visibility": shared_rows.visibility_rows(),
        "sensor": shared_rows.sensor_rows(sensors),
        "map": shared_rows.map_rows(logs),
    }
