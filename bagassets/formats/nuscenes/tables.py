"""The asset `nuscenes_tables`: one recording's rows of the nuScenes tables.

`facts.json` has these counts. If several stretches between pauses have a remainder, the `longest_remainder_s`. Per channel:
readings with rows (`keyframes`, `sweeps`) and without (`without_pose`, `outside_scenes`), and `lacking_at_keyframes`: the
keyframes, dropped or kept, at which the channel has no reading within tolerance, and how many of them are before its first
or after its last reading. Boxes: `observations` (rows of `annotations`), `observations_outside_scenes`, `tracks`,
`tracks_without_keyframe`, boxes `without_track`, and those of them at no keyframe (`without_track_unused`); as written,
`instances` and `annotations`, of which some are `held` rather than interpolated. Annotations with attributes:
`attributes_given` by the source, `attributes_by_motion`. Annotations without: `attributes_undetermined`, though nuScenes
has attributes for the category, and `attributes_none`, where it has none.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

from bagassets.assets.annotations import ANNOTATIONS
from bagassets.assets.asset import Asset, Facts, Inputs, Summary, Use
from bagassets.assets.boxes.motion import MotionRule
from bagassets.assets.boxes.table import BoxTable
from bagassets.assets.calibration import CALIBRATION
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.face import Face
from bagassets.assets.frames import FRAMES
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.sweeps import SWEEPS
from bagassets.base.errors import CalibrationError, DatasetError, PoseError
from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import utc_text
from bagassets.formats.format import FACTS
from bagassets.formats.nuscenes.annotation_rows import annotation_rows
from bagassets.formats.nuscenes.part_checks import PART_CHECKS
from bagassets.formats.nuscenes.readings import ChannelReadings, load_readings
from bagassets.formats.nuscenes.scene_plan import RecordingPlan, SceneParams, plan_scenes
from bagassets.formats.nuscenes.schema import RECORDING_TABLES
from bagassets.formats.nuscenes.sensor_rows import SensorRows, sensor_rows
from bagassets.formats.nuscenes.settings import AttributesByMotion, NuScenes
from bagassets.formats.nuscenes.table_file import table_bytes
from bagassets.formats.nuscenes.tokens import RecordingTokens
from bagassets.geometry.calibration import Calibration
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import CameraChannel, Recipe, Rig, Scenes
from bagassets.store.artifact import Artifact, ArtifactWriter

FILES = "files.json"


@dataclass(frozen=True)
class MotionLimits:
    """When an object counts as moving; see `AttributesByMotion` of the recipe."""

    moving_mps: float
    window_s: float
    parked_m: float

    @classmethod
    def of(cls, attributes: AttributesByMotion) -> "MotionLimits | None":
        """Return the recipe's limits; None if attributes by motion are off."""
        if not attributes.enabled:
            return None
        return cls(attributes.moving_mps, attributes.window_s, attributes.parked_m)

    def rule(self, scenes: SceneParams) -> MotionRule:
        """Return the rule for boxes whose observations are as far apart as `scenes` allows."""
        return MotionRule(self.moving_mps, round(self.window_s * 1e9), self.parked_m, scenes.box_gap_ns)


@dataclass(frozen=True)
class TablesParams:
    """The recipe's parameters for the tables of a recording.

    Attributes:
        rig: name of the rig; a part of all tokens.
        vehicle: its name in the log table.
        location: its name in the log table.
        scenes: how recordings are cut; names a reference channel only if the rig has it.
        candidates: channels of the rig, the best reference first; empty if `scenes` names one.
        attributes_by_motion: when objects count as moving; None if motion gives no attributes.
    """

    rig: str
    vehicle: str
    location: str
    scenes: Scenes
    candidates: tuple[str, ...]
    attributes_by_motion: MotionLimits | None

    @classmethod
    def of(cls, recipe: Recipe, rig: Rig) -> "TablesParams":
        """Return the parameters for a rig.

        A rig without the recipe's reference channel uses the default, so that rigs with different sensors can share a
        recipe.
        """
        scenes, settings = recipe.scenes, recipe.settings(NuScenes) or NuScenes()
        candidates: tuple[str, ...] = ()
        if scenes.reference not in rig.channels:
            scenes, candidates = scenes.model_copy(update={"reference": None}), _by_preference(rig)
        return cls(
            rig=rig.name,
            vehicle=rig.vehicle or rig.name,
            location=rig.location,
            scenes=scenes,
            candidates=candidates,
            attributes_by_motion=MotionLimits.of(settings.attributes_by_motion),
        )


