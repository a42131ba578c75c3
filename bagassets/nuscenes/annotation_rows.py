"""Rows about objects: instance and sample_annotation."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bagassets.annotations.table import BoxTable
from bagassets.annotations.tracks import Track, tracks_of
from bagassets.nuscenes.lidar_file import read_lidar_file
from bagassets.nuscenes.points import count_points
from bagassets.nuscenes.radar_file import read_radar_file
from bagassets.nuscenes.readings import ChannelReadings
from bagassets.nuscenes.scene_plan import SceneParams, ScenePlan
from bagassets.nuscenes.table_file import quaternion, rounded
from bagassets.nuscenes.tokens import RecordingTokens, attribute_token, category_token, visibility_token
from bagassets.nuscenes.visibility import CameraView, visibility_levels

__all__ = ["AnnotationRows", "annotation_rows"]


@dataclass
class AnnotationRows:
    """Rows about objects, and what became of their observations.

    Attributes:
        tables: table -> rows.
        categories: names of the categories of the instances.
        attributes: names of the attributes of the boxes.
        counts: see the step's documentation.
    """

    tables: dict[str, list[dict[str, Any]]] = field(
        default_factory=lambda: {"instance": [], "sample_annotation": []}
    )
    categories: set[str] = field(default_factory=set)
    attributes: set[str] = field(default_factory=set)
    counts: dict[str, int] = field(default_factory=dict)


def annotation_rows(
    tokens: RecordingTokens,
    boxes: BoxTable,
    channels: Mapping[str, ChannelReadings],
    scenes: Sequence[ScenePlan],
    params: SceneParams,
) -> AnnotationRows:
    """Return the rows of all scenes: each track at each keyframe where it exists.

    An instance is a track within one scene. Its category is the one that most of its boxes carry
    (of equals the first by name), since nuScenes keeps the category with the instance.
    """
    builder = _Builder(tokens, boxes, params)
    rows = builder.rows
    tracks = list(tracks_of(boxes))
    in_scenes = np.zeros(len(boxes), dtype=np.bool_)
    with_boxes: set[int] = set()
    for scene in scenes:
        span = scene.span
        in_scenes |= (boxes.stamps_ns >= span.window_start_ns) & (boxes.stamps_ns < span.window_end_ns)
        samples: list[list[dict[str, Any]]] = [[] for _ in scene.keyframes_ns]
        with_boxes.update(
            number for number, track in enumerate(tracks) if builder.add_instance(track, scene, samples)
        )
        for sample, annotations in enumerate(samples):
            if annotations:
                _measure(annotations, channels, scene, sample)
            rows.tables["sample_annotation"].extend(annotations)
    rows.counts = {
        "observations": len(boxes),
        "observations_outside_scenes": int(np.count_nonzero(~in_scenes)),
        "tracks": len(tracks),
        "tracks_without_keyframe": len(tracks) - len(with_boxes),
        "instances": len(rows.tables["instance"]),
        "annotations": len(rows.tables["sample_annotation"]),
        "held": builder.held,
    }
    return rows


class _Builder:
    """Turns tracks into instances, scene by scene."""

    def __init__(self, tokens: RecordingTokens, boxes: BoxTable, params: SceneParams) -> None:
        self.rows = AnnotationRows()
        self.held = 0
        self._tokens, self._boxes, self._params = tokens, boxes, params

    def add_instance(self, track: Track, scene: ScenePlan, samples: list[list[dict[str, Any]]]) -> bool:
        """Add the boxes of a track to the `samples` of a scene; return whether there are any."""
        found = track.at(scene.keyframes_ns, self._params.box_gap_ns, self._params.tolerance_ns)
        if not len(found.at):
            return False
        self.held += found.held
        boxes, name = self._boxes, (track.source, track.track_id)
        observations = track.rows[found.observations].tolist()
        votes = Counter(boxes.categories[row] for row in observations)
        category = min(votes, key=lambda name: (-votes[name], name))
        self.rows.categories.add(category)
        stamps = [int(scene.keyframes_ns[sample]) for sample in found.at]
        tokens = [self._tokens.track("sample_annotation", *name, stamp) for stamp in stamps]
        instance = self._tokens.track("instance", *name, int(scene.keyframes_ns[0]))
        self.rows.tables["instance"].append(
            {
                "token": instance,
                "category_token": category_token(category),
                "nbr_annotations": len(tokens),
                "first_annotation_token": tokens[0],
                "last_annotation_token": tokens[-1],
            }
        )
        for position, (sample, row) in enumerate(zip(found.at.tolist(), observations, strict=True)):
            self.rows.attributes.update(boxes.attributes[row])
            samples[sample].append(
                {
                    "token": tokens[position],
                    "sample_token": self._tokens.row("sample", "", stamps[position]),
                    "instance_token": instance,
                    "attribute_tokens": [attribute_token(name) for name in boxes.attributes[row]],
                    "translation": rounded(found.centers_m[position]),
                    "size": rounded(boxes.sizes_m[row]),
                    "rotation": quaternion(found.rotations[position]),
                    "prev": tokens[position - 1] if position else "",
                    "next": tokens[position + 1] if position + 1 < len(tokens) else "",
                }
            )
        return True


def _measure(
    annotations: list[dict[str, Any]], channels: Mapping[str, ChannelReadings], scene: ScenePlan, sample: int
) -> None:
    """Fill in points and visibility of the boxes of one sample, from the files of its keyframe."""
    centers = np.array([row["translation"] for row in annotations])
    rotations = np.array([row["rotation"] for row in annotations])
    sizes = np.array([row["size"] for row in annotations])
    points = {"lidar": np.zeros(len(annotations), np.int64), "radar": np.zeros(len(annotations), np.int64)}
    views = []
    for name, plan in scene.channels.items():
        keyframe = plan.readings[plan.is_keyframe & (plan.sample == sample)]
        if not len(keyframe):
            continue
        channel, reading = channels[name], int(keyframe[0])
        global_SE3_sensor = channel.global_SE3_sensor(reading)
        if channel.modality == "camera":
            if channel.intrinsic:
                width, height = channel.sizes_px[reading]
                views.append(CameraView(global_SE3_sensor, channel.intrinsic_matrix(), width, height))
            continue
        if channel.modality == "lidar":
            xyz = read_lidar_file(channel.path(reading))[:, :3]
        else:
            targets = read_radar_file(channel.path(reading))
            xyz = np.stack([targets[axis] for axis in "xyz"], axis=1)
        points[channel.modality] += count_points(xyz, global_SE3_sensor, centers, rotations, sizes)
    levels = visibility_levels(views, centers, rotations, sizes)
    for number, row in enumerate(annotations):
        row["visibility_token"] = visibility_token(levels[number])
        row["num_lidar_pts"] = int(points["lidar"][number])
        row["num_radar_pts"] = int(points["radar"][number])
