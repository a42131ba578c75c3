"""The nuScenes format.

Tables are in the version folder, which is swapped as a whole; files of recordings are in `samples` and `sweeps`, which all
versions in the dataroot share.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

from bagassets.assets.quality.scene_rules import enough_s, too_short_s
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.formats.format import Entry, Format, Link, LooseFiles, Samples
from bagassets.formats.json_files import column_texts, row_blocks
from bagassets.formats.nuscenes.dataset_checks import CHECKS, check
from bagassets.formats.nuscenes.join import JOIN
from bagassets.formats.nuscenes.schema import NAME
from bagassets.formats.nuscenes.selection import select
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.formats.nuscenes.tables import FILES, NUSCENES_TABLES
from bagassets.formats.nuscenes.tokens import recording_of
from bagassets.recipe.load import where_in
from bagassets.recipe.model import Recipe
from bagassets.store.artifact import Artifact
from bagassets.store.canonical import digest_json


def _why_no_scenes(recordings: Sequence[JsonMapping], recipe: Recipe, recipe_file: Path) -> str:
    """Return why recordings, given by the facts of their tables, have no scene, and what to set where so that they have one."""
    lengths_s = [too_short_s(facts) for facts in recordings]
    short_s = sorted(length_s for length_s in lengths_s if length_s is not None)
    if not short_s:
        return "`bagassets check` says why"
    number = "all" if len(short_s) == len(recordings) else f"{len(short_s)}"
    others = "" if number == "all" else "; `bagassets check` says why the others have none"
    range_s = " to ".join(dict.fromkeys(f"{length_s:g}" for length_s in (short_s[0], short_s[-1])))
    least_s = f"{enough_s(short_s[0]):g}"
    if "scenes" in recipe.model_fields_set:
        way_out = f"set it to {least_s} ({where_in(recipe_file, ('scenes', 'min_length_s'))})"
    else:
        way_out = f"add `scenes: {{min_length_s: {least_s}}}` to {recipe_file}"
    limit = f"scenes.min_length_s ({recipe.scenes.min_length_s:g})"
    return f"{number}, of {range_s} s, are shorter than {limit}; to have a scene of each, {way_out}{others}"


def _links(entry: Entry) -> Iterator[Link]:
    for file in entry.artifact.read_json(FILES):
        yield Link(file["filename"], file["artifact"], file["file"])


def _named_in(folder: Path) -> Iterator[str]:
    """Yield the names of the files in the tables of a version folder.

    Each row is a line and file names need no escapes, so nothing is parsed: a dataset may have millions of rows.
    """
    path = folder / "sample_data.json"
    for rows in row_blocks(path) if path.is_file() else ():
        yield from column_texts(rows, "filename")


def _samples(tables: Artifact) -> Samples:
    """Return scene -> sample token -> part of the sample -> digest."""

    def rows(table: str) -> list[JsonObject]:
        found: list[JsonObject] = tables.read_json(f"{table}.json")
        return found

    poses = {row.pop("token"): row for row in rows("ego_pose")}  # what it is called changes nothing
    calibrations = {row["token"]: row for row in rows("calibrated_sensor")}
    parts: dict[str, dict[str, list[object]]] = defaultdict(lambda: defaultdict(list))
    for row in rows("sample_data"):
        sample = parts[row["sample_token"]]
        sample["readings"].append([row["filename"], row["timestamp"], row["is_key_frame"]])
        sample["poses"].append(poses[row["ego_pose_token"]])
        sample["calibration"].append(calibrations[row["calibrated_sensor_token"]])
    for row in rows("sample_annotation"):
        parts[row["sample_token"]]["boxes"].append(row)
    scenes = {row["token"]: row["name"] for row in rows("scene")}
    samples: dict[str, dict[str, dict[str, str]]] = {name: {} for name in scenes.values()}
    names = ("boxes", "calibration", "poses", "readings")
    for row in rows("sample"):
        sample = parts[row["token"]]
        samples[scenes[row["scene_token"]]][row["token"]] = {
            name: digest_json(sample[name]) for name in names
        }
    return samples


NUSCENES = Format(
    name=NAME,
    version=3,
    description="""The nuScenes dataset of all recordings, which the nuscenes-devkit loads.

Samples, sweeps and maps are links to artifacts. The tables are swapped at once, so that readers never see half a
dataset. `dataset.lock.json` names every recording and artifact, and the recordings that were skipped or failed.""",
    kinds=frozenset({"nuscenes"}),  # with another one, the Catalog shortens the name of the asset
    settings=NuScenes,
    part=NUSCENES_TABLES.name,
    assets=(NUSCENES_TABLES,),
    join=JOIN,
    links=_links,
    counts=lambda facts: {what: facts["counts"][what] for what in ("scenes", "samples")},
    row=lambda facts: {"rig": facts["rig"]},
    duration_s=lambda facts: float(facts["counts"]["duration_s"]),
    folder=lambda settings: settings.version,
    fills_split=lambda facts: bool(facts["counts"]["scenes"]),
    why_empty=_why_no_scenes,
    named_by=("output", "version"),
    places=LooseFiles(_named_in, recording_of),
    folders=("samples", "sweeps", "maps"),
    samples=_samples,
    select=select,
    checks=CHECKS,
    check=check,
)