def _by_preference(rig: Rig) -> tuple[str, ...]:
    """Return the channels of a rig: LIDAR_TOP first, then cameras, then others."""

    def rank(name: str) -> tuple[bool, bool]:
        return name != "LIDAR_TOP", not isinstance(rig.channels[name], CameraChannel)

    return tuple(sorted(rig.channels, key=rank))


@dataclass(frozen=True)
class TablesUse:
    """All that determines the tables of a recording besides its artifacts.

    Attributes:
        rig: as in `TablesParams`; so are `vehicle`, `location` and `attributes_by_motion`.
        key: partition key.
        scenes: how the recording is cut.
        extrinsics: channel -> `ego_SE3_sensor`.
    """

    rig: str
    key: str
    vehicle: str
    location: str
    scenes: SceneParams
    extrinsics: Mapping[str, SE3]
    attributes_by_motion: MotionLimits | None


def use(params: TablesParams, facts: Facts) -> dict[str, Use[TablesUse]]:
    """Return the inputs of a recording's tables: all its artifacts, but of the calibration only the extrinsics.

    Raises:
        DatasetError: the reference channel of the recipe is not in the recording.
        CalibrationError: a channel has no extrinsics.
    """
    channels = _channels(facts)
    read = TablesUse(
        rig=params.rig,
        key=facts.key,
        vehicle=params.vehicle,
        location=params.location,
        scenes=SceneParams(**params.scenes.model_dump() | {"reference": _reference(params, channels)}),
        extrinsics={name: _extrinsics(facts.calibration, name) for name in sorted(channels)},
        attributes_by_motion=params.attributes_by_motion,
    )
    inputs = {f"channel:{name}": artifact.digest for name, artifact in channels.items()}
    inputs |= {one.name: facts.artifact(one.name).digest for one in (EGO_POSES, ANNOTATIONS)}
    return {"": Use(read, inputs=inputs)}


def _channels(facts: Facts) -> dict[str, Artifact]:
    return {**facts.channels(FRAMES.name), **facts.channels(SWEEPS.name)}


def _extrinsics(calibration: Calibration, channel: str) -> SE3:
    if channel not in calibration.channels:
        raise CalibrationError(
            f"channel {channel} has no extrinsics in calibration.json; materialize calibration again."
        )
    return calibration.channels[channel].ego_SE3_sensor


def _reference(params: TablesParams, present: Mapping[str, Artifact]) -> str:
    """Return the channel whose readings become keyframes."""
    reference = params.scenes.reference
    if reference is not None:
        if reference not in present:
            raise DatasetError(
                f"scenes.reference {reference} has no readings in this recording, so it has no keyframes; "
                f"list it under rigs[].required to skip such recordings, or choose one of {', '.join(sorted(present))}."
            )
        return reference
    for name in params.candidates:
        if name in present:
            return name
    raise DatasetError(
        f"rig {params.rig}: this recording has no readings of any channel; nothing to make tables from."
    )


