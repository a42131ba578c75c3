"""Facts about each scene of a recording, by which named datasets select scenes."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import sqrt

import numpy as np

from bagassets.formats.nuscenes.tokens import category_token
from bagassets.geometry.sun import daylight
from bagassets.geometry.trajectory import Trajectory
from bagassets.json_types import JsonMapping, JsonObject

__all__ = ["TrackPoint", "scene_facts"]

TrackPoint = tuple[int, float, float]


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
