"""Rows about objects: instance and sample_annotation."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from bagassets.assets.boxes.motion import MotionRule, has_attributes, motion_attributes, speeds_of
from bagassets.assets.boxes.table import BoxTable
from bagassets.assets.boxes.tracks import Messages, Track, messages_of, tracks_of
from bagassets.assets.lidar_file import read_lidar_file
from bagassets.assets.radar_file import read_radar_file
from bagassets.assets.timeline.keyframes import Stamps
from bagassets.base.json_types import JsonObject
from bagassets.formats.json_files import rounded
from bagassets.formats.nuscenes.points import hits_of
from bagassets.formats.nuscenes.readings import ChannelReadings
from bagassets.formats.nuscenes.scene_plan import SceneParams, ScenePlan
from bagassets.formats.nuscenes.table_file import quaternion
from bagassets.formats.nuscenes.tokens import (
    RecordingTokens,
    attribute_token,
    category_token,
    visibility_token,
)
from bagassets.formats.nuscenes.visibility import CameraView, share_in_images, share_open, visibility_levels

_SPEED_WINDOW_NS = 1_000_000_000
# No lidar takes longer for one revolution, however far apart its readings are.
_LONGEST_REVOLUTION_S = 0.2


def annotation_rows(
    tokens: RecordingTokens,
    boxes: BoxTable,
    channels: Mapping[str, ChannelReadings],
    scenes: Sequence[ScenePlan],
    params: SceneParams,
    motion: MotionRule | None,
) -> "AnnotationRows":
    """Return the rows of all scenes: tracks at each keyframe where they exist, and boxes without a track.

    An instance is a track within one scene. Its category is the one that most of its boxes have (on a tie, the first by
    name), because in nuScenes instances have categories. Of boxes without a track, a keyframe gets those in the nearest
    message of each source; each becomes an instance of its own at each keyframe.

    Args:
        tokens: tokens of the recording.
        boxes: in the global frame.
        channels: readings of all channels.
        scenes: scenes of the recording.
        params: the recipe's scenes, which limit how far boxes are from keyframes.
        motion: when objects without attributes count as moving; None to give them none.
    """
    rows = AnnotationRows(tokens, boxes, params, motion)
    tracks, messages = list(tracks_of(boxes)), list(messages_of(boxes))
    in_scenes = np.zeros(len(boxes), dtype=np.bool_)
    with_boxes: set[int] = set()
    for scene in scenes:
        span = scene.span
        in_scenes |= (boxes.stamps_ns >= span.window_start_ns) & (boxes.stamps_ns < span.window_end_ns)
        samples: list[list[JsonObject]] = [[] for _ in scene.keyframes_ns]
        with_boxes.update(
            number for number, track in enumerate(tracks) if rows.add_instance(track, scene, samples)
        )
        for source in messages:
            rows.add_messages(source, scene, samples)
        for sample, annotations in enumerate(samples):
            if annotations:
                _measure(annotations, channels, scene, sample, rows.speeds_mps)
            rows.tables["sample_annotation"].extend(annotations)
    rows.counts = {
        "observations": len(boxes),
        "observations_outside_scenes": int(np.count_nonzero(~in_scenes)),
        "tracks": len(tracks),
        "tracks_without_keyframe": len(tracks) - len(with_boxes),
        "without_track": boxes.without_track,
        "without_track_unused": boxes.without_track - len(rows.used),
        "instances": len(rows.tables["instance"]),
        "annotations": len(rows.tables["sample_annotation"]),
        "held": rows.held,
        **rows.attribute_counts,
    }
    return rows


class AnnotationRows:
    """Rows about objects, made scene by scene from tracks and single boxes, and counts of their observations.

    Attributes:
        tables: table -> rows.
        categories: names of the categories of the instances.
        attributes: names of the attributes of the boxes.
        counts: see `bagassets.formats.nuscenes.tables`.
    """

    def __init__(
        self, tokens: RecordingTokens, boxes: BoxTable, params: SceneParams, motion: MotionRule | None
    ) -> None:
        self.tables: dict[str, list[JsonObject]] = {"instance": [], "sample_annotation": []}
        self.categories: set[str] = set()
        self.attributes: set[str] = set()
        self.counts: dict[str, int] = {}
        self.held = 0
        self.used: set[int] = set()
        self.speeds_mps: dict[str, float] = {}  # by annotation token; 0 where unknown
        self.attribute_counts = dict.fromkeys(
            ("attributes_given", "attributes_by_motion", "attributes_undetermined", "attributes_none"), 0
        )
        self._tokens, self._boxes, self._params, self._motion = tokens, boxes, params, motion

    def add_instance(self, track: Track, scene: ScenePlan, samples: list[list[JsonObject]]) -> bool:
        """Add the boxes of a track to the `samples` of a scene; return whether there are any."""
        found = track.at(scene.keyframes_ns, self._params.box_gap_ns, self._params.tolerance_ns)
        if not len(found.at):
            return False
        self.held += found.held
        boxes, name = self._boxes, (track.source, track.track_id)
        observations = track.rows[found.observations].tolist()
        votes = Counter(boxes.categories[row] for row in observations)
        category = min(votes, key=lambda name: (-votes[name], name))
        stamps = [int(scene.keyframes_ns[sample]) for sample in found.at]
        tokens = [self._tokens.track("sample_annotation", *name, stamp) for stamp in stamps]
        instance = self._tokens.track("instance", *name, int(scene.keyframes_ns[0]))
        self._add_instance_row(instance, category, tokens)
        times_ns = scene.keyframes_ns[found.at]
        by_motion = [""] * len(times_ns)
        if self._motion is not None:
            by_motion = motion_attributes(category, track, times_ns, self._motion)
        speeds = np.nan_to_num(speeds_of(track, times_ns, _SPEED_WINDOW_NS, self._params.box_gap_ns))
        self.speeds_mps |= dict(zip(tokens, speeds.tolist(), strict=True))
        for position, (sample, row) in enumerate(zip(found.at.tolist(), observations, strict=True)):
            samples[sample].append(
                {
                    "token": tokens[position],
                    "sample_token": self._tokens.row("sample", "", stamps[position]),
                    "instance_token": instance,
                    "attribute_tokens": self._attributes(row, category, by_motion[position]),
                    "translation": rounded(found.centers_m[position]),
                    "size": rounded(boxes.sizes_m[row]),
                    "rotation": quaternion(found.rotations[position]),
                    "prev": tokens[position - 1] if position else "",
                    "next": tokens[position + 1] if position + 1 < len(tokens) else "",
                }
            )
        return True

    def add_messages(self, messages: Messages, scene: ScenePlan, samples: list[list[JsonObject]]) -> None:
        """Add boxes without a track from a source: those of the message nearest to each keyframe."""
        boxes = self._boxes
        nearest = messages.at(scene.keyframes_ns, self._params.tolerance_ns).tolist()
        for sample, (message, stamp_ns) in enumerate(zip(nearest, scene.keyframes_ns.tolist(), strict=True)):
            if message < 0:
                continue
            rows = messages.rows[message].tolist()
            self.used.update(rows)
            for number, row in enumerate(rows):
                name = (messages.source, f"{messages.stamps_ns[message]} #{number}", stamp_ns)
                token, instance = (
                    self._tokens.track(table, *name) for table in ("sample_annotation", "instance")
                )
                category = boxes.categories[row]
                self.held += int(boxes.stamps_ns[row]) != stamp_ns
                self._add_instance_row(instance, category, [token])
                samples[sample].append(
                    {
                        "token": token,
                        "sample_token": self._tokens.row("sample", "", stamp_ns),
                        "instance_token": instance,
                        "attribute_tokens": self._attributes(row, category, ""),
                        "translation": rounded(boxes.centers_m[row]),
                        "size": rounded(boxes.sizes_m[row]),
                        "rotation": quaternion(boxes.rotations[row]),
                        "prev": "",
                        "next": "",
                    }
                )

    def _add_instance_row(self, token: str, category: str, annotations: Sequence[str]) -> None:
        self.categories.add(category)
        self.tables["instance"].append(
            {
                "token": token,
                "category_token": category_token(category),
                "nbr_annotations": len(annotations),
                "first_annotation_token": annotations[0],
                "last_annotation_token": annotations[-1],
            }
        )

    def _attributes(self, row: int, category: str, by_motion: str) -> list[str]:
        """Return the attribute tokens of a box: those from its source, else the one by motion."""
        names: Sequence[str] = self._boxes.attributes[row]
        if names:
            kind = "given"
        elif by_motion:
            kind, names = "by_motion", [by_motion]
        else:
            kind = "undetermined" if has_attributes(category) else "none"
        self.attribute_counts[f"attributes_{kind}"] += 1
        self.attributes.update(names)
        return [attribute_token(name) for name in names]


def _measure(
    annotations: list[JsonObject],
    channels: Mapping[str, ChannelReadings],
    scene: ScenePlan,
    sample: int,
    speeds_mps: Mapping[str, float],
) -> None:
    """Add numbers of points and visibility to the boxes of one sample, from the files of its keyframe."""
    centers = np.array([row["translation"] for row in annotations])
    rotations = np.array([row["rotation"] for row in annotations])
    sizes = np.array([row["size"] for row in annotations])
    speeds = np.array([speeds_mps.get(row["token"], 0.0) for row in annotations])
    radar_points = np.zeros(len(annotations), np.int64)
    views, lidar_hits = [], []
    for name, plan in scene.channels.items():
        keyframe = plan.readings[plan.is_keyframe & (plan.sample == sample)]
        if not len(keyframe):
            continue
        channel, reading = channels[name], int(keyframe[0])
        global_SE3_sensor = channel.global_SE3_sensor(reading)
        if channel.modality == "camera":
            if channel.intrinsic:
                k = np.array(channel.intrinsic, dtype=np.float64)
                views.append(CameraView(global_SE3_sensor, k, *channel.sizes_px[reading]))
            continue
        if channel.modality == "lidar":
            xyz = read_lidar_file(channel.path(reading))[:, :3]
        else:
            targets = read_radar_file(channel.path(reading))
            xyz = np.stack([targets[axis] for axis in "xyz"], axis=1)
        moves = speeds * _period_s(channel.stamps_ns, reading)
        hits = hits_of(xyz, global_SE3_sensor, centers, rotations, sizes, moves)
        if channel.modality == "lidar":
            lidar_hits.append(hits)
        else:
            radar_points += hits.inside
    lidar_points = sum((hits.inside for hits in lidar_hits), np.zeros(len(annotations), np.int64))
    levels = visibility_levels(
        share_in_images(views, centers, rotations, sizes) if views else None,
        share_open(lidar_hits, len(annotations)) if lidar_hits else None,
        lidar_points if lidar_hits else radar_points,
    )
    for number, row in enumerate(annotations):
        row["visibility_token"] = visibility_token(levels[number])
        row["num_lidar_pts"] = int(lidar_points[number])
        row["num_radar_pts"] = int(radar_points[number])


def _period_s(stamps_ns: Stamps, reading: int) -> float:
    """Return the time since the previous reading, in which a lidar measures its points; for the first, until the next."""
    around = stamps_ns[max(reading - 1, 0) : max(reading - 1, 0) + 2]
    return min(float(around[-1] - around[0]) / 1e9, _LONGEST_REVOLUTION_S)
