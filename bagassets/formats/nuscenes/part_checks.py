"""The checks of a recording's rows of the nuScenes tables."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.lidar_file import read_lidar_file
from bagassets.assets.pose_samples import counted_in_poses
from bagassets.assets.quality.check import RecordingCheck
from bagassets.assets.quality.evidence import Evidence
from bagassets.assets.quality.finding import Finding
from bagassets.assets.quality.pose_rules import heading_askew, poses_complete, poses_cover_sensors
from bagassets.assets.quality.scene_rules import keyframes_complete, scenes_made
from bagassets.assets.quality.sweep_rules import RadarReadings, Sweeps, radar_velocities, sweeps_timed
from bagassets.assets.radar_file import read_radar_file
from bagassets.assets.sweeps import SWEEPS
from bagassets.base.columns import numbers
from bagassets.base.errors import DatasetError
from bagassets.base.json_types import JsonObject
from bagassets.formats.nuscenes.schema import RECORDING_TABLES, Row
from bagassets.formats.nuscenes.table_integrity import broken_references, duplicate_tokens, files_match
from bagassets.geometry.se3 import SE3, Floats
from bagassets.recipe.model import LidarChannel, RadarChannel
from bagassets.recipe.model_poses import NavSatSource
from bagassets.store.artifact import Artifact

PART = "nuscenes_tables"
# The work of a check does not grow with the recording.
MOST_RADAR_READINGS = 60


def _tables(evidence: Evidence) -> dict[str, list[Row]]:
    artifact = evidence.artifact(PART)
    return {name: artifact.read_json(f"{name}.json") for name in RECORDING_TABLES}


def _facts(evidence: Evidence) -> JsonObject:
    facts: JsonObject = evidence.artifact(PART).read_json("facts.json")
    return facts


def _pose_warnings(evidence: Evidence) -> Iterator[str]:
    counts = evidence.artifact(EGO_POSES.name).read_json("ego_poses.json")["counts"]
    pose = evidence.rig.ego_pose
    if pose is None:  # the format asks for poses, so there is one
        return
    if isinstance(pose, NavSatSource) and pose.imu:
        yield from heading_askew(evidence.trajectory, pose.imu)
    what = f"{counted_in_poses(pose.source)}s of {getattr(pose, 'topic', 'TF')}"
    yield from poses_complete(counts, what, evidence.recipe.limits.reported_losses)


def _artifacts_of(
    evidence: Evidence, kind: type[LidarChannel] | type[RadarChannel]
) -> Iterator[tuple[str, Artifact, SE3]]:
    """Yield the name, the sweeps and the mounting of each lidar, or of each radar."""
    for name, entry in sorted(evidence.channels(SWEEPS.name).items()):
        if isinstance(evidence.rig.channels.get(name), kind):
            mount = evidence.calibration.channels[name].ego_SE3_sensor.normalised()
            yield name, evidence.store.artifact(entry["artifact"]), mount


def _sweeps(artifact: Artifact, ego_SE3_sensor: SE3) -> Sweeps:
    index = artifact.read_table("index.parquet", ["stamp_ns", "start_ns", "end_ns", "file"])
    files = index.column("file")
    times = [numbers(index.column(name)).astype(np.int64) for name in ("stamp_ns", "start_ns", "end_ns")]

    def points(number: int) -> NDArray[np.float32] | None:
        try:
            return read_lidar_file(artifact.path(files[number].as_py()))
        except (OSError, ValueError):
            return None  # the check `files_match` reports it

    return Sweeps(times[0], np.stack(times[1:], axis=1), points, ego_SE3_sensor)


def _radar_velocities(evidence: Evidence) -> Finding:
    radars: dict[str, RadarReadings] = {}
    for name, artifact, ego_SE3_sensor in _artifacts_of(evidence, RadarChannel):
        index = artifact.read_table("index.parquet", ["stamp_ns", "file"]).to_pylist()
        chosen = index[:: len(index) // MOST_RADAR_READINGS + 1]
        with suppress(OSError, ValueError, DatasetError):  # the check `files_match` reports it
            readings = [(row["stamp_ns"], _targets(artifact.path(row["file"]))) for row in chosen]
            radars[name] = ego_SE3_sensor, readings
    return radar_velocities(radars, evidence.trajectory)


def _targets(path: Path) -> Floats:
    table = read_radar_file(path)
    return np.array([table[field] for field in ("x", "y", "z", "vx_comp", "vy_comp")], dtype=np.float64)


def _references_intact(evidence: Evidence) -> Finding:
    tables = evidence.once(_tables)
    return Finding(broken_references(tables), {name: len(rows) for name, rows in tables.items()})


def _sweeps_timed(evidence: Evidence) -> Finding:
    lidars = _artifacts_of(evidence, LidarChannel)
    sweeps = {name: _sweeps(artifact, ego_SE3_sensor) for name, artifact, ego_SE3_sensor in lidars}
    return sweeps_timed(evidence.rig, sweeps, evidence.trajectory, evidence.checks.sweeps_timed)


PART_CHECKS = (
    RecordingCheck(
        "scenes_made",
        "scenes_made",
        "The recording has at least one scene, and nearly all of its time is in one.",
        "the recording has no scene; the sentence says why; or more than `limits.reported_losses` (5 %) of its time is in "
        "stretches too short for one, or without the channel that decides where keyframes are",
        lambda e: scenes_made(
            e.once(_facts),
            e.stamps_of,
            e.recipe.scenes.min_length_s,
            e.recipe.limits.reported_losses,
        ),
        quick=True,
    ),
    RecordingCheck(
        "keyframes_complete",
        "keyframes_complete",
        "No keyframe was dropped because a channel is missing, and no sample lacks a channel.",
        "keyframes were dropped because a channel has no reading there, or samples lack a channel, which the recipe "
        "allows ([scenes](scenes.md))",
        lambda e: keyframes_complete(e.once(_facts), e.stamps_of),
        quick=True,
    ),
    RecordingCheck(
        "poses_cover_sensors",
        "poses_cover_sensors",
        "Readings have an ego pose at their time, and the vehicle does not jump.",
        "less than `min_share` of a channel's readings have an ego pose; the vehicle moves faster than `max_speed_mps` "
        "between two poses; two trajectories overlap in time; as a warning: more than `limits.reported_losses` (5 %) "
        "of the messages gave no pose; the heading of the Imu beside GNSS is clearly not where the vehicle moves",
        lambda e: poses_cover_sensors(
            e.trajectory, e.stamps_ns(), e.checks.poses_cover_sensors, _pose_warnings(e)
        ),
    ),
    RecordingCheck(
        "sweeps_timed",
        "sweeps_timed",
        "Lidar clouds match best with the ego poses at their own stamps.",
        "clouds of a lidar match clearly better with ego poses at other times than at their stamps (see below)",
        _sweeps_timed,
    ),
    RecordingCheck(
        "radar_velocities",
        "radar_velocities",
        "Radar targets that stand still have no velocity over ground.",
        "most targets of a radar move over ground exactly as the vehicle does, or against it (see below)",
        _radar_velocities,
    ),
    RecordingCheck(
        "references_intact",
        "references_intact",
        "Every token in a row exists; chains are closed, in order, and as long as stated.",
        "a token does not exist; a chain of `prev` and `next` is broken or out of order; a count is wrong; a keyframe "
        "has two readings of a channel, or none at all",
        _references_intact,
    ),
    RecordingCheck(
        "tokens_unique",
        "tokens_unique",
        "No token and no file name exists twice.",
        "a token or a file name exists twice",
        lambda e: Finding(duplicate_tokens(e.once(_tables))),
    ),
    RecordingCheck(
        "files_match",
        "files_match",
        "The files in the tables are whole in the store, and no others are listed.",
        "a file in the tables is not in the store or has another size; a listed file is in no table",
        lambda e: files_match(
            e.once(_tables)["sample_data"], e.artifact(PART).read_json("files.json"), e.store.artifact
        ),
    ),
)
