"""Tables of some scenes of a recording: a subset of its rows, with the same tokens."""

from collections.abc import Callable, Collection, Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import TypeVar

from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.formats.nuscenes.tokens import attribute_token, category_token

Rows = Sequence[JsonMapping]
_R = TypeVar("_R", bound=JsonMapping)


def subset_tables(tables: Mapping[str, Rows], scenes: Collection[str]) -> dict[str, list[JsonMapping]]:
    """Return the rows of some scenes.

    Chains of samples, readings and boxes end with their scene, so no row has to be rewritten.

    Args:
        tables: all tables of one recording.
        scenes: tokens of the scenes to keep.
    """

    def read(table: str, column: str, wanted: AbstractSet[str]) -> list[JsonMapping]:
        return [row for row in tables[table] if row[column] in wanted]

    kept = rows_of_scenes(read("scene", "token", frozenset(scenes)), read)
    return kept | {"log": read("log", "token", {row["log_token"] for row in kept["scene"]})}


def rows_of_scenes(
    scenes: list[_R], read: Callable[[str, str, AbstractSet[str]], list[_R]]
) -> dict[str, list[_R]]:
    """Return the rows of all tables of recordings but `log` that belong to some scenes.

    Args:
        scenes: rows of the scenes.
        read: table, column and values -> rows with one of these values in that column.
    """
    kept = {"scene": scenes, "sample": read("sample", "scene_token", {row["token"] for row in scenes})}
    samples = {row["token"] for row in kept["sample"]}
    for table in ("sample_data", "sample_annotation"):
        kept[table] = read(table, "sample_token", samples)
    for table, owner in (
        ("ego_pose", "sample_data"),
        ("calibrated_sensor", "sample_data"),
        ("instance", "sample_annotation"),
    ):
        kept[table] = read(table, "token", {row[f"{table}_token"] for row in kept[owner]})
    return kept


def subset_facts(
    facts: JsonMapping, tables: Mapping[str, Rows], duration_s: float, of_recording: str
) -> JsonObject:
    """Return `facts.json` of a subset.

    Args:
        facts: of the whole recording.
        tables: of the subset.
        duration_s: total duration of its scenes.
        of_recording: digest of the recording's whole tables.
    """
    categories = {row["category_token"] for row in tables["instance"]}
    attributes = {token for row in tables["sample_annotation"] for token in row["attribute_tokens"]}
    return {
        **{name: facts[name] for name in ("rig", "key", "reference", "channels")},
        "categories": [name for name in facts["categories"] if category_token(name) in categories],
        "attributes": [name for name in facts["attributes"] if attribute_token(name) in attributes],
        "counts": {
            "scenes": len(tables["scene"]),
            "samples": len(tables["sample"]),
            "duration_s": round(duration_s, 3),
        },
        "of": of_recording,
    }
