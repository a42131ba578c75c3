"""The steps `scene_facts` and `scene_subset`, from which named datasets are made.

They belong to no asset. Facts about scenes are stored because every named dataset selects by them; tables of some of a
recording's scenes are stored because datasets link and lock artifacts.
"""

from collections.abc import Collection, Sequence

from bagassets.formats.nuscenes.scene_facts import TrackPoint, scene_facts
from bagassets.formats.nuscenes.schema import RECORDING_TABLES
from bagassets.formats.nuscenes.subset import subset_facts, subset_tables
from bagassets.formats.nuscenes.table_file import table_bytes
from bagassets.geometry.trajectory import Trajectory
from bagassets.json_types import JsonMapping, JsonObject
from bagassets.store.action import Action, Step
from bagassets.store.artifact import Artifact, ArtifactWriter

__all__ = [
    "FACTS_STEP",
    "SCENES",
    "SUBSET_STEP",
    "facts_action",
    "make_facts",
    "make_subset",
    "subset_action",
]

FACTS_STEP = Step("scene_facts", 2)
SUBSET_STEP = Step("scene_subset", 1)

SCENES = "scenes.json"


def facts_action(tables: Artifact, ego_poses: Artifact, track: str) -> Action:
    """Return the action that gathers facts about scenes; `track` is the digest of the recording's track."""
    inputs = {"nuscenes_tables": tables.digest, "ego_poses": ego_poses.digest, "track": track}
    return FACTS_STEP.action({}, inputs)


def make_facts(
    tables: Artifact, trajectory: Trajectory, track: Sequence[TrackPoint], out: ArtifactWriter
) -> JsonObject:
    """Write `scenes.json`; return the summary."""
    rows = {
        name: tables.read_json(f"{name}.json")
        for name in ("scene", "sample", "instance", "sample_annotation")
    }
    facts = tables.read_json("facts.json")
    scenes = scene_facts(rows, facts, trajectory, track)
    out.write_json(SCENES, {"rig": facts["rig"], "key": facts["key"], "scenes": scenes}, indent=None)
    return {"scenes": len(scenes)}


def subset_action(tables: Artifact, scenes: Collection[str]) -> Action:
    """Return the action that keeps only these scenes, given by their tokens."""
    return SUBSET_STEP.action({"scenes": sorted(scenes)}, {"nuscenes_tables": tables.digest})


def make_subset(tables: Artifact, scenes: Collection[JsonMapping], out: ArtifactWriter) -> JsonObject:
    """Write the tables of some scenes, given by their facts, laid out as in `nuscenes_tables`; return the summary."""
    rows = {name: tables.read_json(f"{name}.json") for name in RECORDING_TABLES}
    kept = subset_tables(rows, [scene["token"] for scene in scenes])
    for name in RECORDING_TABLES:
        out.write(f"{name}.json", table_bytes(name, kept[name]))
    named = {row["filename"] for row in kept["sample_data"]}
    out.write_json(
        "files.json", [file for file in tables.read_json("files.json") if file["filename"] in named]
    )
    duration_s = sum((scene["end_ns"] - scene["start_ns"]) / 1e9 for scene in scenes)
    facts = subset_facts(tables.read_json("facts.json"), kept, duration_s, tables.digest)
    out.write_json("facts.json", facts)
    return facts