def make(use: Use[TablesUse], inputs: Inputs, out: ArtifactWriter) -> Summary:
    """Write the tables, `files.json` and `facts.json`; return the summary.

    Raises:
        PoseError: no reading of the reference channel has an ego pose.
    """
    params, trajectory = use.params, inputs.trajectory
    readings = {
        name: load_readings(name, artifact, params.extrinsics[name], trajectory)
        for name, artifact in sorted(_channels(inputs).items())
    }
    scenes = params.scenes
    _check_poses(readings[scenes.reference], trajectory, params.key)
    holes = [last_ns for _, last_ns in trajectory.holes_ns]
    plan = plan_scenes({name: channel.stamps_ns for name, channel in readings.items()}, scenes, holes)
    origin = inputs.artifact(EGO_POSES.name).read_json("ego_poses.json")["origin"]
    log = {"logfile": params.key, "vehicle": params.vehicle, "location": params.location, "origin": origin}
    tokens = RecordingTokens(params.rig, params.key)
    sensors = sensor_rows(tokens, readings, plan.scenes, log)
    motion = params.attributes_by_motion
    objects = annotation_rows(
        tokens,
        BoxTable.from_arrow(inputs.artifact(ANNOTATIONS.name).read_table("annotations.parquet")),
        readings,
        plan.scenes,
        scenes,
        None if motion is None else motion.rule(scenes),
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
    if plan.longest_remainder_s < plan.remainder_s:
        counts["longest_remainder_s"] = round(plan.longest_remainder_s, 3)
    facts = {
        "rig": params.rig,
        "key": params.key,
        "reference": scenes.reference,
        "missing": scenes.missing,
        "tolerance_s": scenes.tolerance_s,
        "channels": {
            name: channel.modality
            for name, channel in readings.items()
            if sensors.keyframes.get(name) or sensors.sweeps.get(name)
        },
        "categories": sorted(objects.categories),
        "attributes": sorted(objects.attributes),
        "counts": counts,
    }
    out.write_json(FACTS, facts)
    return facts


def _check_poses(reference: ChannelReadings, trajectory: Trajectory, key: str) -> None:
    if len(reference) or not reference.without_pose:
        return
    stamps = trajectory.stamps_ns
    poses = map(utc_text, (*stamps[:1].tolist(), *stamps[-1:].tolist()))
    raise PoseError(
        f"{key}: none of the {reference.without_pose} readings of {reference.channel} has an ego pose at its time; "
        f"poses run {' to '.join(poses) or 'nowhere'}. Check that header stamps of sensors and poses share a clock "
        "(`clock: log` uses the time of logging), or raise ego_pose.max_gap_s."
    )


def _channel_counts(
    name: str, readings: Mapping[str, ChannelReadings], sensors: SensorRows, plan: RecordingPlan
) -> JsonObject:
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


def _shown(artifact: Artifact) -> JsonObject:
    summary = artifact.summary()
    counts = summary["counts"]
    numbers = {"scenes": counts["scenes"], "keyframes": counts["samples"]}
    return {**numbers, "boxes": counts["boxes"]["annotations"], **summary}


NUSCENES_TABLES = Asset(
    name="nuscenes_tables",
    enabled=lambda recipe: recipe.settings(NuScenes) is not None,
    version=9,
    changes={
        7: "cuts scenes at long pauses and where a clock was set",
        8: "gives each ego pose the token of its reading, as in nuScenes itself",
        9: "names the sensors that are at no keyframe",
    },
    spared={9: lambda use: use.scenes.missing == "refuse"},
    title="This recording's rows of the nuScenes tables: scenes, keyframes, readings, poses, boxes.",
    description="Keyframe rate, scene length and tolerance act here; nothing is extracted again when they change.",
    kinds=frozenset({"nuscenes", "json"}),
    face=Face(
        shown=_shown,
        counts={
            "scenes": lambda summary: summary.get("counts", {}).get("scenes"),
            "keyframes": lambda summary: summary.get("counts", {}).get("samples"),
        },
        operation="tables",
    ),
    reads=(INVENTORY, CALIBRATION, EGO_POSES, ANNOTATIONS, FRAMES, SWEEPS),
    params=TablesParams.of,
    use=use,
    make=make,
    checks=PART_CHECKS,
)
