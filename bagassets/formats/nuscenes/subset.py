"""Tables of some scenes of a recording: a subset of its rows, with the same tokens."""

from collections.abc import Collection, Mapping, Sequence

from bagassets.formats.nuscenes.tokens import attribute_token, category_token
from bagassets.json_types import JsonMapping, JsonObject

__all__ = ["subset_facts", "subset_tables"]

Rows = Sequence[JsonMapping]


def subset_tables(tables: Mapping[str, Rows], scenes: Collection[str]) -> dict[str, list[JsonMapping]]:
    """Return the rows of some scenes.

    Chains of samples, readings and boxes end with their scene, so no row has to be rewritten.

    Args:
        tables: all tables of one recording.
        scenes: tokens of the scenes to keep.
    """
    chosen = frozenset(scenes)
    kept: dict[str, list[JsonMapping]] = {}
    kept["scene"] = [row for row in tables["scene"] if row["token"] in chosen]
    kept["sample"] = [row for row in tables["sample"] if row["scene_token"] in chosen]
    samples = {row["token"] for row in kept["sample"]}
    for name in ("sample_data", "sample_annotation"):
        kept[name] = [row for row in tables[name] if row["sample_token"] in samples]
    used = {
        "log": {row["log_token"] for row in kept["scene"]},
        "ego_pose": {row["ego_pose_token"] for row in kept["sample_data"]},
        "calibrated_sensor": {row["calibrated_sensor_token"] for row in kept["sample_data"]},
        "instance": {row["instance_token"] for row in kept["sample_annotation"]},
    }
    for name, tokens in used.items():
        kept[name] = [row for row in tables[name] if row["token"] in tokens]
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
        "rig": facts["rig"],
        "key": facts["key"],
        "reference": facts["reference"],
        "channels": facts["channels"],
        "categories": [name for name in facts["categories"] if category_token(name) in categories],
        "attributes": [name for name in facts["attributes"] if attribute_token(name) in attributes],
        "counts": {
            "scenes": len(tables["scene"]),
            "samples": len(tables["sample"]),
            "duration_s": round(duration_s, 3),
        },
        "of": of_recording,
    }
