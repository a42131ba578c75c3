"""The step `nuscenes_tables`: one recording's rows of the nuScenes tables.

`facts.json` counts, per channel, where the readings went: `keyframes` and `sweeps` have rows,
`without_pose` and `outside_scenes` have none; `lacking_at_keyframes` says at how many keyframes, dropped or
kept, it has no reading within tolerance, and how many of these lie before its first reading and after its
last. Of the boxes it counts `observations` (rows of
`annotations`), those `observations_outside_scenes`, `tracks` and `tracks_without_keyframe`, boxes
`without_track` and those of them that no keyframe took (`without_track_unused`), and what was written:
`instances`, `annotations`, and of these how many were `held`, not interpolated. Each annotation has
`attributes_given` by its source or `attributes_by_motion`; of the others nuScenes has attributes for those that are
`attributes_undetermined`, and none for `attributes_none`.
"""

from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from bagassets.annotations.motion import MotionRule
from bagassets.annotations.table import BoxTable
from bagassets.errors import CalibrationError, DatasetError, PoseError
from bagassets.geometry.trajectory import Trajectory
from bagassets.nuscenes.annotation_rows import annotation_rows
from bagassets.nuscenes.readings import ChannelReadings, load_readings
from bagassets.nuscenes.scene_plan import RecordingPlan, SceneParams, plan_scenes
from bagassets.nuscenes.schema import RECORDING_TABLES
from bagassets.nuscenes.sensor_rows import Identity, SensorRows, sensor_rows
from bagassets.nuscenes.table_file import table_bytes
from bagassets.nuscenes.tokens import RecordingTokens
from bagassets.recipe.model import AttributesByMotion, CameraChannel, Rig, Scenes
from bagassets.steps.channel import Request
from bagassets.store.action import Step
from bagassets.store.artifact import Artifact, ArtifactWriter

__all__ = ["STEP", "make", "request"]

STEP = Step("nuscenes_tables", 6)

FILES = "files.json"
FACTS = "facts.json"


def request(
    rig: Rig,
    scenes: Scenes,
    key: str,
    *,
    attributes: AttributesByMotion,
    calibration: Mapping[str, Any],
    ego_poses: Artifact,
    annotations: Artifact,
    channels: Mapping[str, Artifact],
) -> Request:
    """Return what the step reads of this recording.

    Args:
        rig: the rig that made the recording.
        scenes: how recordings are cut.
        key: partition key.
        attributes: which attributes are determined by motion.
        calibration: content of `calibration.json`; only the extrinsics of `channels` are read.
        ego_poses: the artifact of poses.
        annotations: the artifact of boxes.
        channels: the artifacts of frames and sweeps per channel.

    Raises:
        DatasetError: the reference channel of the recipe is not in the recording.
        CalibrationError: a channel has no extrinsics.
    """
    extrinsics = {name: _extrinsics(calibration, name) for name in sorted(channels)}
    params = {
        "rig": rig.name,
        "key": key,
        "vehicle": rig.vehicle or rig.name,
        "location": rig.location,
        "scenes": {**scenes.model_dump(mode="json"), "reference": _reference(rig, scenes, channels)},
        "extrinsics": extrinsics,
        "attributes_by_motion": attributes.model_dump(mode="json", exclude={"enabled"})
        if attributes.enabled
        else None,
    }
    inputs = {f"channel:{name}": artifact.digest for name, artifact in channels.items()}
    return Request(params, (), {**inputs, "ego_poses": ego_poses.digest, "annotations": annotations.digest})


