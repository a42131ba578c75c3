"""Named datasets: which scenes each takes, and which condition another one does not meet.

The steps `scene_facts` and `scene_subset`, from which they are made, belong to no asset. Facts about scenes are stored
because every named dataset selects by them; tables of some of a recording's scenes are stored because datasets link and
lock artifacts.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from fnmatch import fnmatchcase
from functools import partial
from itertools import pairwise
from math import sqrt

import numpy as np

from bagassets.assets.ego_poses import EGO_POSES, load_trajectory
from bagassets.assets.track import TRACK
from bagassets.base.alike import names_text
from bagassets.base.errors import RecipeError, StoreError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.engine.plan import Plan
from bagassets.engine.run_action import run_action
from bagassets.engine.track import track_on_record
from bagassets.formats.format import FACTS, Part, Selection
from bagassets.formats.nuscenes.schema import RECORDING_TABLES
from bagassets.formats.nuscenes.subset import subset_facts, subset_tables
from bagassets.formats.nuscenes.table_file import table_bytes
from bagassets.formats.nuscenes.tables import NUSCENES_TABLES
from bagassets.formats.nuscenes.tokens import category_token
from bagassets.geometry.sun import daylight
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_datasets import NamedDataset, moment_ns
from bagassets.store.action import Step
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.store import Store

FACTS_STEP = Step("scene_facts", 2)
SUBSET_STEP = Step("scene_subset", 1)

_SCENES = "scenes.json"

TrackPoint = tuple[int, float, float]


def select(
    recipe: Recipe, store: Store, plan: Plan, parts: Sequence[Part], wanted: NamedDataset
) -> Selection:
    """Select the recordings and scenes of a named dataset.

    Args:
        recipe: the recipe.
        store: has the artifacts; missing facts and subsets of scenes are added to it.
        plan: states of all recordings.
        parts: the recordings of the whole dataset.
        wanted: the dataset.

    Raises:
        RecipeError: it names scenes that are no more.
    """
    chosen = []
    left_out: Counter[str] = Counter()
    skipped = {}
    for part in parts:
        tables = store.artifact(part.artifact)
        facts = _scene_facts(recipe, store, plan, part, tables)
        former = plan.ties.former.get(part.key, ())
        require_own_scenes(wanted, part.key, facts["scenes"], former)
        unmet = [unmet_condition(wanted, facts["rig"], part.key, scene, former) for scene in facts["scenes"]]
        kept = [scene for scene, why in zip(facts["scenes"], unmet, strict=True) if why is None]
        reasons = Counter(why for why in unmet if why is not None)
        left_out += reasons
        if not kept:
            skipped[part.key] = "no scene belongs to it: " + (
                "; ".join(f"{count} {why}" for why, count in sorted(reasons.items())) or "it has none"
            )
        elif len(kept) == len(facts["scenes"]):
            chosen.append(part)
        else:
            tokens = sorted(scene["token"] for scene in kept)
            action = SUBSET_STEP.action({"scenes": tokens}, {NUSCENES_TABLES.name: tables.digest})
            outcome = run_action(store, action, partial(_make_subset, tables, kept))
            chosen.append(Part(part.key, part.content, outcome.artifact.digest))
    return Selection(chosen, skipped, dict(sorted(left_out.items())))


def _scene_facts(recipe: Recipe, store: Store, plan: Plan, part: Part, tables: Artifact) -> JsonObject:
    """Return the facts about the scenes of one recording, from the store if they are there."""
    bag = plan.bags[part.key]
    poses, track = bag.current_artifact(store, EGO_POSES.name), track_on_record(recipe, store, bag)
    if poses is None or track is None:
        raise StoreError(
            f"{part.key}: the inventory or ego_poses, by which named datasets select scenes, are not in the store; "
            "run `bagassets build`."
        )
    inputs = {NUSCENES_TABLES.name: tables.digest, EGO_POSES.name: poses.digest, TRACK.name: track.digest}
    make = partial(_make_facts, tables, load_trajectory(poses), track.points)
    facts: JsonObject = run_action(store, FACTS_STEP.action({}, inputs), make).artifact.read_json(_SCENES)
    return facts


def _make_facts(
    tables: Artifact, trajectory: Trajectory, track: Sequence[TrackPoint], out: ArtifactWriter
) -> JsonObject:
    """Write `scenes.json`; return the summary."""
    names = ("scene", "sample", "instance", "sample_annotation")
    facts = tables.read_json(FACTS)
    scenes = scene_facts({name: tables.read_json(f"{name}.json") for name in names}, facts, trajectory, track)
    out.write_json(_SCENES, {"rig": facts["rig"], "key": facts["key"], "scenes": scenes}, indent=None)
    return {"scenes": len(scenes)}


def scene_facts(
    tables: Mapping[str, Sequence[JsonMapping]],
    facts: JsonMapping,
    trajectory: Trajectory,
    track: Sequence[TrackPoint],
) -> list[JsonObject]:
    """Return a mapping for each scene, in order.

    Args:
        tables: scene, sample, instance and sample_annotation of one recording.
        facts: its `facts.json`.
        trajectory: `global_SE3_ego`.
        track: stamp, latitude and longitude about once a second, in order; empty if unknown.
    """
    names = {category_token(name): name for name in facts["categories"]}
    category_of = {row["token"]: names[row["category_token"]] for row in tables["instance"]}
    stamps_us: dict[str, list[int]] = {}
    scene_of = {}
    for row in tables["sample"]:
        stamps_us.setdefault(row["scene_token"], []).append(row["timestamp"])
        scene_of[row["token"]] = row["scene_token"]
    boxes: dict[str, Counter[str]] = {}
    for row in tables["sample_annotation"]:
        counter = boxes.setdefault(scene_of[row["sample_token"]], Counter())
        counter[category_of[row["instance_token"]]] += 1
    found = []
    for scene in tables["scene"]:
        stamps_ns = [1000 * stamp for stamp in sorted(stamps_us[scene["token"]])]
        length_m, duration_s = _driven_m(trajectory, stamps_ns), (stamps_ns[-1] - stamps_ns[0]) / 1e9
        points = _points(track, stamps_ns[0], stamps_ns[-1])
        found.append(
            {
                "token": scene["token"],
                "name": scene["name"],
                "start_ns": stamps_ns[0],
                "end_ns": stamps_ns[-1],
                "samples": len(stamps_ns),
                "length_m": round(length_m, 3),
                "speed_mps": round(length_m / duration_s, 3) if duration_s > 0 else 0.0,
                "boxes": dict(sorted(boxes.get(scene["token"], Counter()).items())),
                "points": [[lat, lon] for _, lat, lon in points],
                "daylight": daylight(points[0][1], points[0][2], stamps_ns[0]) if points else None,
            }
        )
    return found


def _driven_m(trajectory: Trajectory, stamps_ns: Sequence[int]) -> float:
    """Return the metres driven, measured from keyframe to keyframe."""
    positions, _, valid = trajectory.at(np.array(stamps_ns, dtype=np.int64))
    steps = pairwise(position.tolist() for position in positions[valid])
    return sum(sqrt(sum((b - a) ** 2 for a, b in zip(one, other, strict=True))) for one, other in steps)


def _points(track: Sequence[TrackPoint], start_ns: int, end_ns: int) -> list[TrackPoint]:
    """Return the points during a scene; without any, the point nearest in time."""
    inside = [point for point in track if start_ns <= point[0] <= end_ns]
    if inside or not track:
        return inside
    return [min(track, key=lambda point: abs(point[0] - start_ns))]


def _make_subset(tables: Artifact, scenes: Collection[JsonMapping], out: ArtifactWriter) -> JsonObject:
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
    facts = subset_facts(tables.read_json(FACTS), kept, duration_s, tables.digest)
    out.write_json(FACTS, facts)
    return facts


Point = Sequence[float]


def unmet_condition(
    wanted: NamedDataset, rig: str, key: str, scene: JsonMapping, former: Sequence[str] = ()
) -> str | None:
    """Return a clause about the first condition that a scene does not meet; None if it belongs to the dataset.

    Args:
        wanted: the dataset.
        rig: name of the rig that made the recording.
        key: partition key of the recording.
        scene: facts about the scene.
        former: keys that the parts of a series had alone.
    """
    if wanted.rigs and rig not in wanted.rigs:
        return f"made by rig {rig}"
    if wanted.recordings and not any(_matches(one, wanted.recordings) for one in (key, *former)):
        return "not one of the recordings"
    if wanted.scenes and not _matches(scene["name"], wanted.scenes):
        return "not one of the scenes"
    if wanted.since is not None and scene["start_ns"] < moment_ns(wanted.since):
        return f"begins before {wanted.since}"
    if wanted.until is not None and scene["start_ns"] >= moment_ns(wanted.until):
        return f"does not begin before {wanted.until}"
    if wanted.place:
        if not scene["points"]:
            return "its place is not known"
        if not any(inside(point, wanted.place) for point in scene["points"]):
            return "elsewhere"
    if wanted.daylight and scene["daylight"] not in wanted.daylight:
        return scene["daylight"] or "its daylight is not known"
    missing = [
        label for label in wanted.labels if not any(fnmatchcase(name, label) for name in scene["boxes"])
    ]
    if missing:
        return f"no {missing[0]}"
    if wanted.min_speed_mps is not None and scene["speed_mps"] < wanted.min_speed_mps:
        return f"slower than {wanted.min_speed_mps:g} m/s"
    return None


def require_own_scenes(
    wanted: NamedDataset, key: str, scenes: Sequence[JsonMapping], former: Sequence[str]
) -> None:
    """Refuse a dataset that names scenes of the parts of a drive, which has other scenes now that it is one recording.

    Args:
        wanted: the dataset.
        key: partition key of the recording.
        scenes: facts about its scenes.
        former: keys that the parts of a series had alone.

    Raises:
        RecipeError: it does.
    """
    names = [str(scene["name"]) for scene in scenes]
    for glob in wanted.scenes if names else ():
        of_part = any(fnmatchcase(f"{part}_000", glob) or glob.rpartition("_")[0] == part for part in former)
        if of_part and not any(fnmatchcase(name, glob) for name in names):
            raise RecipeError(
                f"dataset {wanted.name}: {glob} names scenes of a part of {key}, which is one recording now, with "
                f"{names_text(names)}; name some of these, or {key} in `recordings`."
            )


def inside(point: Point, polygon: Sequence[Point]) -> bool:
    """Tell whether a point lies in a polygon, by the parity of the edges on one side of the point.

    Args:
        point: latitude, longitude.
        polygon: its corners in order, the first not repeated; it may be concave, but not cross the 180th meridian.
    """
    lat, lon = point
    odd = False
    for (lat_a, lon_a), (lat_b, lon_b) in zip(polygon, [*polygon[1:], polygon[0]], strict=True):
        if (lat_a > lat) != (lat_b > lat) and lon < lon_a + (lat - lat_a) * (lon_b - lon_a) / (lat_b - lat_a):
            odd = not odd
    return odd


def _matches(name: str, globs: Sequence[str]) -> bool:
    return any(fnmatchcase(name, glob) for glob in globs)