def make(
    params: Mapping[str, Any],
    out: ArtifactWriter,
    *,
    trajectory: Trajectory,
    ego_poses: Artifact,
    annotations: Artifact,
    channels: Mapping[str, Artifact],
) -> dict[str, Any]:
    """Write the tables, `files.json` and `facts.json`; return the summary.

    Args:
        params: as made by `request`.
        out: the artifact.
        trajectory: `global_SE3_ego`, the content of `ego_poses`.
        ego_poses: the artifact of poses, for the origin of the global frame.
        annotations: the artifact of boxes.
        channels: the artifacts of frames and sweeps per channel.

    Raises:
        PoseError: no reading of the reference channel has an ego pose.
    """
    readings = {
        name: load_readings(name, artifact, params["extrinsics"][name], trajectory)
        for name, artifact in sorted(channels.items())
    }
    scene_params = SceneParams.from_json(params["scenes"])
    _check_poses(readings[scene_params.reference], trajectory, params["key"])
    plan = plan_scenes({name: channel.stamps_ns for name, channel in readings.items()}, scene_params)
    origin = ego_poses.read_json("ego_poses.json")["origin"]
    identity = Identity(params["rig"], params["key"], params["vehicle"], params["location"], origin)
    sensors = sensor_rows(identity, readings, plan.scenes)
    objects = annotation_rows(
        RecordingTokens(identity.rig, identity.key),
        BoxTable.from_arrow(annotations.read_table("annotations.parquet")),
        readings,
        plan.scenes,
        scene_params,
        _motion_rule(params["attributes_by_motion"], scene_params),
    )
    tables = {**sensors.tables, **objects.tables}
    for name in RECORDING_TABLES:
        out.write(f"{name}.json", table_bytes(name, tables[name]))
    out.write_json(FILES, sensors.files)
    counts = {
        "scenes": len(plan.scenes),
        "samples": len(tables["sample"]),
        "duration_s": round(sum(scene.span.duration_s for scene in plan.scenes), 3),
        "remainder_s": round(plan.remainder_s, 3),
        "scenes_without_keyframe": plan.empty_scenes,
        "dropped_keyframes": plan.dropped_keyframes,
        "lacking_samples": plan.lacking_samples,
        "channels": {name: _channel_counts(name, readings, sensors, plan) for name in sorted(readings)},
        "boxes": objects.counts,
    }
    facts = {
        "rig": identity.rig,
        "key": identity.key,
        "reference": scene_params.reference,
        "missing": params["scenes"]["missing"],
        "tolerance_s": params["scenes"]["tolerance_s"],
        "channels": {
            name: channel.modality for name, channel in readings.items() if sensors.keyframes.get(name)
        },
        "categories": sorted(objects.categories),
        "attributes": sorted(objects.attributes),
        "counts": counts,
    }
    out.write_json(FACTS, facts)
    return facts


def _motion_rule(params: Mapping[str, float] | None, scenes: SceneParams) -> MotionRule | None:
    if params is None:
        return None
    window_ns = round(params["window_s"] * 1e9)
    return MotionRule(params["moving_mps"], window_ns, params["parked_m"], scenes.box_gap_ns)


def _extrinsics(calibration: Mapping[str, Any], channel: str) -> dict[str, list[float]]:
    try:
        transform = calibration["channels"][channel]["ego_SE3_sensor"]
    except KeyError:
        raise CalibrationError(
            f"channel {channel} has no extrinsics in calibration.json; materialize calibration again."
        ) from None
    return {"translation": list(transform["translation"]), "rotation": list(transform["rotation"])}


def _reference(rig: Rig, scenes: Scenes, present: Mapping[str, Any]) -> str:
    """Return the channel whose readings become keyframes.

    A rig that does not have the recipe's reference at all falls back to the default; so rigs
    with different sensors can share a recipe.
    """
    if scenes.reference is not None and scenes.reference in rig.channels:
        if scenes.reference not in present:
            raise DatasetError(
                f"scenes.reference {scenes.reference} has no readings in this recording, so it has no keyframes; "
                f"list it under rigs[].required to skip such recordings, or choose one of {', '.join(sorted(present))}."
            )
        return scenes.reference
    cameras = [name for name, channel in rig.channels.items() if isinstance(channel, CameraChannel)]
    others = [name for name in rig.channels if name not in cameras]
    for name in ("LIDAR_TOP", *cameras, *others):
        if name in present:
            return name
    raise DatasetError(
        f"rig {rig.name}: this recording has no readings of any channel; nothing to make tables from."
    )


def _check_poses(reference: ChannelReadings, trajectory: Trajectory, key: str) -> None:
    if len(reference) or not reference.without_pose:
        return
    poses = (
        [_clock(stamp) for stamp in trajectory.stamps_ns[[0, -1]].tolist()]
        if len(trajectory.stamps_ns)
        else []
    )
    raise PoseError(
        f"{key}: none of the {reference.without_pose} readings of {reference.channel} has an ego pose at its time; "
        f"poses run {' to '.join(poses) or 'nowhere'}. Check that header stamps of sensors and poses share a clock "
        "(`clock: log` uses the time of logging), or raise ego_pose.max_gap_s."
    )


def _clock(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns / 1e9, UTC).isoformat(timespec="milliseconds")


def _channel_counts(
    name: str, readings: Mapping[str, ChannelReadings], sensors: SensorRows, plan: RecordingPlan
) -> dict[str, Any]:
    channel, shortage = readings[name], plan.shortages[name]
    keyframes, sweeps = sensors.keyframes.get(name, 0), sensors.sweeps.get(name, 0)
    return {
        "readings": len(channel) + channel.without_pose,
        "keyframes": keyframes,
        "sweeps": sweeps,
        "without_pose": channel.without_pose,
        "outside_scenes": len(channel) - keyframes - sweeps,
        "span_ns": [int(stamp) for stamp in channel.stamps_ns[[0, -1]]] if len(channel) else [],
        "lacking_at_keyframes": asdict(shortage),
    }
